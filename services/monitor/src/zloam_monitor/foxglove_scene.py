"""Makes Foxglove's messages for a robot from the messages that anybody can subscribe to.

Frames as in ROS (REP 105): map -> odom moves with the map's corrections, odom -> base_link is
smooth, base_link -> lidar is constant.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import foxglove_messages as foxglove
from zloam_monitor import messages, records, se3
from zloam_monitor.clouds import POINT_LAYERS, Tile
from zloam_monitor.foxglove_messages import Numbers, Transform
from zloam_monitor.intake import Sample
from zloam_monitor.keys import Keys
from zloam_monitor.map_frame import MapFrame, Matrix
from zloam_monitor.records import PoseRecord
from zloam_monitor.watch import STALE_SECONDS

#: Topic -> schema.
TOPICS = {
    "/tf": "FrameTransforms",
    "/pose": "PoseInFrame",
    "/odometry": "PoseInFrame",
    "/path": "PosesInFrame",
    "/points": "PointCloud",
    "/map": "PointCloud",
    "/log": "Log",
    "/weak_direction": "SceneUpdate",
}
#: Points of the map in one message; a larger map is thinned.
MOST_MAP_POINTS = 400_000
#: Poses of the path in one message, evenly spaced.
MOST_PATH_POSES = 1000
_LEVELS = {
    "failed": foxglove.ERROR,
    "silent": foxglove.ERROR,
    "degraded": foxglove.WARNING,
}


@dataclass(frozen=True)
class Shown:
    """One message for Foxglove."""

    topic: str
    stamp_ns: int
    data: bytes

    @property
    def schema(self) -> tuple[str, bytes]:
        return foxglove.schema(TOPICS[self.topic])


def expressions(keys: Keys) -> list[str]:
    """Keys that a scene needs."""
    return [
        keys.pose,
        keys.odometry,
        keys.odometry_sweep,
        keys.tiles,
        keys.every_status,
    ]


class Scene:
    """State of one robot; take() returns the messages that a sample leads to. Map and path are
    repeated at most every `every_s` seconds, if they grew."""

    def __init__(self, keys: Keys, every_s: float, T_base_lidar: NDArray[np.float64]):
        self._keys, self._every_s = keys, every_s
        self._T_base_lidar = T_base_lidar
        self._run: int | None = None
        self._frame = MapFrame()
        self._path: list[tuple[Numbers, Numbers]] = []
        self._every_nth = 1
        self._poses = 0
        self._tiles: dict[tuple[str, tuple[int, int, int]], Tile] = {}
        self._map_id: int | None = None
        self._map_grew = False
        self._said: dict[tuple[str, str], tuple[str, str]] = {}
        #: (stage, instance) -> monotonic time at which its newest status was taken.
        self._heard_s: dict[tuple[str, str], float] = {}
        self._weak = False
        self._shown_s = {"/map": 0.0, "/path": 0.0}

    def take(self, sample: Sample) -> list[Shown]:
        """Messages for one sample, if it is part of the scene; raises DECODE_ERRORS."""
        keys = self._keys
        if sample.key == keys.pose:
            return list(self._pose(records.map_pose(sample.payload)))
        if sample.key == keys.odometry:
            return list(self._odometry_pose(records.odometry(sample.payload)))
        if sample.key == keys.odometry_sweep:
            return [_cloud(sample.payload)]
        if sample.key.startswith(keys.below("map/tile/")):
            return list(self._tile(records.tile(sample.payload), sample.received_ns))
        if "/service/" in sample.key and sample.key.endswith("/status"):
            return list(self._status(records.status(sample.payload)))
        return []

    def _pose(self, pose: PoseRecord) -> Iterator[Shown]:
        if pose.run != self._run:
            self._begin(pose.run)
        stamp_ns = pose.instant_ns
        yield Shown(
            "/pose",
            stamp_ns,
            foxglove.pose_in_frame("map", stamp_ns, pose.translation, pose.quaternion),
        )
        yield from _map_to_odom(stamp_ns, self._frame.of_pose(pose))
        yield from self._weak_direction(pose)
        self._extend(pose.translation, pose.quaternion)
        if self._is_due("/path"):
            every = -(-len(self._path) // MOST_PATH_POSES)
            path = foxglove.poses_in_frame("map", stamp_ns, self._path[::every])
            yield Shown("/path", stamp_ns, path)

    def _extend(self, translation: Numbers, quaternion: Numbers) -> None:
        if self._poses % self._every_nth == 0:
            self._path.append((translation, quaternion))
        self._poses += 1
        if len(self._path) >= 2 * MOST_PATH_POSES:
            self._path, self._every_nth = self._path[::2], 2 * self._every_nth

    def keep_path(self, run: int, poses: NDArray[Any]) -> None:
        """Sets the path of the run so far (messages.STAMPED_POSE)."""
        if not len(poses):
            return
        self._begin(run)
        for pose in poses["pose"]:
            self._extend(pose["translation"].tolist(), pose["rotation"].tolist())

    def _begin(self, run: int) -> None:
        """Begins a new run: forgets the poses of the one before. The map may be the same."""
        self._run = run
        self._frame.clear()
        self._clear_path()

    def _clear_path(self) -> None:
        self._path.clear()
        self._poses, self._every_nth = 0, 1

    def _is_due(self, topic: str) -> bool:
        now = time.monotonic()
        if now - self._shown_s[topic] < self._every_s:
            return False
        self._shown_s[topic] = now
        return True

    def _odometry_pose(self, pose: PoseRecord) -> Iterator[Shown]:
        stamp_ns = pose.instant_ns
        yield from _map_to_odom(stamp_ns, self._frame.of_odometry(pose))
        lidar = self._T_base_lidar
        moved = Transform("odom", "base_link", stamp_ns, pose.translation, pose.quaternion)
        mounted = Transform(
            "base_link",
            self._keys.sensor,
            stamp_ns,
            lidar[:3, 3],
            se3.quaternions(lidar[None])[0],
        )
        yield Shown("/tf", stamp_ns, foxglove.frame_transforms([moved, mounted]))
        made = foxglove.pose_in_frame("odom", stamp_ns, pose.translation, pose.quaternion)
        yield Shown("/odometry", stamp_ns, made)

    def _weak_direction(self, pose: PoseRecord) -> Iterator[Shown]:
        """An arrow while a direction is degenerate, and its removal afterwards."""
        weak = pose.degenerate and any(pose.weak_translation)
        if not weak and not self._weak:
            return
        self._weak = weak
        made = foxglove.arrow(
            "base_link",
            pose.instant_ns,
            "weak direction",
            _from_x(np.array(pose.weak_translation)) if weak else (0.0, 0.0, 0.0, 1.0),
            3.0 if weak else 0.0,
        )
        yield Shown("/weak_direction", pose.instant_ns, made)

    def keep(self, tile: Tile) -> None:
        """Adds a tile without a message, e.g. one from before this program's start. The first tile
        of another map ends the one before, and the path in it: a reset begins another frame."""
        if tile.map_id != self._map_id:
            if self._map_id is not None:
                self._clear_path()
            self._map_id = tile.map_id
            self._tiles.clear()
        if tile.layer in POINT_LAYERS:
            self._tiles[(tile.layer, tile.index)] = tile
            self._map_grew = True

    def _tile(self, tile: Tile, received_ns: int) -> Iterator[Shown]:
        self.keep(tile)
        if self._map_grew and self._is_due("/map"):
            yield self.map(received_ns)

    def map(self, stamp_ns: int) -> Shown:
        """The tiles received so far as one cloud, thinned if it is too large."""
        self._map_grew = False
        of_tiles = [tile.points for tile in self._tiles.values()]
        points = np.concatenate(of_tiles) if of_tiles else np.empty(0, messages.MAP_POINT)
        every = max(1, -(-len(points) // MOST_MAP_POINTS))
        return Shown("/map", stamp_ns, foxglove.point_cloud("map", stamp_ns, points[::every]))

    def last(self, stamp_ns: int) -> list[Shown]:
        """The map, if it grew since the last message."""
        return [self.map(stamp_ns)] if self._map_grew else []

    def whole(self, stamp_ns: int) -> list[Shown]:
        """For viewers that connect later: the map, and the last statement of each stage. That of a
        stage that is no longer heard is outdated: once, a message that it is silent replaces it."""
        gone = list(self._gone(stamp_ns))
        said = [self._log(stage, stamp_ns, *says) for (stage, _), says in self._said.items()]
        return [*gone, *said, *([self.map(stamp_ns)] if self._tiles else [])]

    def _gone(self, stamp_ns: int) -> Iterator[Shown]:
        now = time.monotonic()
        for who in [w for w, heard_s in self._heard_s.items() if now - heard_s > STALE_SECONDS]:
            del self._heard_s[who]
            health, _ = self._said.pop(who)
            if health != "stopping":
                yield self._log(who[0], stamp_ns, "silent", f"nothing more is heard of {who[1]}")

    def _status(self, status: records.StatusRecord) -> Iterator[Shown]:
        """A log message if a stage's health or reason changed."""
        who, says = (status.stage, status.instance), (status.health, status.reason)
        self._heard_s[who] = time.monotonic()
        if self._said.get(who) == says:
            return
        self._said[who] = says
        yield self._log(status.stage, status.stamp_ns, *says)

    def _log(self, stage: str, stamp_ns: int, health: str, reason: str) -> Shown:
        text = health + (f": {reason}" if reason else "")
        level = _LEVELS.get(health, foxglove.INFO)
        return Shown("/log", stamp_ns, foxglove.log(stamp_ns, level, stage, text))


def _map_to_odom(stamp_ns: int, T_map_odom: Matrix | None) -> Iterator[Shown]:
    if T_map_odom is not None:
        quaternion = se3.quaternions(T_map_odom[None])[0]
        transform = Transform("map", "odom", stamp_ns, T_map_odom[:3, 3], quaternion)
        yield Shown("/tf", stamp_ns, foxglove.frame_transforms([transform]))


def _cloud(payload: bytes) -> Shown:
    table = messages.decode("Cloud", payload)
    header = table.Header()
    if header is None:
        raise messages.MessageError("a cloud without a header")
    points = messages.struct_vector(table, "Points", messages.MAP_POINT)
    stamp_ns = table.InstantNs()
    frame = messages.text(header.Frame())
    return Shown("/points", stamp_ns, foxglove.point_cloud(frame, stamp_ns, points))


def _from_x(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """The quaternion (x y z w) that rotates the x axis into the direction."""
    unit = direction / np.linalg.norm(direction)
    if unit[0] < -1.0 + 1e-9:
        return np.array([0.0, 0.0, 1.0, 0.0])
    half = np.array([0.0, -unit[2], unit[1], 1.0 + unit[0]])
    return np.asarray(half / np.linalg.norm(half))
