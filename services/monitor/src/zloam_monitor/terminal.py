"""A progress line: overwritten on a terminal, elsewhere printed again at longer intervals."""

from __future__ import annotations

import sys
import time


def unreadable(count: int) -> str:
    """Words after other counts: how many messages could not be read; empty if all could."""
    return f", {count} could not be read" if count else ""


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
            sys.stdout.write("\r\x1b[K" + text)
            self._shown = True
        else:
            sys.stdout.write(text + "\n")
        sys.stdout.flush()

    def end(self) -> None:
        """Ends the line, so that further output starts on a new one."""
        if self._shown:
            sys.stdout.write("\n")
            sys.stdout.flush()
            self._shown = False
