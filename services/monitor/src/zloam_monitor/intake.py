"""Receives everything that is published on some keys, in a bounded queue."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import zenoh

from zloam_monitor.gaps import Gaps, number_of
from zloam_monitor.keys import topic_of

MIB = 1 << 20
#: A replay's message waits this long for room. Zenoh closes the link of a reader that takes nothing
#: for 5 s.
MOST_WAIT_S = 4.0


class Clock:
    """This host's clock as it was set at the construction: setting it later, as NTP does on a
    robot without a battery for its clock, makes no step in the times."""

    def __init__(self) -> None:
        self._ahead_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """ns since the Unix epoch."""
        return self._ahead_ns + time.monotonic_ns()


@dataclass(frozen=True)
class Sample:
    """One received message."""

    key: str
    payload: bytes
    #: By the intake's clock, ns since the Unix epoch.
    received_ns: int
    #: It came as an answer to a query, not over a subscription.
    answered: bool = False


class Intake:
    """A queue of at most `most_bytes`; beyond it the oldest or the newest messages are dropped and
    counted. A slow reader blocks Zenoh's threads only where the newest of a replay would be
    dropped: this holds its publishers back, and the replay runs at the reader's pace."""

    def __init__(
        self,
        session: Any,
        expressions: Iterable[str],
        most_bytes: int,
        leave_out: Literal["oldest", "newest"],
    ) -> None:
        self._most_bytes, self._leave_out = most_bytes, leave_out
        self._waiting: deque[Sample] = deque()
        self._bytes = 0
        self._closed = False
        #: Number of messages that wait for room.
        self._outside = 0
        #: Monotonic time at which the newest message of a replay was taken in.
        self._replayed_s = time.monotonic()
        self._gaps = Gaps()
        self.clock = Clock()
        #: Key -> number of dropped messages.
        self.dropped: dict[str, int] = {}
        self._changed = threading.Condition()
        self._subscribers = [session.declare_subscriber(each, self._put) for each in expressions]

    def close(self) -> None:
        """Ends the subscriptions; waiting messages can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            # Messages that wait for room count as arrived: later no gap would show that they lack.
            self._changed.wait_for(lambda: self._outside == 0)
        for subscriber in self._subscribers:
            with contextlib.suppress(zenoh.ZError):  # The session may be closed already.
                subscriber.undeclare()
        self._subscribers.clear()

    def _put(self, sample: Any) -> None:
        self.add(str(sample.key_expr), sample.payload.to_bytes())

    def add(self, key: str, payload: bytes) -> None:
        """Adds a message that came over a subscription, or as an answer."""
        sample = Sample(key, payload, self.clock.now_ns())
        number = number_of(payload)
        replay = number is not None and number.replay
        with self._changed:
            if number is not None:
                self._gaps.take(topic_of(key), number)
            if self._leave_out == "oldest":
                self._make_room(sample)
            elif not self._waited_for_room(sample, replay):
                self._drop(sample)
                return
            if replay:
                self._replayed_s = time.monotonic()
            self._append(sample)

    def add_answer(self, key: str, payload: bytes) -> bool:
        """Adds an answer that was not published, for a thread that may wait for room. Its number
        is none of those that come here, so that it shows no gap between them. False: there was no
        room, and the thread may ask again."""
        sample = Sample(key, payload, self.clock.now_ns(), answered=True)
        with self._changed:
            if not self._waited_for_room(sample, waits=True):
                return False
            self._append(sample)
            return True

    def _append(self, sample: Sample) -> None:
        self._waiting.append(sample)
        self._bytes += len(sample.payload)
        self._changed.notify_all()

    def _make_room(self, sample: Sample) -> None:
        while self._waiting and self._is_full(sample):
            oldest = self._waiting.popleft()
            self._bytes -= len(oldest.payload)
            self._drop(oldest)

    def _waited_for_room(self, sample: Sample, waits: bool) -> bool:
        """False: there is none, and this may not wait or has waited long enough."""
        seconds = MOST_WAIT_S if waits else 0.0
        self._outside += 1
        try:
            return self._changed.wait_for(lambda: self._has_room(sample), seconds)
        finally:
            self._outside -= 1
            self._changed.notify_all()

    def _is_full(self, sample: Sample) -> bool:
        return self._bytes + len(sample.payload) > self._most_bytes

    def _has_room(self, sample: Sample) -> bool:
        """After the end the few messages that waited for room are taken, too."""
        return self._closed or not self._waiting or not self._is_full(sample)

    def _drop(self, sample: Sample) -> None:
        self.dropped[sample.key] = self.dropped.get(sample.key, 0) + 1

    def take(self, seconds: float = 0.0) -> Sample:
        """Takes out the oldest message; raises queue.Empty if none comes within `seconds`."""
        with self._changed:
            if not self._changed.wait_for(lambda: bool(self._waiting), seconds):
                raise queue.Empty
            sample = self._waiting.popleft()
            self._bytes -= len(sample.payload)
            self._changed.notify_all()
            return sample

    def taken(self) -> Iterator[Sample]:
        """Removes and yields the messages that are waiting now; those that come meanwhile are for
        the next call, so that a reader slower than the robot gets to its other work."""
        for _ in range(len(self._waiting)):
            try:
                yield self.take()
            except queue.Empty:  # The remaining ones were dropped for newer ones.
                return

    def has_all(self, seconds: float) -> bool:
        """True if nothing waits, and no message of a replay came in the last `seconds`; statuses
        come without end."""
        with self._changed:
            calm = time.monotonic() - self._replayed_s > seconds
            return calm and not self._waiting and not self._outside

    def lost(self) -> Counter[str]:
        """Topic -> number of messages that were published but never arrived here."""
        with self._changed:
            return self._gaps.lost()
