"""Arrays of rigid transforms: (n, 4, 4) matrices and (n, 4) quaternions x y z w."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def matrices(positions: Array, quaternions: Array) -> Array:
    """(n, 3) and (n, 4) x y z w to (n, 4, 4)."""
    out = np.tile(np.eye(4), (len(positions), 1, 1))
    if len(positions):
        out[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    out[:, :3, 3] = positions
    return out


def quaternions(transforms: Array) -> Array:
    """(n, 4, 4) to (n, 4) x y z w with w >= 0."""
    if len(transforms) == 0:
        return np.empty((0, 4))
    q: Array = Rotation.from_matrix(transforms[:, :3, :3]).as_quat()
    return np.where(q[:, 3:] < 0, -q, q)


def inverse(transforms: Array) -> Array:
    """Inverse of (..., 4, 4) rigid transforms."""
    out = np.zeros_like(transforms)
    rotation_t = np.swapaxes(transforms[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation_t
    out[..., :3, 3] = -(rotation_t @ transforms[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def from_xyz_rpy_deg(xyz: Any, rpy_deg: Any) -> Array:
    """T_parent_child from a translation in m and roll, pitch, yaw in degrees (R = Rz Ry Rx)."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler("xyz", np.asarray(rpy_deg, float), degrees=True).as_matrix()
    out[:3, 3] = np.asarray(xyz, float)
    return out


def rotation_angle_rad(transforms: Array) -> Array:
    """Angle of each rotation, exact for small angles too."""
    angles: Array = Rotation.from_matrix(transforms[:, :3, :3]).magnitude()
    return angles
