"""Judges a run against its truth: errors of the three trajectories, and whether the health and the
covariance of the poses are right.

A pose is silently wrong if it is reported as Ok although the motion since the previous Ok pose is
off by more than three of its own sigmas plus 2 cm; a sigma that is no number excuses nothing. It is
vague if it is reported as Ok with a sigma that is not within a user's requirement: not wrong, but
of no use. A flag is false if Degenerate, Predicted,
Bridging or Lost is reported for a pose whose motion over the last 10 m of way is right to 1 %, or 2
cm.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import evaluation, se3, trajectory
from zloam_monitor.trajectory import Trajectory

Array = NDArray[np.float64]
#: values of common/geometry/health.hpp
OK, DEGENERATE, PREDICTED, BRIDGING, LOST = 0, 4, 5, 8, 9
SIGMAS, SLACK_M = 3.0, 0.02
FLAGS = (DEGENERATE, PREDICTED, BRIDGING, LOST)
#: a user's requirement: error as a share of the way, over this length of way
WAY_M, WAY_SHARE = 10.0, 0.01


@dataclass(frozen=True)
class Verdict:
    """The judgement of one drive."""

    poses: int
    path_m: float
    odometry_m: float
    map_m: float
    fused_m: float
    worst_m: float
    ok: int
    degenerate: int
    predicted: int
    lost: int
    other: int
    jumps: int
    silent: int
    #: number of the first silently wrong pose; -1: none
    first_silent: int
    #: m; largest excess over three sigmas among the poses with health Ok
    worst_silent_m: float
    vague: int
    false_flags: int
    #: poses whose motion is right; `false_flags` counts some of them
    right: int
    registration_ms: float
    odometry_ms: float
    mapping_ms: float

    @property
    def bound_m(self) -> float:
        """Limit of issue 36 for the fused pose."""
        return 1.2 * min(self.odometry_m, self.map_m) + 0.005

    @property
    def within_bound(self) -> bool:
        return self.fused_m <= self.bound_m

    @property
    def cpu_ms(self) -> float:
        return self.registration_ms + self.odometry_ms + self.mapping_ms

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Said:
    """The fused poses with the truth, and the health and sigma reported with each."""

    truth: Array
    estimate: Array
    health: NDArray[np.int64]
    jump: NDArray[np.bool_]
    sigma_m: Array


def _table(path: Path) -> Array:
    rows = np.genfromtxt(path, delimiter=",", skip_header=0, ndmin=2)
    return rows if rows.size else np.empty((0, 37))


def _sigmas_m(covariances: Array) -> Array:
    """The largest sigma of each covariance; NaN for a covariance that is none."""
    sigma_m = np.full(len(covariances), np.nan)
    known = np.isfinite(covariances).all(axis=(1, 2))
    variances = np.linalg.eigvalsh(covariances[known])
    # The file has six digits.
    sound = variances[:, 0] >= -1e-5 * np.abs(variances[:, -1])
    sigma_m[known] = np.sqrt(np.where(sound, variances[:, -1], np.nan))
    return sigma_m


def said_of(run: Path, truth: Trajectory) -> Said:
    """Reads the results of a run of zloam-offline."""
    fused = trajectory.read(run / "fused.tum")
    flags = np.genfromtxt(run / "fused.csv", delimiter=",", skip_header=1, ndmin=2)
    covariances = _table(run / "fused_covariance.csv")[:, 1:].reshape(-1, 6, 6)
    if not len(fused) == len(flags) == len(covariances):
        raise RuntimeError(
            f"{run}: {len(fused)} poses, {len(flags)} flags, {len(covariances)} covariances"
        )
    mapped = trajectory.read(run / "est.tum")
    if len(fused) != len(mapped):
        raise RuntimeError(f"{run}: {len(fused)} poses of {len(mapped)} mapped sweeps")
    at, inside = trajectory.interpolate(truth, fused.stamps_ns)
    sigma_m = _sigmas_m(covariances[:, :3, :3])
    return Said(
        at.transforms,
        fused.transforms[inside],
        flags[inside, 1].astype(np.int64),
        flags[inside, 6] > 0,
        sigma_m[inside],
    )


def relative_error_m(said: Said, first: Any, last: Any) -> Array:
    """Position error of the motion between the poses."""
    truth = se3.inverse(said.truth[first]) @ said.truth[last]
    estimate = se3.inverse(said.estimate[first]) @ said.estimate[last]
    error: Array = np.linalg.norm((se3.inverse(truth) @ estimate)[:, :3, 3], axis=1)
    return error


def excess_m(said: Said) -> tuple[NDArray[np.int64], Array]:
    """Poses with health Ok (but the first), and by how much each error exceeds its own bound."""
    ok = np.flatnonzero(said.health == OK)
    if len(ok) < 2:
        return np.empty(0, np.int64), np.empty(0)
    error = relative_error_m(said, ok[:-1], ok[1:])
    sigma_m = np.nan_to_num(said.sigma_m[ok[1:]], nan=0.0)
    return ok[1:], error - SIGMAS * sigma_m - SLACK_M


def right_poses(said: Said) -> NDArray[np.bool_]:
    """Poses whose motion over the last ten metres, or since the start, meets a user's
    requirement."""
    along = trajectory.path_m(said.truth)
    last = np.arange(len(along))
    first = np.searchsorted(along, along - WAY_M, side="right").clip(1) - 1
    error = relative_error_m(said, first, last)
    right: NDArray[np.bool_] = error <= np.maximum(SLACK_M, WAY_SHARE * (along - along[first]))
    return right


def _ate_m(path: Path, truth: Trajectory) -> tuple[float, float]:
    found = evaluation.compare(trajectory.read(path), truth)
    if found is None:
        return float("nan"), float("nan")
    errors = found.errors_m()
    return float(np.sqrt((errors**2).mean())), float(errors.max())


def verdict(run: Path, truth: Trajectory, open_direction: bool = False) -> Verdict:
    """Judges a run of zloam-offline; if the scene leaves a direction open, Degenerate is never a
    false flag."""
    said = said_of(run, truth)
    poses, excess = excess_m(said)
    silent = poses[excess > 0]
    counted = {value: int((said.health == value).sum()) for value in range(10)}
    flagged = np.isin(said.health, FLAGS)
    if open_direction:
        flagged &= said.health != DEGENERATE
    right = right_poses(said)
    cost = np.genfromtxt(run / "cost.csv", delimiter=",", skip_header=1, ndmin=2)
    registration_ms, odometry_ms, mapping_ms = cost[:, 2:5].mean(axis=0)
    fused_m, worst_m = _ate_m(run / "fused.tum", truth)
    known = (OK, DEGENERATE, PREDICTED, LOST)
    return Verdict(
        poses=len(said.health),
        path_m=float(trajectory.path_m(said.truth)[-1]),
        odometry_m=_ate_m(run / "odom.tum", truth)[0],
        map_m=_ate_m(run / "est.tum", truth)[0],
        fused_m=fused_m,
        worst_m=worst_m,
        ok=counted[OK],
        degenerate=counted[DEGENERATE],
        predicted=counted[PREDICTED],
        lost=counted[LOST],
        other=sum(n for value, n in counted.items() if value not in known),
        jumps=int(said.jump.sum()),
        silent=len(silent),
        first_silent=int(silent[0]) if len(silent) else -1,
        worst_silent_m=float(excess.max(initial=0.0)),
        vague=int(((said.health == OK) & ~(said.sigma_m <= WAY_M * WAY_SHARE)).sum()),
        false_flags=int((flagged & right).sum()),
        right=int(right.sum()),
        registration_ms=float(registration_ms),
        odometry_ms=float(odometry_ms),
        mapping_ms=float(mapping_ms),
    )
