"""Output of commands that run for long: a progress line, overwritten on a terminal and elsewhere
printed again at longer intervals, and last words."""

from __future__ import annotations

import os
import sys
import time


def unreadable(count: int) -> str:
    """Words after other counts: how many messages could not be read; empty if all could."""
    return f", {count} could not be read" if count else ""


def silence() -> None:
    """Sends further output nowhere, after its reader has ended."""
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, sys.stdout.fileno())
    os.close(sink)


def _put(text: str) -> None:
    """Writes a text. Its reader may have ended, also by the same Ctrl-C, as in `zloam run | tee
    log`: the command has not failed by that."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        silence()


def last_words(text: str) -> None:
    """Prints a text after Ctrl-C."""
    _put(text + "\n")


class ProgressLine:
    """Shows the progress of a run."""

    def __init__(self, every_s: float = 0.5, elsewhere_s: float = 10.0) -> None:
        self._terminal = sys.stdout.isatty()
        self._pause = every_s if self._terminal else elsewhere_s
        self._next = 0.0
        self._shown = False

    def show(self, text: str) -> None:
        """Shows a text, at most once per interval."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + self._pause
        if self._terminal:
            _put("\r\x1b[K" + text)
            self._shown = True
        else:
            _put(text + "\n")

    def end(self) -> None:
        """Ends the line, so that further output starts on a new one."""
        if self._shown:
            _put("\n")
            self._shown = False
