"""A scene for pictures: a city block with walls and ground, and a closed path."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zloam_monitor import evaluation, picture, se3
from zloam_monitor.messages import MAP_POINT
from zloam_monitor.trajectory import Trajectory


def wall(
    rng: np.random.Generator, a: tuple[float, float], b: tuple[float, float], height: float, n: int
) -> NDArray[np.float64]:
    s = rng.uniform(0, 1, n)[:, None]
    xy = np.array(a) * (1 - s) + np.array(b) * s + rng.normal(0, 0.02, (n, 2))
    return np.column_stack([xy, rng.uniform(0, height, n)])


def city_scene(with_truth: bool = True, n: int = 700) -> picture.Scene:
    rng = np.random.default_rng(1)
    block = [(-45, -30), (45, -30), (45, 30), (-45, 30), (-45, -30)]
    outer = [(-65, -50), (65, -50), (65, 50), (-65, 50), (-65, -50)]
    parts = [wall(rng, a, b, 12, 20_000) for a, b in itertools.pairwise(block)]
    parts += [wall(rng, a, b, 9, 20_000) for a, b in itertools.pairwise(outer)]
    parts.append(
        np.c_[
            rng.uniform(-65, 65, 60_000),
            rng.uniform(-50, 50, 60_000),
            rng.normal(-1.7, 0.02, 60_000),
        ]
    )
    xyz = np.concatenate(parts)
    points = np.zeros(len(xyz), MAP_POINT)
    points["x"], points["y"], points["z"] = xyz.T
    angle = np.linspace(0, 2 * np.pi, n)
    positions = np.c_[55 * np.cos(angle), 40 * np.sin(angle), 0.1 * np.sin(angle)]
    quats = Rotation.from_rotvec(np.outer(angle + np.pi / 2, [0, 0, 1])).as_quat()
    stamps = 1_700_000_000_000_000_000 + (np.arange(n) * 100_000_000).astype(np.int64)
    truth = Trajectory(se3.matrices(positions, quats), stamps, np.arange(n))
    bent = truth.transforms.copy()
    bent[:, :3, 3] += np.cumsum(rng.normal(0, 0.008, (n, 3)), axis=0)
    estimate = Trajectory(bent, stamps, np.arange(n))
    compared = evaluation.compare(estimate, truth) if with_truth else None
    seconds = estimate.times_s(int(stamps[0]))
    return picture.Scene("city, seed 1", points, estimate.positions, seconds, compared)
