"""Measures data rates: what a subscriber of each key costs the robot, and what a link receives;
and whether messages arrive later than at first."""

from __future__ import annotations

import statistics
import threading
from collections import deque
from collections.abc import Container

from zloam_monitor.records import StatusRecord

#: Rates are means over this time.
OVER_SECONDS = 5.0
#: Limit on the statuses of an instance that are kept for its rates: they come once a second, and as
#: answers.
MOST_STATUSES = 64
#: Two statuses closer together give no useful rate. They come each second, and when queried.
LEAST_SECONDS = 0.5


class Published:
    """kB/s of each key, from the counts in the statuses of all stages."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], deque[StatusRecord]] = {}

    def take(self, status: StatusRecord) -> None:
        who = (status.stage, status.instance)
        if who in self._seen and status.stamp_ns < self._seen[who][-1].stamp_ns:
            # The robot's clock was set back: times from before can't be compared with those after.
            self._seen.clear()
        seen = self._seen.setdefault(who, deque(maxlen=MOST_STATUSES))
        seen.append(status)
        while status.stamp_ns - seen[0].stamp_ns > 1e9 * OVER_SECONDS and len(seen) > 2:
            seen.popleft()

    def forget(self, who: tuple[str, str]) -> None:
        self._seen.pop(who, None)

    def kb_s(self) -> dict[str, float]:
        """The greatest rate first. Keys without traffic are left out: they have no subscriber, or
        are not published now."""
        found: dict[str, float] = {}
        newest_ns = max((seen[-1].stamp_ns for seen in self._seen.values()), default=0)
        for seen in self._seen.values():
            first, last = seen[0], seen[-1]
            seconds = 1e-9 * (last.stamp_ns - first.stamp_ns)
            has_gone = newest_ns - last.stamp_ns > 1e9 * OVER_SECONDS
            if seconds < LEAST_SECONDS or has_gone:
                continue
            for key, count in last.published_bytes.items():
                more = count - first.published_bytes.get(key, 0)
                if more > 0:
                    found[key] = found.get(key, 0.0) + 1e-3 * more / seconds
        return dict(sorted(found.items(), key=lambda each: -each[1]))


class Rate:
    """What comes here per second; for several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._came: deque[tuple[float, int]] = deque()
        self._began_s: float | None = None
        self.total = 0

    def take(self, count: int, now_s: float) -> None:
        """now_s: monotonic clock."""
        with self._lock:
            self.total += count
            if self._began_s is None:
                # How long the first one took to come is not known: it only begins the time.
                self._began_s = now_s
                return
            self._came.append((now_s, count))
            self._forget(now_s)

    def _forget(self, now_s: float) -> None:
        while self._came and now_s - self._came[0][0] >= OVER_SECONDS:
            self._came.popleft()

    def per_s(self, now_s: float) -> float | None:
        """The rate; None if the time is too short."""
        with self._lock:
            if self._began_s is None or now_s - self._began_s < LEAST_SECONDS:
                return None
            self._forget(now_s)
            over_s = min(OVER_SECONDS, now_s - self._began_s)
            return sum(count for _, count in self._came) / over_s


class Taken(Rate):
    """Bytes that this link receives."""

    def kb_s(self, now_s: float) -> float | None:
        rate = self.per_s(now_s)
        return None if rate is None else 1e-3 * rate


class Lateness:
    """How much longer the newest status of each instance took to arrive than its fastest one. Only
    the difference counts, as the clocks of the two hosts may differ."""

    def __init__(self) -> None:
        self._stamp_ns: dict[tuple[str, str], int] = {}
        self._least_ns: dict[tuple[str, str], int] = {}
        self._newest_ns: dict[tuple[str, str], int] = {}

    def take(self, status: StatusRecord, came_ns: int) -> None:
        """came_ns: monotonic clock of this host."""
        who = (status.stage, status.instance)
        took_ns = came_ns - status.stamp_ns
        # The link keeps no status that was overtaken: if stamps go back, the robot's clock was set.
        was_set = status.stamp_ns < self._stamp_ns.get(who, status.stamp_ns)
        least_ns = took_ns if was_set else self._least_ns.get(who, took_ns)
        self._stamp_ns[who], self._newest_ns[who] = status.stamp_ns, took_ns
        self._least_ns[who] = min(took_ns, least_ns)

    def forget(self, who: tuple[str, str]) -> None:
        for kept in (self._stamp_ns, self._least_ns, self._newest_ns):
            kept.pop(who, None)

    def seconds(self, living: Container[tuple[str, str]]) -> float:
        """Median over these instances, s."""
        late_ns = [
            newest_ns - self._least_ns[who]
            for who, newest_ns in self._newest_ns.items()
            if who in living
        ]
        return 1e-9 * statistics.median(late_ns) if late_ns else 0.0
