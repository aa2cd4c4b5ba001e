"""Tests the geometry of drive.py on scans of a car with a known motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.bench import drive
from tests.bench.consistency import Array
from tests.bench.versus.data import Scans
from zloam_monitor.trajectory import Trajectory

SWEEPS, SPEED_M_S, YAW_RATE_RAD_S = 6, 8.0, 0.7


def pose_at(times_s: Array) -> Array:
    """A circle at constant speed."""
    out = np.tile(np.eye(4), (len(times_s), 1, 1))
    yaw, radius_m = YAW_RATE_RAD_S * times_s, SPEED_M_S / YAW_RATE_RAD_S
    out[:, 0, 3], out[:, 1, 3] = radius_m * np.sin(yaw), radius_m * (1 - np.cos(yaw))
    out[:, :3, :3] = Rotation.from_rotvec(np.outer(yaw, [0, 0, 1])).as_matrix()
    return out


def seen_at(sweep: int) -> tuple[Array, Array]:
    """(landmarks as seen at the instants they are hit, the same landmarks as seen at the middle of
    the sweep)."""
    azimuth = np.radians([179.0, 90.0, 1.0, -90.0, -179.0])
    hit = np.stack([10 * np.cos(azimuth), 10 * np.sin(azimuth), np.full(5, -1.0)], axis=1)
    # The sensor rotates from the rear over the left side, the front and the right side.
    times_s = (sweep + (np.pi - azimuth) / (2 * np.pi)) * drive.PERIOD_S
    poses, middle = pose_at(times_s), pose_at(np.array([(sweep + 0.5) * drive.PERIOD_S]))[0]
    world = np.einsum("nij,nj->ni", poses[:, :3, :3], hit) + poses[:, :3, 3]
    return hit, (world - middle[:3, 3]) @ middle[:3, :3]


@pytest.fixture
def scans(tmp_path: Path) -> Scans:
    folder = tmp_path / "drive"
    (folder / "velodyne").mkdir(parents=True)
    for sweep in range(SWEEPS):
        hit, _ = seen_at(sweep)
        rows = np.zeros((len(hit) + 1, 4), "<f4")
        # The last record of a scan may be all zeros: no return.
        rows[:-1, :3] = hit
        rows.tofile(folder / "velodyne" / f"{sweep:06d}.bin")
    meta = {"rings": 64, "period": 0.1, "timestamps": False, "scans_in": "velodyne"}
    (folder / "meta.json").write_text(json.dumps(meta))
    none = Trajectory(np.empty((0, 4, 4)), None, np.empty(0, np.int64))
    return Scans(folder, (), none, None)


def test_scans_are_deskewed_to_the_middle_of_each_sweep(scans: Scans, tmp_path: Path) -> None:
    middles = (np.arange(SWEEPS, dtype=np.float64) + 0.5) * drive.PERIOD_S
    made = drive.write_deskewed(scans, pose_at(middles), tmp_path / "deskewed")
    files = sorted((made.folder / "scans").glob("*.bin"))
    assert len(files) == SWEEPS
    for sweep in range(1, SWEEPS - 1):
        found = np.fromfile(files[sweep], "<f4").reshape(-1, 4)[:, :3]
        hit, expected = seen_at(sweep)
        assert np.abs(hit - expected).max() > 0.3
        assert found == pytest.approx(expected, abs=2e-3)


def test_poses_at_the_ends_are_carried_back_to_the_middles() -> None:
    ends = np.arange(1, SWEEPS + 1, dtype=np.float64) * drive.PERIOD_S
    found = drive.at_middles(pose_at(ends))
    assert found[1:] == pytest.approx(pose_at(ends - 0.05)[1:], abs=1e-3)
