"""Poses of lidar and IMU on the robot from a recording's static transforms (tf_static, REP 105)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import se3
from zloam_monitor.recordings import Refused
from zloam_monitor.recordings.bags import TF_TOPIC, Bag, Topic

BASE = "base_link"
#: Deviation from unit length that is allowed for rounding.
UNIT_TOLERANCE = 1e-3

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Mounting:
    """Poses in base_link; None: the frame is not in the tree."""

    base: str
    T_base_lidar: Matrix | None
    T_base_imu: Matrix | None


def _plain(frame: str) -> str:
    return frame.strip("/")


def _matrix(transform: Any, frame: str) -> Matrix:
    r, t = transform.rotation, transform.translation
    q, xyz = np.array([r.x, r.y, r.z, r.w]), np.array([t.x, t.y, t.z])
    if not np.isfinite([*q, *xyz]).all() or abs(np.linalg.norm(q) - 1.0) > UNIT_TOLERANCE:
        raise Refused(f"{TF_TOPIC}: the transform of {frame} is no rotation and translation")
    return np.asarray(se3.matrices(xyz[None], (q / np.linalg.norm(q))[None])[0])


class Tree:
    """Static transforms: child frame -> parent frame and pose in it."""

    def __init__(self, messages: Iterable[Any]) -> None:
        self._parents: dict[str, tuple[str, Matrix]] = {}
        for message in messages:
            for each in message.transforms:
                child = _plain(each.child_frame_id)
                parent = _plain(each.header.frame_id)
                self._parents[child] = (parent, _matrix(each.transform, child))

    def __len__(self) -> int:
        return len(self._parents)

    def _above(self, frame: str) -> dict[str, Matrix]:
        """The frame itself and each frame above it -> pose of the frame in it."""
        pose, found = np.eye(4), {frame: np.eye(4)}
        while frame in self._parents:
            frame, T_parent_child = self._parents[frame]
            if frame in found:
                raise Refused(f"{TF_TOPIC}: {frame} is above itself")
            pose = T_parent_child @ pose
            found[frame] = pose
        return found

    def base_of(self, frame: str) -> str | None:
        """The frame base_link, with or without a robot's prefix, of the same tree."""
        top = list(self._above(frame))[-1]
        frames = {*self._parents, *(parent for parent, _ in self._parents.values())}
        bases = [f for f in frames if f.split("/")[-1] == BASE and list(self._above(f))[-1] == top]
        return bases[0] if len(bases) == 1 else None

    def pose(self, base: str, frame: str) -> Matrix | None:
        """T_base_frame; None: no static transforms connect the two frames."""
        of_base, of_frame = self._above(base), self._above(frame)
        for common, pose in of_frame.items():
            if common in of_base:
                return np.asarray(np.linalg.inv(of_base[common]) @ pose)
        return None


def found(tree: Tree, lidar_frame: str, imu_frame: str | None) -> Mounting | None:
    """Mounting of lidar and IMU; None: the lidar's tree has no base_link."""
    lidar = _plain(lidar_frame)
    base = tree.base_of(lidar)
    if base is None:
        return None
    imu = None if imu_frame is None else tree.pose(base, _plain(imu_frame))
    return Mounting(base, tree.pose(base, lidar), imu)


def _settings(prefix: str, pose: Matrix) -> list[str]:
    xyz, rpy_deg = se3.to_xyz_rpy_deg(pose)

    def text(values: Matrix) -> str:
        return "[" + ", ".join(f"{value + 0.0:.9g}" for value in values) + "]"

    return [f"mounting.{prefix}xyz_m={text(xyz)}", f"mounting.{prefix}rpy_deg={text(rpy_deg)}"]


def settings(mounting: Mounting) -> list[str]:
    """The stages' options --set."""
    named = (("", mounting.T_base_lidar), ("imu_", mounting.T_base_imu))
    return [text for prefix, pose in named if pose is not None for text in _settings(prefix, pose)]


def described(bag: Bag, topic: Topic, imu: str | None) -> tuple[list[str], str]:
    """Settings, and a text about them; both are empty if the recording has no static transforms.

    imu: topic of the IMU readings in use.
    """
    tree = Tree(bag.static_transforms())
    lidar = bag.frame_of(topic.name)
    if not len(tree) or not lidar:
        return [], ""
    mounting = found(tree, lidar, bag.frame_of(imu) if imu else None)
    if mounting is None:
        return [], f"{TF_TOPIC} leads from {lidar} to no {BASE}: poses are the lidar's own"
    words = settings(mounting)
    if imu and mounting.T_base_imu is None:
        raise Refused(
            f"{TF_TOPIC} has no frame {bag.frame_of(imu)!r} of {imu}: say by mounting.imu_xyz_m "
            "and mounting.imu_rpy_deg where the IMU sits"
        )
    return words, f"{lidar} in {mounting.base}, by {TF_TOPIC}: {', '.join(words)}"
