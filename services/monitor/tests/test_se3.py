"""Compares rotations with scipy's, including angles near 0 and near half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from zloam_monitor import se3

ANGLES = [0.0, 1e-12, 1e-7, 0.3, np.pi / 2, 3.0, np.pi - 1e-7, np.pi]


def rotations(angle: float) -> Rotation:
    """Rotations by one angle about many axes, including the coordinate axes."""
    axes = np.r_[np.eye(3), -np.eye(3), np.random.default_rng(1).normal(size=(50, 3))]
    return Rotation.from_rotvec(angle * axes / np.linalg.norm(axes, axis=1)[:, None])


def transforms(turned: Rotation) -> NDArray[np.float64]:
    out = np.tile(np.eye(4), (len(turned), 1, 1))
    out[:, :3, :3] = turned.as_matrix()
    return out


@pytest.mark.parametrize("angle", ANGLES)
def test_quaternions_and_matrices(angle: float) -> None:
    turned = rotations(angle)
    quats = se3.quaternions(transforms(turned))
    assert (quats[:, 3] >= 0).all()
    # q and -q are the same rotation.
    along = np.abs((quats * turned.as_quat()).sum(axis=1))
    np.testing.assert_allclose(along, 1.0, atol=1e-15)
    back = se3.matrices(np.zeros((len(quats), 3)), 1.003 * quats)
    np.testing.assert_allclose(back[:, :3, :3], turned.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(se3.rotation_angle_rad(transforms(turned)), angle, atol=1e-14)


def test_no_rotation_at_all() -> None:
    assert se3.quaternions(np.empty((0, 4, 4))).shape == (0, 4)
    assert se3.matrices(np.empty((0, 3)), np.empty((0, 4))).shape == (0, 4, 4)


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_slerp(angle: float) -> None:
    first, step = Rotation.random(56, random_state=2), rotations(angle)
    second = first * step
    for part in (0.0, 0.1, 0.5, 1.0):
        got = se3.slerp(transforms(first), transforms(second), np.full(56, part))
        wanted = [
            Slerp([0, 1], Rotation.concatenate([a, b]))(part).as_matrix()
            for a, b in zip(first, second, strict=True)
        ]
        np.testing.assert_allclose(got, wanted, atol=1e-9)


def test_roll_pitch_yaw() -> None:
    for rpy in np.random.default_rng(3).uniform(-360, 360, (100, 3)):
        wanted = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
        found = se3.from_xyz_rpy_deg([1, 2, 3], rpy)
        np.testing.assert_allclose(found[:3, :3], wanted, atol=1e-14)
        assert found[:, 3].tolist() == [1, 2, 3, 1]
