"""Counts messages that were published but never arrived, by their numbers (Header.seq)."""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass

from zloam_monitor import messages

#: A message this far behind the newest is not late: its publisher began again from 0.
WINDOW = 1024


@dataclass(frozen=True)
class Number:
    """A message's number, and who counts."""

    instance: bytes
    seq: int
    #: 0: not set.
    run: int = 0


def number_of(payload: bytes) -> Number | None:
    """None: messages of this kind have no number, or it can't be read."""
    with contextlib.suppress(*messages.DECODE_ERRORS):
        header = messages.header_of(payload)
        if header is not None:
            return Number(header.Instance() or b"", header.Seq(), header.Run())
    return None


class Numbers:
    """The numbers of one publisher's messages on one key, which are consecutive. It may go on
    counting in another run, as the stages do, or begin again from 0, as it does at its start: a
    program with a fixed name has the same one after it."""

    def __init__(self, first: Number) -> None:
        self._lost_before = 0
        self._runs = {first.run}
        self._begin(first.seq)

    def _begin(self, number: int) -> None:
        self._first = self._newest = number
        self._arrived = 1
        #: Bit n is set if the message with the number newest - n has arrived.
        self._seen = 1

    def take(self, taken: Number) -> None:
        """Counts a message, also one that was overtaken; not one that comes again, nor one from
        before the first."""
        number = taken.seq
        ahead = number - self._newest
        in_new_run = taken.run not in self._runs
        self._runs.add(taken.run)
        if ahead > 0:
            self._newest = number
            self._seen = (self._seen << min(ahead, WINDOW) | 1) & ((1 << WINDOW) - 1)
            self._arrived += 1
        elif in_new_run or ahead <= -WINDOW:
            self._lost_before = self.lost
            self._begin(number)
        elif number >= self._first and not self._seen >> -ahead & 1:
            self._seen |= 1 << -ahead
            self._arrived += 1

    @property
    def lost(self) -> int:
        """Messages between the first and the newest one that have not arrived."""
        return self._lost_before + self._newest - self._first + 1 - self._arrived


class Gaps:
    """Counts what has not arrived, by topic."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, bytes], Numbers] = {}

    def take(self, topic: str, number: Number) -> None:
        """Counts a message that has arrived."""
        known = self._numbers.setdefault((topic, number.instance), Numbers(number))
        known.take(number)  # The first one a second time, which counts once.

    def lost(self) -> Counter[str]:
        """Topic -> number of messages that have not arrived, where there are such."""
        found: Counter[str] = Counter()
        for (topic, _), numbers in self._numbers.items():
            found[topic] += numbers.lost
        return +found
