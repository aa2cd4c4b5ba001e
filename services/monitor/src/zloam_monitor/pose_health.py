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


def _position_sigma_m(pose: PoseRecord) -> float | None:
    if len(pose.covariance) != 36:
        return None
    position = np.asarray(pose.covariance).reshape(6, 6)[:3, :3]
    if not np.isfinite(position).all():
        return None
    return float(np.sqrt(max(np.linalg.eigvalsh(position)[-1], 0.0)))


def _weak_axis(poses: Iterable[PoseRecord]) -> str:
    found = Counter(
        AXES[int(np.argmax(np.abs(pose.weak_translation)))]
        for pose in poses
        if pose.degenerate and any(pose.weak_translation)
    )
    return found.most_common(1)[0][0] if found else ""


def judge(poses: Iterable[PoseRecord]) -> PoseHealth:
    """Counts the health of a run's poses, in any order."""
    every = sorted(poses, key=lambda pose: pose.sweep)
    counts = Counter(pose_health(pose.health) for pose in every)
    sure = [(sigma, pose.sweep) for pose in every if (sigma := _position_sigma_m(pose)) is not None]
    least = max(sure, default=(None, None), key=lambda each: each[0] or 0.0)
    return PoseHealth(
        poses=len(every),
        counts=dict(sorted(counts.items(), key=lambda each: (each[0] != OK, each[0]))),
        jumps=sum(pose.jump for pose in every),
        weak_axis=_weak_axis(every),
        least_sure_m=least[0],
        least_sure_sweep=least[1],
    )


def line(health: dict[str, Any]) -> str:
    """Text for a person from PoseHealth.as_dict()."""
    counts = health["counts"]
    names = [*ALWAYS, *(name for name in counts if name not in (OK, *ALWAYS))]
    words = [f"{counts.get(OK, 0)} of {health['poses']} poses ok"]
    for name in names:
        axis = (
            f" (along {health['weak_axis']})"
            if name == "degenerate" and health["weak_axis"]
            else ""
        )
        words.append(f"{counts.get(name, 0)} {name}{axis}")
    words.append(f"{health['jumps']} jump{'' if health['jumps'] == 1 else 's'}")
    if health["least_sure_m"] is not None:
        words.append(
            f"least sure to {health['least_sure_m']:.3f} m (sweep {health['least_sure_sweep']})"
        )
    return ", ".join(words)
