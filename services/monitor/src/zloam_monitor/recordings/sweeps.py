"""Converts clouds to the driver's sweeps: points in time order, each with its ring."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.failures import Misuse
from zloam_monitor.messages import POINT
from zloam_monitor.recordings import Refused, fields, livox, rings, times
from zloam_monitor.recordings.fields import Cloud, Names
from zloam_monitor.recordings.folders import Table
from zloam_monitor.recordings.rings import Lasers
from zloam_monitor.recordings.times import Clock

#: Number of clouds from which unit, origin and rings are inferred.
JUDGED = 10
#: A step to the next sweep within this part of the usual one is taken as the period; with a longer
#: one, a cloud is missing.
USUAL = 0.1
#: Longest sweep: its period is measured up to the part above, and is sent with 32 bits in ns.
LONGEST_NS = 3_900_000_000
#: Lower end of driver.scan_period_s.
SHORTEST_S = 0.01
#: A cloud whose time is at most this much before the last one's came twice, or late; a larger step
#: is one of a clock that was set.
LATE_NS = 1_000_000_000
NO_RINGS = "no rings: the points lie on no lasers' cones"
MODELS = ("none", "clockwise", "counter_clockwise", "deskewed")


@dataclass(frozen=True)
class Timing:
    """Times of clouds without a time field: driver.time_model, scan_period_s, scan_seam_deg."""

    model: str = "none"
    period_s: float = 0.1
    seam_deg: float = 180.0
    #: Value of driver.time_field.
    field: str = ""

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise Misuse(f"driver.time_model: {self.model} is none of {', '.join(MODELS)}")
        # NaN is in no range. A longer period is refused with the sweeps that would have it.
        if not SHORTEST_S <= self.period_s < np.inf:
            raise Misuse(f"driver.scan_period_s: {self.period_s:g} s is no period of a revolution")
        if not abs(self.seam_deg) <= 360.0:
            raise Misuse(f"driver.scan_seam_deg: {self.seam_deg:g} is none of -360 to 360 deg")


@dataclass(frozen=True)
class Sweep:
    """A sweep; points.time_ns counts from stamp_ns, the first point's instant."""

    stamp_ns: int
    period_ns: int
    #: 0: no rings.
    rings: int
    deskewed: bool
    points: NDArray[Any]


def _is_late(number: int, last_ns: int | None, stamp_ns: int) -> bool:
    """Whether a cloud came twice or late; refused if a clock was set."""
    back_ns = -1 if last_ns is None else last_ns - stamp_ns
    if back_ns > LATE_NS:
        raise Refused(
            f"cloud {number}, counted from 0: its time is {1e-9 * back_ns:.3f} s before that of "
            "the cloud before, as if a clock had been set: what follows is another run"
        )
    return back_ns >= 0


def _ascending_stamps(clouds: list[Cloud]) -> list[Cloud]:
    """The clouds without those that came twice or late, by the headers' stamps; refused if these
    are half of them: then the stamps tell nothing."""
    kept: list[Cloud] = []
    for number, cloud in enumerate(clouds):
        if not _is_late(number, kept[-1].stamp_ns if kept else None, cloud.stamp_ns):
            kept.append(cloud)
    if len(clouds) > 1 and 2 * len(kept) <= len(clouds):
        raise Refused("the headers' stamps do not ascend")
    return kept


@dataclass
class Sweeper:
    """Infers from the first clouds how all are read; `said`: texts about that."""

    timing: Timing
    said: list[str] = field(default_factory=list)
    names: Names | None = None
    lasers: Lasers | None = None
    clock: Clock | None = None
    period_ns: int = 0
    #: From the header's stamp to the first point, in the last cloud with returns.
    lag_ns: int | None = None
    #: Returns left out, as their times are not finite; clouds left out, as they came twice or late.
    untimed: int = 0
    late: int = 0
    #: Clouds left out, as the sensor had not given a return yet.
    before: int = 0

    def sweeps(self, messages: Iterable[Any], live: bool = False) -> Iterator[Sweep]:
        """One sweep per message, in their order. Live: each as soon as its cloud comes, without the
        first clouds, which are old when the inference is done."""
        clouds = (self._cloud(m) for m in messages)
        first = list(islice(clouds, JUDGED))
        # A sensor that starts up may publish clouds before it measures.
        while first and not any(len(cloud) for cloud in first):
            self.before += len(first)
            first = list(islice(clouds, JUDGED))
        self._settle(_ascending_stamps(first))
        if live:
            return self._measured_before(self._ascending(clouds))
        return self._measured(self._ascending(c for each in (first, clouds) for c in each))

    def remarks(self) -> list[str]:
        """Texts about irregularities; complete after the last sweep."""
        said = []
        if unknown := sorted(self.lasers.unknown) if self.lasers else []:
            listed = ", ".join(f"{v:g}" for v in unknown[:8])
            said.append(f"rings {listed} came late: their points count as the next ring's")
        if self.untimed and self.names:
            times = f"times (field {self.names.time})"
            said.append(f"{self.untimed} returns left out, as their {times} are not finite")
        if self.before:
            said.append(f"the first {self.before} clouds left out, as they have no return")
        if self.late:
            said.append(f"{self.late} clouds left out, as they came twice or late by their times")
        return said

    def _cloud(self, message: Any) -> Cloud:
        if livox.is_custom(message):
            self.names = livox.NAMES
            return livox.cloud_of(message)
        in_file = isinstance(message, Table)
        there = message.points.dtype.names if in_file else [f.name for f in message.fields]
        if self.names is None:
            self.names = fields.names_of(list(there or ()), self.timing.field)
        names = self.names
        needed = {"x", "y", "z", names.time, names.ring, names.intensity} - {None}
        if missing := sorted(str(name) for name in needed - {*(there or ())}):
            kind = "file" if in_file else "cloud"
            raise Refused(f"a {kind} without the field {missing[0]} of the first one")
        if in_file:
            size = message.width, message.height
            cloud = fields.returns_of(message.points, names, message.stamp_ns, *size)
        else:
            cloud = fields.cloud_of(message, names)
        return self._timed(cloud)

    def _timed(self, cloud: Cloud) -> Cloud:
        """The cloud without returns whose time is not finite."""
        if self.timing.model != "none" or cloud.times is None:
            return cloud
        finite = np.isfinite(cloud.times)
        if finite.all():
            return cloud
        self.untimed += int((~finite).sum())
        return cloud.only(finite)

    def _settle(self, first: list[Cloud]) -> None:
        full = [c for c in first if len(c)]
        if not full or self.names is None:
            if self.untimed and self.names:
                raise Refused(f"field {self.names.time}: no time of the first clouds is finite")
            raise Refused("there is no return in its clouds")
        self.lasers = rings.settle(full)
        self.said.append(str(self.lasers) if self.lasers else NO_RINGS)
        self.period_ns = times.middle_step_ns(first) or int(1e9 * self.timing.period_s)
        if self.timing.model != "none":
            self.said.append(f"points' times by driver.time_model={self.timing.model}")
        elif self.names.time is None:
            raise Refused(
                "there is no field with the points' times (one of "
                f"{', '.join(fields.TIMES)}): name it by driver.time_field, or say how the sensor "
                "turns by driver.time_model=clockwise or counter_clockwise, or by deskewed that "
                "all points of a cloud hold for one instant"
            )
        else:
            ranks = [self.lasers.ranks_of(c) for c in full] if self.lasers else None
            self.clock = times.settle(full, ranks, self.names.time)
            self.period_ns = self.clock.turn_ns
            self.said.append(f"points' times by field {self.names.time} {self.clock}")
        if self.period_ns > LONGEST_NS:
            raise Refused(
                f"a cloud every {1e-9 * self.period_ns:g} s, by the stamps or by "
                f"driver.scan_period_s: at most {1e-9 * LONGEST_NS:g} s can be used"
            )
        self.lag_ns = int(self._instants_ns(full[0]).min()) - full[0].stamp_ns

    def _instants_ns(self, cloud: Cloud) -> NDArray[np.int64]:
        if self.clock is not None:
            return self.clock.instants_ns(cloud, self.lag_ns)
        if self.timing.model == "deskewed":
            return np.full(len(cloud), cloud.stamp_ns, np.int64)
        azimuth_deg = np.degrees(np.arctan2(cloud.xyz[:, 1], cloud.xyz[:, 0]))
        turned = (azimuth_deg - self.timing.seam_deg) % 360.0
        if self.timing.model == "clockwise":
            turned = -turned % 360.0
        share = turned / 360.0
        return cloud.stamp_ns + np.rint(share * self.period_ns).astype(np.int64)

    def _sweep(self, cloud: Cloud) -> Sweep:
        count = self.lasers.count if self.lasers else 0
        deskewed = self.clock is None and self.timing.model == "deskewed"
        if not len(cloud):
            stamp_ns = cloud.stamp_ns + (self.lag_ns or 0)
            return Sweep(stamp_ns, self.period_ns, count, deskewed, np.empty(0, POINT))
        instants_ns = self._instants_ns(cloud)
        order = np.argsort(instants_ns, kind="stable")
        stamp_ns = int(instants_ns[order[0]])
        self.lag_ns = stamp_ns - cloud.stamp_ns
        points = np.zeros(len(cloud), POINT)
        for axis, name in enumerate(("x", "y", "z")):
            points[name] = cloud.xyz[order, axis]
        points["intensity"] = cloud.intensity[order]
        points["time_ns"] = (instants_ns[order] - stamp_ns).clip(0, 4_000_000_000)
        if self.lasers is not None:
            points["ring"] = self.lasers.ranks_of(cloud)[order]
        return Sweep(stamp_ns, self.period_ns, count, deskewed, points)

    def _ascending(self, clouds: Iterable[Cloud]) -> Iterator[Sweep]:
        """The sweeps, each later than the one before."""
        last_ns: int | None = None
        for number, cloud in enumerate(clouds):
            sweep = self._sweep(cloud)
            if _is_late(number, last_ns, sweep.stamp_ns):
                self.late += 1
                continue
            last_ns = sweep.stamp_ns
            yield sweep

    def _period_ns(self, before: Sweep, sweep: Sweep) -> int:
        """Time from one sweep to the next, if it is one period; else the usual period."""
        step_ns = sweep.stamp_ns - before.stamp_ns
        usual = abs(step_ns - self.period_ns) < USUAL * self.period_ns
        return step_ns if usual else self.period_ns

    def _measured(self, sweeps: Iterable[Sweep]) -> Iterator[Sweep]:
        """Sets each sweep's period to the time until the next one."""
        before: Sweep | None = None
        for sweep in sweeps:
            if before is not None:
                yield replace(before, period_ns=self._period_ns(before, sweep))
            before = sweep
        if before is not None:
            yield before

    def _measured_before(self, sweeps: Iterable[Sweep]) -> Iterator[Sweep]:
        """Sets each sweep's period to the time since the one before, as the next has not come."""
        before: Sweep | None = None
        for sweep in sweeps:
            yield (
                sweep
                if before is None
                else replace(sweep, period_ns=self._period_ns(before, sweep))
            )
            before = sweep
