"""Messages of Foxglove's published FlatBuffers schemas (package foxglove-schemas-flatbuffer)."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import flatbuffers
import numpy as np
from numpy.typing import NDArray

PACKAGE = "foxglove_schemas_flatbuffer"
Numbers = Sequence[float] | NDArray[np.float64]
#: Values of LogLevel.
INFO, WARNING, ERROR = 2, 3, 4
#: Values of NumericType.
_UINT8, _FLOAT32 = 1, 7


@dataclass(frozen=True)
class Transform:
    """A transform T_parent_child."""

    parent: str
    child: str
    stamp_ns: int
    translation: Numbers
    #: Order x y z w.
    quaternion: Numbers


def schema(name: str) -> tuple[str, bytes]:
    """Name and binary schema of a root table."""
    return f"foxglove.{name}", _binary_schema(name)


@cache
def _binary_schema(name: str) -> bytes:
    return bytes(importlib.import_module(PACKAGE).get_schema(name))


@cache
def _module(name: str) -> Any:
    return importlib.import_module(f"{PACKAGE}.{name}")


def _time(b: Any, stamp_ns: int) -> int:
    return int(_module("Time").CreateTime(b, stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000))


def _numbers(b: Any, table: str, names: str, values: Numbers) -> int:
    of = _module(table)
    of.Start(b)
    for name, value in zip(names, values, strict=True):
        getattr(of, f"Add{name.upper()}")(b, float(value))
    return int(of.End(b))


def _pose(b: Any, translation: Numbers, quaternion: Numbers) -> int:
    position = _numbers(b, "Vector3", "xyz", translation)
    orientation = _numbers(b, "Quaternion", "xyzw", quaternion)
    of = _module("Pose")
    of.Start(b)
    of.AddPosition(b, position)
    of.AddOrientation(b, orientation)
    return int(of.End(b))


def _vector(b: Any, items: Sequence[int]) -> int:
    b.StartVector(4, len(items), 4)
    for item in reversed(items):
        b.PrependUOffsetTRelative(item)
    return int(b.EndVector())


def _finished(b: Any, root: int) -> bytes:
    b.Finish(root)
    return bytes(b.Output())


def frame_transforms(transforms: Sequence[Transform]) -> bytes:
    """A message foxglove.FrameTransforms."""
    b = flatbuffers.Builder(256 * len(transforms) + 64)
    made = []
    of = _module("FrameTransform")
    for each in transforms:
        parent, child = b.CreateString(each.parent), b.CreateString(each.child)
        translation = _numbers(b, "Vector3", "xyz", each.translation)
        rotation = _numbers(b, "Quaternion", "xyzw", each.quaternion)
        of.Start(b)
        of.AddTimestamp(b, _time(b, each.stamp_ns))
        of.AddParentFrameId(b, parent)
        of.AddChildFrameId(b, child)
        of.AddTranslation(b, translation)
        of.AddRotation(b, rotation)
        made.append(of.End(b))
    listed = _vector(b, made)
    of = _module("FrameTransforms")
    of.Start(b)
    of.AddTransforms(b, listed)
    return _finished(b, of.End(b))


def pose_in_frame(frame: str, stamp_ns: int, translation: Numbers, quaternion: Numbers) -> bytes:
    """A message foxglove.PoseInFrame."""
    b = flatbuffers.Builder(256)
    name = b.CreateString(frame)
    pose = _pose(b, translation, quaternion)
    of = _module("PoseInFrame")
    of.Start(b)
    of.AddTimestamp(b, _time(b, stamp_ns))
    of.AddFrameId(b, name)
    of.AddPose(b, pose)
    return _finished(b, of.End(b))


def poses_in_frame(frame: str, stamp_ns: int, poses: Sequence[tuple[Numbers, Numbers]]) -> bytes:
    """A message foxglove.PosesInFrame; poses: (translation, quaternion)."""
    b = flatbuffers.Builder(128 * len(poses) + 64)
    name = b.CreateString(frame)
    listed = _vector(b, [_pose(b, t, q) for t, q in poses])
    of = _module("PosesInFrame")
    of.Start(b)
    of.AddTimestamp(b, _time(b, stamp_ns))
    of.AddFrameId(b, name)
    of.AddPoses(b, listed)
    return _finished(b, of.End(b))


def point_cloud(frame: str, stamp_ns: int, points: NDArray[Any]) -> bytes:
    """A message foxglove.PointCloud; the fields of the points are float32 or uint8."""
    b = flatbuffers.Builder(points.nbytes + 1024)
    data = b.CreateByteVector(points.tobytes())
    name = b.CreateString(frame)
    pose = _pose(b, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    fields = []
    of = _module("PackedElementField")
    for field, (kind, offset, *_) in (points.dtype.fields or {}).items():
        label = b.CreateString(field)
        of.Start(b)
        of.AddName(b, label)
        of.AddOffset(b, offset)
        of.AddType(b, _FLOAT32 if kind == np.float32 else _UINT8)
        fields.append(of.End(b))
    listed = _vector(b, fields)
    of = _module("PointCloud")
    of.Start(b)
    of.AddTimestamp(b, _time(b, stamp_ns))
    of.AddFrameId(b, name)
    of.AddPose(b, pose)
    of.AddPointStride(b, points.dtype.itemsize)
    of.AddFields(b, listed)
    of.AddData(b, data)
    return _finished(b, of.End(b))


def log(stamp_ns: int, level: int, name: str, message: str) -> bytes:
    """A message foxglove.Log."""
    b = flatbuffers.Builder(len(message) + 256)
    who, what = b.CreateString(name), b.CreateString(message)
    of = _module("Log")
    of.Start(b)
    of.AddTimestamp(b, _time(b, stamp_ns))
    of.AddLevel(b, level)
    of.AddName(b, who)
    of.AddMessage(b, what)
    return _finished(b, of.End(b))


def arrow(frame: str, stamp_ns: int, name: str, quaternion: Numbers, length_m: float) -> bytes:
    """A message foxglove.SceneUpdate with an arrow along the x axis rotated by the quaternion. With
    length 0 there is no arrow, which removes one shown before."""
    b = flatbuffers.Builder(512)
    arrows = [_arrow(b, quaternion, length_m)] if length_m > 0.0 else []
    listed = _vector(b, arrows)
    frame_name, id_name = b.CreateString(frame), b.CreateString(name)
    of = _module("SceneEntity")
    of.Start(b)
    of.AddTimestamp(b, _time(b, stamp_ns))
    of.AddFrameId(b, frame_name)
    of.AddId(b, id_name)
    of.AddFrameLocked(b, True)
    of.AddArrows(b, listed)
    entities = _vector(b, [of.End(b)])
    of = _module("SceneUpdate")
    of.Start(b)
    of.AddEntities(b, entities)
    return _finished(b, of.End(b))


def _arrow(b: Any, quaternion: Numbers, length_m: float) -> int:
    pose = _pose(b, (0.0, 0.0, 0.0), quaternion)
    color = _numbers(b, "Color", "rgba", (0.84, 0.15, 0.16, 0.9))
    of = _module("ArrowPrimitive")
    of.Start(b)
    of.AddPose(b, pose)
    of.AddShaftLength(b, 0.75 * length_m)
    of.AddShaftDiameter(b, 0.06 * length_m)
    of.AddHeadLength(b, 0.25 * length_m)
    of.AddHeadDiameter(b, 0.14 * length_m)
    of.AddColor(b, color)
    return int(of.End(b))
