"""Signals that end a command: the stages are ended in order and files written."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

#: the exit code of a command that a signal ended, as a shell has it, is this and the number
SIGNAL_CODE = 128


class EndAsked(KeyboardInterrupt):
    """As Ctrl-C: what is open is closed on the way out."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def _without_terminal() -> None:
    """It is gone: what is still said must not fail."""
    sink = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        if stream.isatty():
            os.dup2(sink, stream.fileno())
    os.close(sink)


@contextmanager
def handled(
    do: Callable[[int], None], numbers: tuple[int, ...] = (signal.SIGTERM, signal.SIGHUP)
) -> Iterator[None]:
    """Does this at each of the signals; a SIGHUP that is ignored (nohup) stays so."""

    def handler(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            _without_terminal()
        do(number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    wanted = [n for n in numbers if signal.getsignal(n) is not signal.SIG_IGN]
    before = {n: signal.signal(n, handler) for n in wanted}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


#: what ends a command that runs until it is told: Ctrl-C, a supervisor, the terminal's end
TOLD = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def until_told(seconds: float | None = None) -> Iterator[Callable[[], bool]]:
    """Gives whether to go on: none of those signals came, and not so long has passed."""
    told: list[int] = []
    began = time.monotonic()
    with handled(told.append, TOLD):
        yield lambda: not told and (seconds is None or time.monotonic() - began < seconds)


def raised(number: int) -> None:
    """For commands that end wherever they are."""
    raise EndAsked(number)
