"""Tests consistency.py on a street with known walls, a known path, and known errors of the path."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.bench import consistency
from tests.bench.consistency import Array, Path

SWEEP_S, SWEEPS, RAYS, NOISE_M = 0.1, 31, 12_000, 0.01
SWEEP = SWEEPS - 1
#: (axis of the normal, coordinate on that axis, ranges of the other two coordinates), m
Wall = tuple[int, float, tuple[float, float], tuple[float, float]]


def street() -> list[Wall]:
    """Ground, a straight wall on the right, and bays on the left with faces along the street."""
    walls: list[Wall] = [(2, -1.7, (-90, 90), (-90, 90)), (1, -6.0, (-90, 90), (-2, 5))]
    for x in range(-40, 60, 8):
        walls.append((0, float(x), (5.0, 9.0), (-2, 5)))
        walls.append((1, 5.0 if x % 16 else 9.0, (float(x), x + 8.0), (-2, 5)))
    return walls


def pose_at(times_s: Array) -> Array:
    """A car that accelerates, swings from left to right, and pitches."""
    out = np.tile(np.eye(4), (len(times_s), 1, 1))
    out[:, 0, 3] = 4.0 * times_s + 0.4 * times_s**2
    out[:, 1, 3] = 1.2 * np.sin(1.3 * times_s)
    angles = np.stack([0.4 * np.sin(1.7 * times_s), 0.02 * np.sin(5 * times_s), 0 * times_s], 1)
    out[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    return out


def cast(origins: Array, directions: Array) -> Array:
    """Range to the nearest wall; infinite where there is none."""
    nearest = np.full(len(origins), np.inf)
    for axis, place, *spans in street():
        with np.errstate(divide="ignore", invalid="ignore"):
            range_m = (place - origins[:, axis]) / directions[:, axis]
        hit = origins + range_m[:, None] * directions
        others = [a for a in range(3) if a != axis]
        inside = (range_m > 0) & (range_m < nearest)
        for other, (least, greatest) in zip(others, spans, strict=True):
            inside &= (hit[:, other] > least) & (hit[:, other] < greatest)
        nearest[inside] = range_m[inside]
    return nearest


def scanned() -> list[tuple[Array, Array]]:
    """For each sweep, points in the sensor's frame at their own times, and these times; revolutions
    begin at the rear."""
    rng, found = np.random.default_rng(3), []
    for sweep in range(SWEEPS):
        part = np.sort(rng.random(RAYS))
        azimuth, elevation = np.pi - 2 * np.pi * part, np.radians(rng.uniform(-25, 5, RAYS))
        flat = np.cos(elevation)
        rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], 1)
        times_s = (sweep + part) * SWEEP_S
        poses = pose_at(times_s)
        range_m = cast(poses[:, :3, 3], np.einsum("nij,nj->ni", poses[:, :3, :3], rays))
        range_m += rng.normal(0.0, NOISE_M, RAYS)
        seen = np.isfinite(range_m)
        found.append((rays[seen] * range_m[seen, None], times_s[seen]))
    return found


@pytest.fixture(scope="module")
def scans() -> list[tuple[Array, Array]]:
    return scanned()


def poses_at_ends() -> tuple[Array, Array]:
    ends = np.arange(1, SWEEPS + 1, dtype=np.float64) * SWEEP_S
    return pose_at(ends), ends


def test_the_true_path_needs_no_correction(scans: list[tuple[Array, Array]]) -> None:
    found = consistency.misfit(scans.__getitem__, Path(*poses_at_ends()), SWEEP, SWEEP_S)
    assert found.distance_m < 0.005
    assert found.before_m < 1.5 * NOISE_M
    way_m = np.linalg.norm(np.diff(pose_at(np.array([1.0, 3.05]))[:, :3, 3], axis=0))
    assert found.travelled_m == pytest.approx(way_m, abs=0.05)


@pytest.mark.parametrize("scale", [0.97, 0.99, 1.02])
def test_a_path_of_a_wrong_length_is_corrected_by_its_error(
    scans: list[tuple[Array, Array]], scale: float
) -> None:
    poses, ends = poses_at_ends()
    poses[:, :3, 3] *= scale
    found = consistency.misfit(scans.__getitem__, Path(poses, ends), SWEEP, SWEEP_S)
    missing_m = found.travelled_m * (1 / scale - 1)
    # The tolerance: the map's own second is distorted by the same error, and more of the map is
    # built near its end.
    assert found.ahead_m == pytest.approx(missing_m, rel=0.15)
    assert abs(found.left_m) < 0.3 * abs(missing_m)
    assert found.after_m < found.before_m


def test_a_path_that_drifts_to_a_side_is_corrected_to_the_other(
    scans: list[tuple[Array, Array]],
) -> None:
    poses, ends = poses_at_ends()
    poses[:, 1, 3] += 0.05 * ends
    found = consistency.misfit(scans.__getitem__, Path(poses, ends), SWEEP, SWEEP_S)
    assert found.left_m == pytest.approx(-0.05 * 1.95, rel=0.1)


def test_points_that_are_not_deskewed_do_not_fit(scans: list[tuple[Array, Array]]) -> None:
    def at_one_instant(sweep: int) -> tuple[Array, Array]:
        points, times_s = scans[sweep]
        return points, np.full(len(times_s), (sweep + 0.5) * SWEEP_S)

    path = Path(*poses_at_ends())
    skewed = consistency.misfit(at_one_instant, path, SWEEP, SWEEP_S)
    right = consistency.misfit(scans.__getitem__, path, SWEEP, SWEEP_S)
    assert skewed.before_m > 1.5 * right.before_m


def test_a_path_goes_straight_on_beyond_its_ends() -> None:
    times = np.arange(5, dtype=np.float64) * SWEEP_S
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = 2.0 * times
    positions, _ = Path(poses, times).at(np.array([-0.1, 0.6]))
    assert positions[:, 0] == pytest.approx([-0.2, 1.2], abs=1e-9)
