"""Counts the health of a run's poses, for the table, the report and `watch`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from zloam_monitor.records import PoseRecord, pose_health

OK = "ok"
#: Always listed, so that a 0 shows that it was counted.
ALWAYS = ("degenerate", "predicted", "lost")
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class PoseHealth:
    """Counts over poses; poses without a covariance are ignored in least_sure_*."""

    poses: int
    #: Health -> number of poses; only those that occur.
    counts: dict[str, int]
    jumps: int
    #: Axis of base_link along which most degenerate poses are unconstrained; empty: no such pose.
    weak_axis: str
    #: Largest sigma of a position, m, and its sweep; None: no pose has a covariance.
    least_sure_m: float | None
    least_sure_sweep: int | None

    def as_dict(self) -> dict[str, Any]:
        return {
            "poses": self.poses,
            "counts": self.counts,
            "jumps": self.jumps,
            "weak_axis": self.weak_axis,
            "least_sure_m": self.least_sure_m,
            "least_sure_sweep": self.least_sure_sweep,
        }


def position_sigma_m(pose: PoseRecord) -> float | None:
    """Sigma along the least sure direction, which is rarely an axis; None: it is not known."""
    if len(pose.covariance) != 36:
        return None
    position = np.asarray(pose.covariance).reshape(6, 6)[:3, :3]
    if not np.isfinite(position).all():
        return None
    return float(np.sqrt(max(np.linalg.eigvalsh(position)[-1], 0.0)))


def _weak_axis(pose: PoseRecord) -> list[str]:
    """The least constrained axis; empty if there is none."""
    if not pose.degenerate or not any(pose.weak_translation):
        return []
    return [AXES[int(np.argmax(np.abs(pose.weak_translation)))]]


def judge(poses: Iterable[PoseRecord]) -> PoseHealth:
    """Counts the health of a run's poses, in any order."""
    counts: Counter[str] = Counter()
    axes: Counter[str] = Counter()
    jumps = 0
    # Of equals, the first sweep.
    least: tuple[float, int] | None = None
    for pose in poses:
        counts[pose_health(pose.health)] += 1
        axes.update(_weak_axis(pose))
        jumps += pose.jump
        if (sigma_m := position_sigma_m(pose)) is not None:
            own = (sigma_m, -pose.sweep)
            least = own if least is None else max(least, own)
    return PoseHealth(
        poses=counts.total(),
        counts=dict(sorted(counts.items(), key=lambda each: (each[0] != OK, each[0]))),
        jumps=jumps,
        weak_axis=min(axes, key=lambda axis: (-axes[axis], axis), default=""),
        least_sure_m=least[0] if least else None,
        least_sure_sweep=-least[1] if least else None,
    )


def line(health: dict[str, Any]) -> str:
    """Text for a person from PoseHealth.as_dict()."""
    counts = health["counts"]
    names = [*ALWAYS, *(name for name in counts if name not in (OK, *ALWAYS))]
    words = [f"{counts.get(OK, 0)} of {health['poses']} poses ok"]
    for name in names:
        count = counts.get(name, 0)
        # A pose may be both lost and degenerate, and is then counted as lost only.
        weak = name == "degenerate" and count > 0 and health["weak_axis"]
        axis = f" (mostly along {health['weak_axis']} of base_link)" if weak else ""
        words.append(f"{count} {name}{axis}")
    words.append(f"{health['jumps']} jump{'' if health['jumps'] == 1 else 's'}")
    if health["least_sure_m"] is not None:
        words.append(
            f"largest sigma of a position {health['least_sure_m']:.3f} m (of sweep "
            f"{health['least_sure_sweep']}, along its least certain direction)"
        )
    return ", ".join(words)
