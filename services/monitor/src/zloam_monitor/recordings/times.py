"""Determines the instant of each point of a cloud.

Drivers agree neither on the unit (s, ms, us, ns; float or integer) nor on the origin (the first
point, the last one, the header's stamp, the Unix epoch, the sensor's start). Both are inferred from
the data. The azimuth advances by one revolution in 40 to 260 ms, while units differ by factors of
1000; there is one cloud per revolution, or per several. A running clock advances from cloud to
cloud, while offsets restart with each cloud. If the data are ambiguous, the topic is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.recordings import Refused
from zloam_monitor.recordings.fields import Cloud, Column

Times = NDArray[np.int64]
#: Name of a unit -> its length in ns.
UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
#: Range of a lidar's period of revolution; its ratio is less than that of two units.
FASTEST_NS, SLOWEST_NS = 40_000_000, 260_000_000
#: The time between clouds is n whole revolutions, up to this part of a revolution times sqrt(n).
TURN_TOLERANCE = 0.08
#: A step between two returns of a laser that is longer than this many usual ones is a gap.
GAP = 5.0
#: Without rings: time span of a cloud's points as part of the time between two clouds.
LEAST_SPAN, MOST_SPAN = 0.2, 1.2
#: Smaller rotations within a cloud do not determine the rate.
LEAST_TURN_RAD = 0.1
#: A running clock advances like the headers' stamps, up to this part of the time.
CLOCK_TOLERANCE = 0.3
#: A clock within this time of the headers' stamps has the same epoch.
SAME_CLOCK_NS = 3_600 * 10**9
#: Some clocks count the time within an hour, and counters of 32 bits start again at their end.
HOUR_NS = 3_600 * 10**9
COUNTER_BYTES, COUNTS = 4, 2**32
#: From cloud to cloud, clock and headers differ by less than this, which is less than half of the
#: shortest counter's length.
AGREEMENT_NS = 2 * 10**9


@dataclass(frozen=True)
class Clock:
    """Converts a topic's times to instants: value * unit_ns + (offset_ns or the header's stamp)."""

    unit: str
    turn_ns: int
    #: Offset of a running clock; None: the values count from each header's stamp.
    offset_ns: int | None
    #: Times after which a running clock may start again.
    lengths_ns: tuple[int, ...] = ()

    def instants_ns(self, cloud: Cloud, lag_ns: int | None) -> Times:
        """lag_ns: from the header's stamp to the first point, in the cloud before; None: there is
        none before."""
        assert cloud.times is not None
        values = in_ns(cloud.times, self.unit)
        if self.offset_ns is None:
            return values + cloud.stamp_ns
        instants_ns = values + self.offset_ns
        return instants_ns if lag_ns is None else self._continued(instants_ns, cloud, lag_ns)

    def _continued(self, instants_ns: Times, cloud: Cloud, lag_ns: int) -> Times:
        """Instants of a clock that starts again, which may happen within the cloud: each point's is
        the possible one nearest to the header."""
        about_ns = cloud.stamp_ns + lag_ns
        for length_ns in (0, *self.lengths_ns):
            rounds = np.rint((about_ns - instants_ns) / length_ns) if length_ns else 0
            found = instants_ns + np.int64(length_ns) * np.asarray(rounds, np.int64)
            if abs(found - about_ns).max() < AGREEMENT_NS:
                return found
        return instants_ns

    def __str__(self) -> str:
        origin = "from the header's stamp" if self.offset_ns is None else "of a clock that runs"
        return f"in {self.unit}, {origin}; a sweep takes {1e-6 * self.turn_ns:.1f} ms"


def in_ns(values: Column, unit: str) -> Times:
    """Values in ns; integers are converted exactly."""
    if np.issubdtype(values.dtype, np.integer):
        return values.astype(np.int64) * UNITS[unit]
    return np.rint(values.astype(np.float64) * UNITS[unit]).astype(np.int64)


def middle_step_ns(clouds: Sequence[Cloud]) -> int | None:
    """Usual time between two clouds, also if some are missing; None: there is only one cloud."""
    steps = np.diff([c.stamp_ns for c in clouds])
    return int(np.quantile(steps, 0.5, method="lower")) if len(steps) else None


def _turn(cloud: Cloud, rings: NDArray[np.uint16]) -> float | None:
    """Period of revolution in the unit of the cloud's times, by the ring with the most returns;
    None: the rotation is too small."""
    assert cloud.times is not None
    of_ring = rings == np.bincount(rings).argmax()
    times = cloud.times[of_ring].astype(np.float64)
    order = np.argsort(times, kind="stable")
    azimuth = np.arctan2(cloud.xyz[of_ring, 1], cloud.xyz[of_ring, 0]).astype(np.float64)[order]
    steps, lasted = (np.diff(azimuth) + np.pi) % (2.0 * np.pi) - np.pi, np.diff(times[order])
    # Across a gap without returns, e.g. of a masked view, the direction of rotation is ambiguous.
    usual = np.median(lasted[lasted > 0.0]) if (lasted > 0.0).any() else 0.0
    seen = (lasted > 0.0) & (lasted <= GAP * usual)
    turned = abs(steps[seen].sum())
    return 2.0 * np.pi * float(lasted[seen].sum()) / turned if turned > LEAST_TURN_RAD else None


def settle(
    clouds: Sequence[Cloud], rings: Sequence[NDArray[np.uint16]] | None, field: str
) -> Clock:
    """Infers a topic's clock from its first clouds; refused if it is ambiguous."""
    columns = [c.times for c in clouds if c.times is not None and len(c) > 1]
    if not columns:
        raise Refused(f"field {field}: the first {len(clouds)} clouds have no point")
    if max(float(np.ptp(column)) for column in columns) == 0.0:
        raise Refused(
            f"field {field}: all points of a cloud have one time. If they hold for one instant, "
            "say so by driver.time_model=deskewed; if the field is not the time, name that one by "
            "driver.time_field"
        )
    step_ns = middle_step_ns(clouds)
    if rings is None:
        unit = _unit_by_span(float(np.median([np.ptp(c) for c in columns])), step_ns, field)
        return _clock(clouds, unit, step_ns or 0, field)
    turns = [t for c, r in zip(clouds, rings, strict=True) if (t := _turn(c, r)) is not None]
    turn = float(np.median(turns)) if turns else 0.0
    unit = _unit(turn, step_ns, field)
    return _clock(clouds, unit, round(turn * UNITS[unit]), field)


def _clock(clouds: Sequence[Cloud], unit: str, turn_ns: int, field: str) -> Clock:
    offset_ns = _offset_ns(clouds, unit, field)
    if offset_ns is None:
        return Clock(unit, turn_ns, None)
    columns = [c.times for c in clouds if c.times is not None]
    lengths_ns = []
    if max(int(in_ns(column, unit).max()) for column in columns) < HOUR_NS:
        lengths_ns.append(HOUR_NS)
    if all(column.dtype.kind in "iu" and column.itemsize == COUNTER_BYTES for column in columns):
        lengths_ns.append(COUNTS * UNITS[unit])
    return Clock(unit, turn_ns, offset_ns, tuple(lengths_ns))


def _unit_by_span(span: float, step_ns: int | None, field: str) -> str:
    """Infers the unit for clouds without rings, in which no revolution can be measured: their
    points come throughout the time between two clouds."""
    if step_ns is None:
        raise Refused(
            f"field {field}: its unit can't be told from a single cloud without rings; record two"
        )
    for unit, ns in UNITS.items():
        if LEAST_SPAN * step_ns <= span * ns <= MOST_SPAN * step_ns:
            return unit
    raise Refused(
        f"field {field}: its values go on by {span:g} in a cloud, and clouds come every "
        f"{1e-9 * step_ns:.3f} s: no unit of s, ms, us, ns fits. If the field is not the points' "
        "time, name that one by driver.time_field"
    )


def _unit(turn: float, step_ns: int | None, field: str) -> str:
    for unit, ns in UNITS.items():
        if FASTEST_NS <= turn * ns <= SLOWEST_NS and _whole_turns(turn * ns, step_ns):
            return unit
    every = "" if step_ns is None else f", and clouds come every {1e-9 * step_ns:.3f} s"
    raise Refused(
        f"field {field}: its values go on by {turn:g} in a turn{every}: no unit of s, ms, us, ns "
        "fits. If the field is not the points' time, name that one by driver.time_field; if the "
        "points were moved to one instant, say so by driver.time_model=deskewed"
    )


def _whole_turns(turn_ns: float, step_ns: int | None) -> bool:
    if step_ns is None:
        return True
    turns = max(1, round(step_ns / turn_ns))
    off_ns = abs(step_ns - turns * turn_ns)
    return off_ns < TURN_TOLERANCE * float(np.sqrt(turns)) * turn_ns


def _offset_ns(clouds: Sequence[Cloud], unit: str, field: str) -> int | None:
    """Infers the clock's offset; None: the values restart with each cloud."""
    starts = np.array([in_ns(c.times, unit).min() for c in clouds if c.times is not None])
    stamps = np.array([c.stamp_ns for c in clouds])
    own, header = starts[-1] - starts[0], stamps[-1] - stamps[0]
    period_ns = middle_step_ns(clouds) or SLOWEST_NS
    apart = stamps - starts
    if abs(own) < 0.5 * period_ns and abs(starts[0]) < 2 * period_ns:
        return None
    if len(clouds) > 1 and abs(own - header) > CLOCK_TOLERANCE * max(period_ns, header):
        raise Refused(
            f"field {field}: its times go on by {1e-9 * own:.3f} s over {len(clouds)} clouds, the "
            f"headers' stamps by {1e-9 * header:.3f} s: neither one clock nor offsets from the "
            "stamps"
        )
    if abs(apart[0]) < SAME_CLOCK_NS:
        return 0
    return int(np.median(apart))
