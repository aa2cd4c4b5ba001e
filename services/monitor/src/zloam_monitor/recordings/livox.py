"""Converts Livox's own message (livox_ros_driver, livox_ros_driver2: CustomMsg) to a cloud."""

from __future__ import annotations

from typing import Any

import numpy as np

from zloam_monitor.recordings.fields import Cloud, Names, stamp_ns

KINDS = tuple(f"{package}/msg/CustomMsg" for package in ("livox_ros_driver", "livox_ros_driver2"))
#: Type -> message definition, as in the drivers.
TYPES = {
    **{
        kind.replace("Msg", "Point"): "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\n"
        "uint8 reflectivity\nuint8 tag\nuint8 line\n"
        for kind in KINDS
    },
    **{
        kind: "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n"
        f"uint8[3] rsvd\n{kind.replace('msg/CustomMsg', 'CustomPoint')}[] points\n"
        for kind in KINDS
    },
}
NAMES = Names("offset_time", "line", "reflectivity")
COLUMNS = {
    "offset_time": "u4",
    "x": "f4",
    "y": "f4",
    "z": "f4",
    "reflectivity": "u1",
    "line": "u1",
}


def is_custom(message: Any) -> bool:
    return hasattr(message, "timebase")


def cloud_of(message: Any) -> Cloud:
    """The returns of a message; a point without a return has the coordinates 0, 0, 0."""
    column = {
        name: np.array([getattr(p, name) for p in message.points], kind)
        for name, kind in COLUMNS.items()
    }
    xyz = np.stack([column[axis] for axis in ("x", "y", "z")], axis=-1).astype(np.float32)
    returned = np.isfinite(xyz).all(axis=1) & (xyz != 0.0).any(axis=1)
    return Cloud(
        stamp_ns=stamp_ns(message.header.stamp),
        xyz=xyz[returned],
        intensity=column["reflectivity"][returned].astype(np.float32),
        ring=column["line"][returned],
        times=column["offset_time"][returned],
        row=None,
        column=None,
    )
