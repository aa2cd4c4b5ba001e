"""Scores of a run: errors at the instant to which a system's poses refer, medians, ratios."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import evaluation, se3
from zloam_monitor.evaluation import Scores
from zloam_monitor.trajectory import Trajectory, interpolate

Array = NDArray[np.float64]

#: parts of the sweep to which a pose may refer
INSTANTS = tuple(i / 8 for i in range(9))
#: length in poses (1 s) of the motions by which the instant is found
MOTION_POSES = 10
#: m per degree; weight of direction errors against position errors
METRES_PER_DEGREE = 0.02
#: A run is lost if its drift, or its largest position error as a share of the path, is above this.
LOST_PERCENT = 20.0


@dataclass(frozen=True)
class Scored:
    """Scores of one run."""

    scores: Scores
    #: part of the sweep to which the poses refer; None if the truth is given by scan number
    instant: float | None
    trajectory: Trajectory

    @property
    def lost(self) -> bool:
        """Whether the run is so far off that its error is no measure of accuracy."""
        drift, worst, path = self.scores.drift_percent, self.scores.ate_max_m, self.scores.path_m
        if worst is None or path is None:
            return True
        return (drift or 0.0) > LOST_PERCENT or worst > path * LOST_PERCENT / 100.0


def motion_error(truth: Array, estimate: Array) -> float:
    """rms error of the motion over a second; weighted sum of position (m) and direction."""
    n = min(MOTION_POSES, len(truth) - 1)
    of_truth = se3.inverse(truth[:-n]) @ truth[n:]
    of_estimate = se3.inverse(estimate[:-n]) @ estimate[n:]
    error = se3.inverse(of_truth) @ of_estimate
    metres = np.sqrt((error[:, :3, 3] ** 2).sum(axis=1).mean())
    degrees = np.degrees(np.sqrt((se3.rotation_angle_rad(error) ** 2).mean()))
    return float(metres + METRES_PER_DEGREE * degrees)


def best_instant(
    poses: Array, starts_ns: NDArray[np.int64], period_ns: int, truth: Trajectory
) -> float:
    """The part of the sweep at which the poses fit the truth best, in favour of the system."""
    errors = []
    for part in INSTANTS:
        at, inside = interpolate(truth, starts_ns + round(part * period_ns))
        errors.append(motion_error(at.transforms, poses[inside]))
    return INSTANTS[int(np.argmin(errors))]


def by_scan(
    poses: Array, starts_ns: NDArray[np.int64] | None, period_ns: int, truth: Trajectory
) -> Scored:
    """Scores of a system that gives one pose per scan without a stamp."""
    numbers = np.arange(len(poses), dtype=np.int64)
    if starts_ns is None:
        found = Trajectory(poses, None, numbers)
        return Scored(evaluation.evaluate(found, truth), None, found)
    part = best_instant(poses, starts_ns[: len(poses)], period_ns, truth)
    stamps = starts_ns[: len(poses)] + round(part * period_ns)
    found = Trajectory(poses, stamps, numbers)
    return Scored(evaluation.evaluate(found, truth), part, found)


def stamped(found: Trajectory, starts_ns: NDArray[np.int64] | None, truth: Trajectory) -> Scored:
    """Scores of a system whose poses have stamps: these count, not the best instant."""
    if starts_ns is None or found.stamps_ns is None:
        by_number = Trajectory(found.transforms, None, np.arange(len(found), dtype=np.int64))
        return Scored(evaluation.evaluate(by_number, truth), None, by_number)
    period_ns = float(np.median(np.diff(starts_ns)))
    # A sweep's end is the next one's start; a stamp off by about a firing still counts as the end.
    within = found.stamps_ns - round(period_ns / 100)
    before = np.maximum(np.searchsorted(starts_ns, within, side="right") - 1, 0)
    part = np.median((found.stamps_ns - starts_ns[before]) / period_ns)
    return Scored(evaluation.evaluate(found, truth), round(float(part), 3), found)


def median(values: Iterable[float | None]) -> float | None:
    """Median of the known values."""
    known = [v for v in values if v is not None]
    return statistics.median(known) if known else None


def ratio(ours: float | None, theirs: float | None) -> float | None:
    """Ratio of ours to theirs; None if either is unknown."""
    return None if ours is None or not theirs else ours / theirs


def geometric_mean(values: list[float]) -> float | None:
    """Geometric mean of positive ratios."""
    return math.exp(statistics.fmean(math.log(v) for v in values)) if values else None
