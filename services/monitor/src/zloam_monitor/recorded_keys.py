"""Keys that `record` subscribes to, and the schemas of their messages."""

from __future__ import annotations

from functools import cache

from zloam_monitor import messages
from zloam_monitor.keys import Keys

#: Keys below the robot's with messages that the stages can compute again from the sweeps, or that
#: show the contents of other keys in another form: recorded with Options.everything of
#: recorder.py.
DERIVED = (
    "lidar/*/features",
    "lidar/*/rejected",
    "odometry/features",
    "odometry/progress",
    "map/surround",
    "map/cloud",
    "sweep/registered",
    "odometry/sweep",
    "map/submap",
    "preview",
)


@cache
def schema_of(identifier: bytes) -> tuple[str, bytes] | None:
    """Name and binary schema of the message with this identifier; None: not a zloam message."""
    table = messages.TABLES.get(identifier)
    if table is None:
        return None
    path = messages.schemas_path() / "zloam" / "bfbs" / f"{messages.KINDS[table].schema}.bfbs"
    return f"zloam.msg.{table}", path.read_bytes()


def expressions(keys: Keys, scene: bool, everything: bool) -> list[str]:
    """Keys to record. A subscription to all keys would make the stages publish messages that they
    make only for subscribers. The list has no keys that begin with @, which the stages use among
    themselves."""
    wanted = [
        keys.below("lidar/*/packets"),
        keys.below("lidar/*/sweep"),
        keys.below("lidar/*/angle"),
        keys.below("imu/*"),
        keys.below("gnss/*"),
        keys.odometry,
        keys.pose,
        keys.map_correction,
        keys.map_odometry,
        keys.tiles,
        keys.graph_loop,
        keys.graph_poses,
        keys.every_status,
        keys.every_revision,
    ]
    if scene:
        wanted.append(keys.odometry_sweep)
    if everything:
        wanted += map(keys.below, DERIVED)
    return list(dict.fromkeys(wanted))
