"""Rigid transforms as arrays: (n, 4, 4) matrices and (n, 4) quaternions x y z w.

Uses numpy alone, so that a run needs no scipy; tests compare with scipy's rotations.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def matrices(positions: Array, quaternions: Array) -> Array:
    """Converts (n, 3) positions and (n, 4) quaternions x y z w to (n, 4, 4) transforms."""
    out = np.tile(np.eye(4), (len(positions), 1, 1))
    if len(positions):
        out[:, :3, :3] = _rotations(quaternions)
    out[:, :3, 3] = positions
    return out


def _rotations(quaternions: Array) -> Array:
    """Converts (n, 4) quaternions x y z w of any length but 0 to (n, 3, 3) rotations."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1)[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def quaternions(transforms: Array) -> Array:
    """Converts (n, 4, 4) transforms to (n, 4) quaternions x y z w with w >= 0.

    Each column of 4 q q^T is the quaternion up to a factor; the one with the largest diagonal
    element loses no digits (Shepperd 1978).
    """
    r = transforms[:, :3, :3]
    trace = np.trace(r, axis1=1, axis2=2)
    outer = np.empty((len(r), 4, 4))
    outer[:, :3, :3] = r + np.swapaxes(r, 1, 2)
    outer[:, range(3), range(3)] += (1 - trace)[:, None]
    outer[:, 3, 3] = 1 + trace
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        outer[:, i, 3] = outer[:, 3, i] = r[:, k, j] - r[:, j, k]
    largest = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    q: Array = outer[np.arange(len(r)), largest]
    q /= np.linalg.norm(q, axis=1)[:, None]
    return np.where(q[:, 3:] < 0, -q, q)


def slerp(first: Array, second: Array, part: Array) -> Array:
    """Interpolates rotations (n, 3, 3) at a constant rate, the shorter way round."""
    step = quaternions(inverse(first) @ second)
    sine, cosine = np.linalg.norm(step[:, :3], axis=1), step[:, 3]
    half = np.arctan2(sine, cosine) * part
    axis = step[:, :3] / np.maximum(sine, np.finfo(float).tiny)[:, None]
    on_the_way = np.c_[axis * np.sin(half)[:, None], np.cos(half)]
    return first[:, :3, :3] @ _rotations(on_the_way)


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
    (cr, cp, cy), (sr, sp, sy) = (
        f(np.radians(np.asarray(rpy_deg, float))) for f in (np.cos, np.sin)
    )
    out = np.eye(4)
    out[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    out[:3, 3] = np.asarray(xyz, float)
    return out


def to_xyz_rpy_deg(pose: Array) -> tuple[Array, Array]:
    """Inverse of from_xyz_rpy_deg; pitch is within 90 degrees, and roll 0 in gimbal lock."""
    r = pose[:3, :3]
    pitch = np.arctan2(-r[2, 0], np.hypot(r[0, 0], r[1, 0]))
    if np.hypot(r[0, 0], r[1, 0]) < 1e-9:
        roll, yaw = 0.0, np.arctan2(-r[0, 1], r[1, 1])
    else:
        roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    return pose[:3, 3], np.degrees([roll, pitch, yaw])


def rotation_angle_rad(transforms: Array) -> Array:
    """Angle of each rotation, accurate for small angles, too."""
    q = quaternions(transforms)
    angles: Array = 2 * np.arctan2(np.linalg.norm(q[:, :3], axis=1), q[:, 3])
    return angles


def mounting(configs: Mapping[str, Mapping[str, Any]]) -> Array:
    """T_base_lidar from the stages' own configuration; raises ValueError if it is in none."""
    for values in configs.values():
        if "mounting.xyz_m" in values:
            return from_xyz_rpy_deg(values["mounting.xyz_m"], values["mounting.rpy_deg"])
    raise ValueError("no stage said its mounting")


def mounting_shown(configs: Mapping[str, Mapping[str, Any]]) -> Array:
    """T_base_lidar for display: if no stage told it, the identity."""
    told = any("mounting.xyz_m" in values for values in configs.values())
    return mounting(configs) if told else np.eye(4)
