"""One line that is overwritten on a terminal, and whole lines elsewhere, not too many of them."""

from __future__ import annotations

import sys
import time


class ProgressLine:
    """Shows where a run is."""

    def __init__(self, every_s: float = 0.5, elsewhere_s: float = 10.0) -> None:
        self._terminal = sys.stdout.isatty()
        self._pause = every_s if self._terminal else elsewhere_s
        self._next = 0.0
        self._shown = False

    def show(self, text: str) -> None:
        """At most one line per pause."""
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
        """Leaves the line, so that what follows starts a new one."""
        if self._shown:
            sys.stdout.write("\n")
            sys.stdout.flush()
            self._shown = False
