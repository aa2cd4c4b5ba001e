"""Files keep every nanosecond; interpolation is exact on a constant motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zloam_monitor import se3, trajectory
from zloam_monitor.trajectory import Trajectory


def turning(
    n: int = 11,
    rate_rad_s: float = 0.4,
    speed_m_s: float = 2.0,
    start_ns: int = 1700000000123456789,
) -> Trajectory:
    seconds = np.arange(n) * 0.1
    quats = Rotation.from_rotvec(np.outer(seconds * rate_rad_s, [0, 0, 1])).as_quat()
    positions = np.c_[seconds * speed_m_s, 0 * seconds, 0 * seconds]
    stamps = start_ns + (np.arange(n) * 100_000_000)
    return Trajectory(se3.matrices(positions, quats), stamps, np.arange(n))


def test_tum_keeps_the_nanosecond(tmp_path: Path) -> None:
    wanted = turning()
    trajectory.write_tum(tmp_path / "a.tum", wanted)
    got = trajectory.read(tmp_path / "a.tum")
    np.testing.assert_array_equal(got.stamps_ns, wanted.stamps_ns)
    np.testing.assert_allclose(got.transforms, wanted.transforms, atol=2e-9)


def test_kitti_round_trip(tmp_path: Path) -> None:
    wanted = turning()
    trajectory.write_kitti(tmp_path / "a.txt", wanted)
    got = trajectory.read(tmp_path / "a.txt")
    assert got.stamps_ns is None
    np.testing.assert_allclose(got.transforms, wanted.transforms, atol=2e-9)


def test_interpolation_is_exact_on_constant_motion() -> None:
    truth = turning()
    wanted = truth.stamps_ns[:-1] + 37_000_000
    got, inside = trajectory.interpolate(truth, wanted)
    assert inside.all()
    seconds = np.arange(10) * 0.1 + 0.037
    np.testing.assert_allclose(got.positions[:, 0], 2.0 * seconds, atol=1e-9)
    turned = Rotation.from_matrix(got.transforms[:, :3, :3]).as_rotvec()[:, 2]
    np.testing.assert_allclose(turned, 0.4 * seconds, atol=1e-9)


def test_interpolation_does_not_extrapolate() -> None:
    truth = turning()
    _, inside = trajectory.interpolate(truth, np.array([0, 10**19 // 2], np.int64))
    assert not inside.any()


@pytest.mark.parametrize("text", ["", "1 2 3\n", "1 0 0 0 0 0 zero 1\n"])
def test_a_wrong_file_says_so(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad").write_text(text)
    with pytest.raises(trajectory.TrajectoryError, match="bad"):
        trajectory.read(tmp_path / "bad")


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(trajectory.TrajectoryError, match="No such file"):
        trajectory.read(tmp_path / "none")


@pytest.mark.parametrize("stamp", [0, 1, -1_500_000_000, 1_700_000_000_123_456_789])
def test_stamp_text(stamp: int) -> None:
    assert trajectory.parse_stamp(trajectory.stamp_text(stamp)) == stamp
