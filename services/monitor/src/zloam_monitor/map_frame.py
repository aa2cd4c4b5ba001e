"""T_map_odom from a sweep's pose in the map and its odometry pose, in whichever order they come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import se3
from zloam_monitor.records import PoseRecord

Matrix = NDArray[np.float64]
#: Limit on sweeps of which one of the two poses is missing.
MOST_WAITING = 100


def matrix(pose: PoseRecord) -> Matrix:
    """T_map_base or T_odom_base, 4 x 4."""
    return np.asarray(se3.matrices(pose.translation[None], pose.quaternion[None])[0])


class MapFrame:
    """Joins the poses of one run."""

    def __init__(self) -> None:
        self._odometry: dict[int, PoseRecord] = {}
        self._poses: dict[int, PoseRecord] = {}

    def clear(self) -> None:
        """Forgets all poses, for a new run."""
        self._odometry.clear()
        self._poses.clear()

    def of_pose(self, pose: PoseRecord) -> Matrix | None:
        """T_map_odom if the sweep's odometry pose has come, too."""
        odometry = self._odometry.pop(pose.sweep, None)
        if odometry is None:
            _keep(self._poses, pose)
            return None
        return np.asarray(matrix(pose) @ se3.inverse(matrix(odometry)))

    def of_odometry(self, odometry: PoseRecord) -> Matrix | None:
        """T_map_odom if the sweep's pose in the map has come, too."""
        pose = self._poses.pop(odometry.sweep, None)
        if pose is None:
            _keep(self._odometry, odometry)
            return None
        return np.asarray(matrix(pose) @ se3.inverse(matrix(odometry)))


def _keep(waiting: dict[int, PoseRecord], pose: PoseRecord) -> None:
    waiting[pose.sweep] = pose
    while len(waiting) > MOST_WAITING:
        waiting.pop(next(iter(waiting)))
