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
    #: Of a replay, whose publishers wait for their readers.
    replay: bool = False
    #: A process that takes a stage's work over again has another one, and counts from 0.
    term: int = 0


def number_of(payload: bytes) -> Number | None:
    """None: messages of this kind have no number, or it can't be read."""
    with contextlib.suppress(*messages.DECODE_ERRORS):
        header = messages.header_of(payload)
        if header is not None:
            return Number(
                header.Instance() or b"",
                header.Seq(),
                header.Run(),
                bool(header.Replay()),
                header.Term(),
            )
    return None


class _Series:
    """Consecutive numbers, of which some have arrived."""

    def __init__(self, first: int) -> None:
        self._first = self.newest = first
        self._arrived = 1
        #: Bit n is set if the message with the number newest - n has arrived.
        self._seen = 1

    def take(self, number: int) -> None:
        """Counts a message, also one that was overtaken; not one that comes again, nor one from
        before the first."""
        ahead = number - self.newest
        if ahead > 0:
            self.newest = number
            self._seen = (self._seen << min(ahead, WINDOW) | 1) & ((1 << WINDOW) - 1)
            self._arrived += 1
        elif number >= self._first and not self._seen >> -ahead & 1:
            self._seen |= 1 << -ahead
            self._arrived += 1

    @property
    def lost(self) -> int:
        return self.newest - self._first + 1 - self._arrived


class Numbers:
    """The numbers of one publisher's messages on one key, which are consecutive. It may go on
    counting in another run, as the stages do, or begin again from 0, as a program with a fixed name
    does at its start. A run keeps to the series of its first message, so that one that was
    overtaken from an earlier run is not taken for a new beginning of the series at work."""

    def __init__(self, first: Number) -> None:
        self._series = [_Series(first.seq)]
        #: Run -> its series.
        self._of_run = {first.run: self._series[0]} if first.run else {}

    def take(self, taken: Number) -> None:
        """Counts a message once."""
        series = self._series_of(taken)
        if series is None or taken.seq <= series.newest - WINDOW:
            series = _Series(taken.seq)
            self._series.append(series)
        if taken.run:
            self._of_run[taken.run] = series
        series.take(taken.seq)

    def _series_of(self, taken: Number) -> _Series | None:
        """None: a new one. A run of which nothing came goes on with the nearest number below."""
        if known := self._of_run.get(taken.run):
            return known
        below = [series for series in self._series if series.newest < taken.seq]
        nearest = max(below, key=lambda series: series.newest, default=None)
        return self._series[-1] if nearest is None and not taken.run else nearest

    @property
    def lost(self) -> int:
        """Messages between the first and the newest one of each series that have not arrived."""
        return sum(series.lost for series in self._series)


class Gaps:
    """Counts what has not arrived, by topic."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, bytes, int], Numbers] = {}

    def take(self, topic: str, number: Number) -> None:
        """Counts a message that has arrived."""
        who = topic, number.instance, number.term
        known = self._numbers.setdefault(who, Numbers(number))
        known.take(number)  # The first one a second time, which counts once.

    def lost(self) -> Counter[str]:
        """Topic -> number of messages that have not arrived, where there are such."""
        found: Counter[str] = Counter()
        for (topic, *_), numbers in self._numbers.items():
            found[topic] += numbers.lost
        return +found
