"""Whether the published covariance is what the errors are: NEES over a run.

A pose's normalised error squared, e' P^-1 e, has mean 3 for position and for rotation when P is
right. Errors of successive poses are nearly the same error (the map they hang on drifts slowly), so
a run counts as many independent samples as its length over the errors' correlation time; the mean
must lie in the 95 % band of chi-squared with three times as many degrees of freedom.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import Setting, said_of_poses
from zloam_monitor import evaluation, se3, trajectory

Array = NDArray[np.float64]
WORLDS = ("city", "indoor")
#: the scale was found on seed 1
SEEDS = (2, 3)
PARTS = {"position": slice(0, 3), "rotation": slice(3, 6)}
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Consistency:
    """Mean of the normalised errors squared, and its band."""

    mean: float
    lowest: float
    highest: float
    samples: float

    @property
    def held(self) -> bool:
        return self.lowest <= self.mean <= self.highest


def checks(setting: Setting) -> list[Check]:
    """Position and rotation, each world, on seeds other than the tuning's."""
    return [
        Check(
            f"nees-{part}-{world}-{seed}",
            f"simulated {world}, seed {seed}: NEES of the fused pose's {part}",
            f"{CONFIDENCE:.0%} band",
            f"make accept ONLY=nees-{part}-{world}-{seed}",
            functools.partial(_measure, setting, world, seed, part),
        )
        for world in WORLDS
        for seed in SEEDS
        for part in PARTS
    ]


def correlation_time(series: Array) -> float:
    """1 + twice the sum of the autocorrelations up to the first that is not positive."""
    whole = float(series @ series)
    total = 1.0
    for lag in range(1, len(series) // 2):
        found = float(series[:-lag] @ series[lag:]) / whole
        if found <= 0.0:
            break
        total += 2.0 * found
    return total


def consistency(errors: Array, covariances: Array) -> Consistency:
    """Of (N, 3) errors and (N, 3, 3) covariances in order of time."""
    whitening = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariances)), 1, 2)
    white = np.einsum("nij,nj->ni", whitening, errors)
    slowness = float(np.mean([correlation_time(white[:, axis]) for axis in range(3)]))
    samples = max(1.0, len(errors) / slowness)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = chi2.ppf([tail, 1.0 - tail], 3.0 * samples) / samples
    return Consistency(float((white**2).sum(axis=1).mean()), float(low), float(high), samples)


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


def _measure(s: Setting, world: str, seed: int, part: str) -> Measured:
    errors, covariances = _errors(s, world, seed)
    rows = PARTS[part]
    found = consistency(errors[:, rows], covariances[:, rows, rows])
    return Measured(
        f"{found.mean:.2f}, band {found.lowest:.2f} to {found.highest:.2f} "
        f"({found.samples:.0f} independent samples)",
        found.held,
    )
