"""Reads PCD, PLY, LAS and LAZ files as structured arrays with the names of their fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import ply


def _whole(points: NDArray[Any], named: int) -> NDArray[Any]:
    """Refuses a file that was cut off between two points, which the libraries take for a whole
    one."""
    if len(points) != named:
        raise ValueError(
            f"{len(points)} of the {named} points that its header names are in it: copy it again"
        )
    return points


def _pcd(path: Path) -> tuple[NDArray[Any], int, int]:
    from pypcd4 import PointCloud

    cloud = PointCloud.from_path(path)
    # The library returns a single line of an ASCII file without a dimension.
    points = _whole(np.atleast_1d(cloud.pc_data), int(cloud.metadata.points))
    return points, int(cloud.metadata.width), int(cloud.metadata.height)


def _ply(path: Path) -> tuple[NDArray[Any], int, int]:
    points = ply.vertices(path)
    return points, len(points), 1


def _las(path: Path) -> tuple[NDArray[Any], int, int]:
    import laspy

    las = laspy.read(path)
    _whole(las.points.array, int(las.header.point_count))
    names = [n for n in las.point_format.dimension_names if n not in ("X", "Y", "Z")]
    columns = {n: np.asarray(las[n]) for n in ("x", "y", "z", *names)}
    points = np.empty(len(las), [(n, c.dtype) for n, c in columns.items()])
    for name, column in columns.items():
        points[name] = column
    return points, len(points), 1


#: Suffix -> reader that returns the points, and width and height of an organised cloud.
READERS = {".pcd": _pcd, ".ply": _ply, ".las": _las, ".laz": _las}
