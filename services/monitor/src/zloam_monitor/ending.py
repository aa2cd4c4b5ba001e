"""Handles signals that end a command, so that the stages end in order and files are written."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

#: As in a shell, a command that a signal ended has this plus the signal's number as exit code.
SIGNAL_CODE = 128


class EndAsked(KeyboardInterrupt):
    """Raised like Ctrl-C, so that open files and sessions are closed on the way out."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def _without_terminal() -> None:
    """Redirects output to /dev/null after the terminal has gone, so that printing cannot fail."""
    sink = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        if stream.isatty():
            os.dup2(sink, stream.fileno())
    os.close(sink)


@contextmanager
def handled(
    do: Callable[[int], None], numbers: tuple[int, ...] = (signal.SIGTERM, signal.SIGHUP)
) -> Iterator[None]:
    """Calls `do` for each of the signals; an ignored SIGHUP (nohup) stays ignored."""

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


#: Signals that end a command without an end of its own: Ctrl-C, a supervisor, a closed terminal.
TOLD = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def until_told(seconds: float | None = None) -> Iterator[Callable[[], bool]]:
    """Yields a function: true until one of these signals comes or `seconds` have passed."""
    told: list[int] = []
    began = time.monotonic()
    with handled(told.append, TOLD):
        yield lambda: not told and (seconds is None or time.monotonic() - began < seconds)


def raised(number: int) -> None:
    """Signal handler for commands that can end at any point."""
    raise EndAsked(number)
