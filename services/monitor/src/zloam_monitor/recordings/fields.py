"""Converts a PointCloud2 to columns of numbers (sensor_msgs/msg/PointCloud2, PointField)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.recordings import Refused

Column = NDArray[Any]
#: PointField.datatype -> numpy.
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
#: Names that drivers use for the fields, in lower case.
TIMES = (
    "t",
    "time",
    "timestamp",
    "offset_time",
    "time_stamp",
    "time_offset",
    "offsettime",
    "ts",
    "gps_time",
)
RINGS = ("ring", "channel", "line", "laser_id", "laserid")
INTENSITIES = ("intensity", "i", "reflectivity", "intensities", "signal")


@dataclass(frozen=True)
class Cloud:
    """Returns of one cloud: columns with one row per return."""

    stamp_ns: int
    #: In m, along the sensor's axes.
    xyz: NDArray[np.float32]
    intensity: NDArray[np.float32]
    #: Values as published.
    ring: Column | None
    times: Column | None
    #: Row and column in an organised cloud.
    row: Column | None
    column: Column | None

    def __len__(self) -> int:
        return len(self.xyz)

    def only(self, wanted: NDArray[np.bool_]) -> Cloud:
        """The cloud with the wanted ones of its returns."""
        columns = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "stamp_ns"}
        kept: dict[str, Any] = {n: c if c is None else c[wanted] for n, c in columns.items()}
        return replace(self, **kept)


@dataclass(frozen=True)
class Names:
    """Names of the fields for time, ring and intensity."""

    time: str | None
    ring: str | None
    intensity: str | None


def _dtype(message: Any) -> np.dtype[Any]:
    order = ">" if message.is_bigendian else "<"
    # A count of 0 is one value: so old drivers write it, and so PCL reads it.
    fields = [f for f in message.fields if f.name]
    for field in fields:
        if field.datatype not in TYPES:
            raise Refused(f"field {field.name}: its datatype {field.datatype} is none of 1 to 8")
    formats = [
        (order + TYPES[f.datatype], (f.count,)) if f.count > 1 else order + TYPES[f.datatype]
        for f in fields
    ]
    names, offsets = [f.name for f in fields], [f.offset for f in fields]
    if len(set(names)) < len(names):
        raise Refused(f"two fields of one name among {', '.join(names)}")
    try:
        return np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": message.point_step}
        )
    except (ValueError, TypeError) as error:
        raise Refused(f"its fields do not fit in a point of {message.point_step} bytes") from error


def points_of(message: Any) -> NDArray[Any]:
    """All points in their order, structured by the names of the fields; rows may be padded."""
    dtype, width, height = _dtype(message), int(message.width), int(message.height)
    data = np.frombuffer(message.data, np.uint8)
    row_bytes = width * dtype.itemsize
    step = int(message.row_step) if height > 1 else row_bytes
    if step < row_bytes or len(data) < (height - 1) * step + row_bytes:
        raise Refused(
            f"its data have {len(data)} bytes, not those of {height} rows of {width} points of "
            f"{dtype.itemsize} bytes (row_step {message.row_step})"
        )
    if width * height == 0:
        return np.empty(0, dtype)
    rows = [data[r * step : r * step + row_bytes] for r in range(height)]
    return np.concatenate(rows).view(dtype)


def _one(known: tuple[str, ...], there: list[str]) -> list[str]:
    return [name for name in there if name.lower() in known]


def names_of(there: list[str], time_field: str) -> Names:
    """Chooses the fields; refused if two fields could contain the time."""
    listed = ", ".join(there) or "none"
    for name in ("x", "y", "z"):
        if name not in there:
            raise Refused(f"there is no field {name}; fields: {listed}")
    if time_field and time_field not in there:
        raise Refused(f"there is no field {time_field} (driver.time_field); fields: {listed}")
    times = [time_field] if time_field else _one(TIMES, there)
    if len(times) > 1:
        raise Refused(
            f"fields {' and '.join(times)}: which of them has the points' times is not known; "
            f"say so by driver.time_field={times[0]}"
        )
    rings, intensities = _one(RINGS, there), _one(INTENSITIES, there)
    return Names(
        times[0] if times else None,
        rings[0] if rings else None,
        intensities[0] if intensities else None,
    )


def cloud_of(message: Any, names: Names) -> Cloud:
    """The returns in a message."""
    stamp = stamp_ns(message.header.stamp)
    return returns_of(points_of(message), names, stamp, message.width, message.height)


def returns_of(points: NDArray[Any], names: Names, stamp_ns: int, width: int, height: int) -> Cloud:
    """The returns among points that are structured by the names of their fields."""
    xyz = np.stack([points[axis].astype(np.float32) for axis in ("x", "y", "z")], axis=-1)
    returned = np.isfinite(xyz).all(axis=1) & (xyz != 0.0).any(axis=1)

    def column(name: str | None) -> Column | None:
        return None if name is None else points[name][returned]

    place = np.flatnonzero(returned)
    organised = height > 1 and width > 1
    intensity = column(names.intensity)
    return Cloud(
        stamp_ns=stamp_ns,
        xyz=xyz[returned],
        intensity=np.zeros(len(place), np.float32)
        if intensity is None
        else np.nan_to_num(intensity.astype(np.float32)),
        ring=column(names.ring),
        times=column(names.time),
        row=place // width if organised else None,
        column=place % width if organised else None,
    )


def stamp_ns(stamp: Any) -> int:
    """Stamp of ROS 1 or 2 in ns."""
    return int(stamp.sec) * 1_000_000_000 + int(getattr(stamp, "nanosec", 0))
