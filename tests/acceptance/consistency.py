"""Consistency of the published covariance with the actual errors: NEES over runs with different
seeds.

A pose's normalized estimation error squared, e' P^-1 e, has mean 3 for position and for rotation if
P is right. It is averaged over each run, and over independent runs (Bar-Shalom, Li, Kirubarajan:
Estimation with Applications to Tracking and Navigation, 5.4.2). The errors within a run are
strongly correlated, since most of each is the error of the map that they depend on. Their
autocorrelation does not tell how many independent samples a run is worth, since the alignment
removes what a whole run shares. The spread between runs tells it: the band is that of Student's t.
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
from tests.acceptance.runs import Setting, check_matched, said_of_poses
from zloam_monitor import evaluation, se3, trajectory

Array = NDArray[np.float64]
WORLDS = ("city", "indoor")
#: other seeds than 12 to 31, on which the scales of the covariance were calibrated
SEEDS = range(2, 12)
PARTS = {"position": slice(0, 3), "rotation": slice(3, 6)}
CONFIDENCE = 0.95
EXPECTED = 3.0
#: largest standard deviation of a run's NEES: a run is worth at least one sample of chi-squared
#: with three degrees of freedom
MOST_SPREAD = 6.0**0.5


@dataclass(frozen=True)
class Consistency:
    """Mean of the NEES over all runs, and its acceptance band."""

    mean: float
    lowest: float
    highest: float

    @property
    def held(self) -> bool:
        return self.lowest <= self.mean <= self.highest


def checks(setting: Setting) -> list[Check]:
    """Position and rotation in each world, on other seeds than those of the calibration."""
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
    """Mean NEES of a run with (N, 3) errors and (N, 3, 3) covariances."""
    squared = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)
    return float(squared.mean())


def consistency(runs: Array) -> Consistency:
    """Consistency by the NEES of independent runs."""
    spread = min(float(np.std(runs, ddof=1)), MOST_SPREAD)
    quantile = float(student.ppf(0.5 + 0.5 * CONFIDENCE, len(runs) - 1))
    half = quantile * spread / len(runs) ** 0.5
    return Consistency(float(np.mean(runs)), EXPECTED - half, EXPECTED + half)


def _errors(s: Setting, world: str, seed: int) -> tuple[Array, Array]:
    """Right-tangent errors (translation, rotation) from the aligned poses to the truth, and the
    covariances."""
    demo = s.world(world, seed)
    poses = trajectory.read(demo.results / "trajectory.tum")
    compared = evaluation.compare(poses, trajectory.read(s.simulated(world, seed)[1]))
    if compared is None or poses.stamps_ns is None:
        raise RuntimeError("too few poses")
    check_matched(len(compared.truth), len(poses), world)
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
