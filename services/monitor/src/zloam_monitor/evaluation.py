"""How far a trajectory is from the truth.

Alignment (Umeyama, IEEE PAMI 1991, without scale) and absolute and relative errors are defined as
evo defines them, and tests compare with evo; drift over sub-lengths is the KITTI benchmark's
(Geiger et al., CVPR 2012), with lengths that fit the path.
Truth is taken at each pose's own instant, never at the nearest one.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import se3
from zloam_monitor.trajectory import (
    Trajectory,
    interpolate,
    longest_step_ns,
    path_m,
    stamp_text,
)

Array = NDArray[np.float64]
#: A sub-length starts at every tenth pose, as in the KITTI development kit.
SUB_LENGTH_STEP = 10
MIN_POSES = 3
#: A reference without times (KITTI's form) holds for the middle of each sweep: KITTI stamps a scan
#: when the sensor faces forward, and matching scans without deskewing yields about the pose at
#: their middle.
SWEEP_PART_OF_REFERENCE = 0.5
#: A step longer than this many usual ones shows that a pose between them is missing.
EVEN_STEPS = 1.5


@dataclass(frozen=True)
class Scores:
    """Errors of one trajectory; None if the data do not determine them."""

    poses: int
    matched: int
    ate_rmse_m: float | None = None
    ate_max_m: float | None = None
    drift_percent: float | None = None
    drift_deg_per_m: float | None = None
    rpe_1m_m: float | None = None
    path_m: float | None = None
    #: Why there are no errors, or how many poses are without truth.
    remark: str | None = None

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Compared:
    """Estimate and truth at the same instants; `aligned` is the estimate in the truth's frame."""

    truth: Array
    estimate: Array
    aligned: Array
    stamps_ns: NDArray[np.int64]

    def errors_m(self) -> Array:
        """Distance from the truth of each aligned pose."""
        distance: Array = np.linalg.norm(self.aligned[:, :3, 3] - self.truth[:, :3, 3], axis=1)
        return distance


def sub_lengths_m(path_length_m: float) -> list[float]:
    """Sub-lengths for a path: KITTI's own if it is long, shorter ones otherwise."""
    if path_length_m > 800:
        return [100, 200, 300, 400, 500, 600, 700, 800]
    if path_length_m > 250:
        return [50, 100, 200, 300, 400]
    if path_length_m > 60:
        return [5, 10, 20, 40, 60, 80]
    return [1, 2, 5, 10]


def associate(estimate: Trajectory, truth: Trajectory) -> tuple[Array, Array, NDArray[np.int64]]:
    """(truth, estimate, stamps) at the estimate's instants; by sweep if truth has no times."""
    stamps = estimate.stamps_ns
    if stamps is None:
        stamps = estimate.sweeps
    if truth.stamps_ns is not None and estimate.stamps_ns is not None:
        at, inside = interpolate(truth, estimate.stamps_ns, longest_step_ns(truth))
        return at.transforms, estimate.transforms[inside], stamps[inside]
    if estimate.stamps_ns is not None:
        estimate, stamps = at_part_of_sweep(estimate, SWEEP_PART_OF_REFERENCE)
    row = {int(sweep): i for i, sweep in enumerate(truth.sweeps)}
    pairs = [(row[int(s)], i) for i, s in enumerate(estimate.sweeps) if int(s) in row]
    of_truth = [t for t, _ in pairs]
    of_estimate = [e for _, e in pairs]
    return truth.transforms[of_truth], estimate.transforms[of_estimate], stamps[of_estimate]


def at_part_of_sweep(estimate: Trajectory, part: float) -> tuple[Trajectory, NDArray[np.int64]]:
    """Interpolates poses at the sweeps' ends to a part of each sweep.

    Sweeps follow each other without a gap: sweep n began at the pose of sweep n - 1. Sweeps without
    the pose before them are left out.
    """
    ends = estimate.stamps_ns
    assert ends is not None
    follows = np.flatnonzero(np.diff(estimate.sweeps) == 1) + 1
    back = np.rint((1.0 - part) * (ends[follows] - ends[follows - 1])).astype(np.int64)
    at, _ = interpolate(estimate, ends[follows] - back)
    return Trajectory(at.transforms, at.stamps_ns, estimate.sweeps[follows]), ends[follows] - back


def not_joinable(estimate: Trajectory, truth: Trajectory) -> str | None:
    """Why poses of files can't be joined line by line, as they must be if one has no times.

    Without times, only equal numbers of poses, and even steps where times are known, show that the
    n-th line of both belongs to one sweep.
    """
    if estimate.stamps_ns is not None and truth.stamps_ns is not None:
        return None
    if len(estimate) != len(truth):
        return f"they have {len(estimate)} and {len(truth)} poses"
    for stamps_ns in (estimate.stamps_ns, truth.stamps_ns):
        if stamps_ns is None or len(stamps_ns) < MIN_POSES:
            continue
        steps_s = 1e-9 * np.diff(stamps_ns)
        usual_s, longest_s = float(np.median(steps_s)), float(steps_s.max())
        if longest_s > EVEN_STEPS * usual_s:
            return f"the times have a step of {longest_s:g} s where {usual_s:g} s are usual"
    return None


def drift(truth: Array, estimate: Array) -> tuple[float | None, float | None]:
    """(percent, degrees per m): mean relative error over all sub-lengths."""
    along = path_m(truth)
    first, last, length = _sub_length_pairs(along)
    if len(first) == 0:
        return None, None
    step_truth = se3.inverse(truth[first]) @ truth[last]
    step_estimate = se3.inverse(estimate[first]) @ estimate[last]
    error = se3.inverse(step_estimate) @ step_truth
    translation = np.linalg.norm(error[:, :3, 3], axis=1) / length * 100.0
    rotation = np.degrees(se3.rotation_angle_rad(error)) / length
    return float(translation.mean()), float(rotation.mean())


def _sub_length_pairs(along: Array) -> tuple[list[int], list[int], Array]:
    """Start index, end index and length of each sub-length that fits into the path."""
    found = [
        (i, int(j), length)
        for i in range(0, len(along), SUB_LENGTH_STEP)
        for length in sub_lengths_m(float(along[-1]))
        if (j := np.searchsorted(along, along[i] + length)) < len(along)
    ]
    return [f[0] for f in found], [f[1] for f in found], np.array([f[2] for f in found], float)


def _step_ends(positions: Array, length_m: float) -> list[int]:
    """Indices of poses so that at least this much of the path lies between two successive ones."""
    ends, walked_m = [0], 0.0
    for i, step_m in enumerate(np.linalg.norm(np.diff(positions, axis=0), axis=1), start=1):
        walked_m += float(step_m)
        if walked_m >= length_m:
            ends.append(i)
            walked_m = 0.0
    return ends


def _rpe_over_1m(truth: Array, estimate: Array) -> float | None:
    """RMSE of the translations of relative errors over steps of 1 m of the true path."""
    ends = _step_ends(truth[:, :3, 3], 1.0)
    first, last = ends[:-1], ends[1:]
    if not first:
        return None
    step_truth = se3.inverse(truth[first]) @ truth[last]
    step_estimate = se3.inverse(estimate[first]) @ estimate[last]
    return _rms((se3.inverse(step_truth) @ step_estimate)[:, :3, 3])


def _rms(vectors: Array) -> float:
    """Root mean square of the vectors' lengths."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _alignment(positions: Array, onto: Array) -> Array | None:
    """The rigid transform with least squared distances; None: its rotation is not determined."""
    middle, middle_onto = positions.mean(axis=0), onto.mean(axis=0)
    covariance = (onto - middle_onto).T @ (positions - middle) / len(positions)
    u, scales, vt = np.linalg.svd(covariance)
    if np.count_nonzero(scales > np.finfo(float).eps) < 2:
        return None
    no_mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    out = np.eye(4)
    out[:3, :3] = u @ no_mirror @ vt
    out[:3, 3] = middle_onto - out[:3, :3] @ middle
    return out


def compare(estimate: Trajectory, truth: Trajectory) -> Compared | None:
    """The estimate aligned to the truth (rotation and translation, no scale)."""
    of_truth, of_estimate, stamps = associate(estimate, truth)
    if len(of_truth) < MIN_POSES:
        return None
    moved = _alignment(of_estimate[:, :3, 3], of_truth[:, :3, 3])
    if moved is not None:
        return Compared(of_truth, of_estimate, moved @ of_estimate, stamps)
    # If all positions lie on one point or line, the rotation is taken from the first pose.
    turned = of_truth[0] @ se3.inverse(of_estimate[0]) @ of_estimate
    turned[:, :3, 3] += (of_truth[:, :3, 3] - turned[:, :3, 3]).mean(axis=0)
    return Compared(of_truth, of_estimate, turned, stamps)


def evaluate(estimate: Trajectory, truth: Trajectory) -> Scores:
    """All scores of one trajectory. `truth` must be of the same frame (see Trajectory.carried)."""
    return scores_of(compare(estimate, truth), estimate, truth)


def scores_of(compared: Compared | None, estimate: Trajectory, truth: Trajectory) -> Scores:
    """The scores of what compare() has found."""
    if compared is None:
        return Scores(len(estimate), 0, remark=_too_few(estimate, truth))
    errors_m = compared.errors_m()
    percent, degrees = drift(compared.truth, compared.estimate)
    return Scores(
        poses=len(estimate),
        matched=len(compared.truth),
        ate_rmse_m=float(np.sqrt((errors_m**2).mean())),
        ate_max_m=float(errors_m.max()),
        drift_percent=percent,
        drift_deg_per_m=degrees,
        rpe_1m_m=_rpe_over_1m(compared.truth, compared.estimate),
        path_m=float(path_m(compared.truth)[-1]),
        remark=_not_covered(estimate, truth, len(compared.truth)),
    )


def _too_few(estimate: Trajectory, truth: Trajectory) -> str:
    """Why nothing could be compared."""
    text = f"fewer than {MIN_POSES} poses have a truth"
    if estimate.stamps_ns is None or truth.stamps_ns is None or not len(estimate):
        return text
    return f"{text}: poses {_span(estimate)}, reference {_span(truth)}"


def _not_covered(estimate: Trajectory, truth: Trajectory, matched: int) -> str | None:
    missing = len(estimate) - matched
    if truth.stamps_ns is None and estimate.stamps_ns is not None:
        missing -= 1  # Nobody knows where the first sweep began, and so where its middle was.
    if missing <= 0:
        return None
    return f"no truth for {missing} of {len(estimate)} poses, which do not count"


def _span(trajectory: Trajectory) -> str:
    stamps = trajectory.stamps_ns
    assert stamps is not None
    first, last = stamp_text(int(stamps[0])), stamp_text(int(stamps[-1]))
    return f"{len(trajectory)} from {first} to {last} s"
