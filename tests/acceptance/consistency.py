"""Whether the published covariance is what the errors are: NEES over runs of different seeds.

A pose's normalised error squared, e' P^-1 e, has mean 3 for position and for rotation when P is
right. It is averaged over a run, and over independent runs (Bar-Shalom, Li, Kirubarajan: Estimation
with Applications to Tracking and Navigation, 5.4.2). Errors within a run are mostly one error, that
of the map it hangs on, and no autocorrelation tells how many samples it is worth, as what a whole
run shares is taken off by the alignment. What the runs differ by tells it: the band is Student's.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import Setting, said_of_poses
from zloam_monitor import evaluation, se3, trajectory

Array = NDArray[np.float64]
WORLDS = ("city", "indoor")
#: the scales were found on seeds 12 to 31
SEEDS = range(2, 12)
PARTS = {"position": slice(0, 3), "rotation": slice(3, 6)}
CONFIDENCE = 0.95
EXPECTED = 3.0
#: a run is one sample of chi-squared with three degrees of freedom at least
MOST_SPREAD = 6.0**0.5


@dataclass(frozen=True)
class Consistency:
    """Mean of the normalised errors squared over all runs, and its band."""

    mean: float
    lowest: float
    highest: float

    @property
    def held(self) -> bool:
        return self.lowest <= self.mean <= self.highest


def checks(setting: Setting) -> list[Check]:
    """Position and rotation, each world, on seeds other than the tuning's."""
    return [
        Check(
            f"nees-{part}-{world}",
            f"simulated {world}, seeds {SEEDS[0]} to {SEEDS[-1]}: NEES of the fused pose's {part}",
            f"{CONFIDENCE:.0%} band",
            f"make accept ONLY=nees-{part}-{world}",
            functools.partial(_measure, setting, world, part),
        )
        for world in WORLDS
        for part in PARTS
    ]


def nees(errors: Array, covariances: Array) -> float:
    """Mean over a run of (N, 3) errors with (N, 3, 3) covariances."""
    squared = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)
    return float(squared.mean())


def consistency(runs: Array) -> Consistency:
    """Of the NEES of independent runs."""
    spread = min(float(np.std(runs, ddof=1)), MOST_SPREAD)
    quantile = float(student.ppf(0.5 + 0.5 * CONFIDENCE, len(runs) - 1))
    half = quantile * spread / len(runs) ** 0.5
    return Consistency(float(np.mean(runs)), EXPECTED - half, EXPECTED + half)


def _errors(s: Setting, world: str, seed: int) -> tuple[Array, Array]:
    """Right tangents (translation, rotation) from the aligned poses to the truth, covariances."""
    demo = s.world(world, seed)
    poses = trajectory.read(demo.out / "trajectory.tum")
    compared = evaluation.compare(poses, trajectory.read(s.simulated(world, seed)[1]))
    if compared is None or poses.stamps_ns is None:
        raise RuntimeError("too few poses")
    said: NDArray[Any] = said_of_poses(demo)
    cells = [said[f"c{i}{j}"] for i in range(6) for j in range(6)]
    covariances = np.stack(cells, axis=1).reshape(-1, 6, 6)
    covariances = covariances[np.isin(poses.stamps_ns, compared.stamps_ns)]
    off = se3.inverse(compared.aligned) @ compared.truth
    turned = Rotation.from_matrix(off[:, :3, :3]).as_rotvec()
    return np.concatenate([off[:, :3, 3], turned], axis=1), covariances


def _run(s: Setting, world: str, seed: int, rows: slice) -> float:
    errors, covariances = _errors(s, world, seed)
    return nees(errors[:, rows], covariances[:, rows, rows])


def _measure(s: Setting, world: str, part: str) -> Measured:
    runs = np.array([_run(s, world, seed, PARTS[part]) for seed in SEEDS])
    found = consistency(runs)
    return Measured(
        f"{found.mean:.2f}, band {found.lowest:.2f} to {found.highest:.2f} "
        f"({len(runs)} runs of {runs.min():.2f} to {runs.max():.2f})",
        found.held,
    )
