"""Map points: gathered from tiles, written as PCD (read by PCL, Open3D, CloudCompare)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.files import written_whole
from zloam_monitor.messages import MAP_POINT

#: Layers of the map that contain points for display.
POINT_LAYERS = ("edge", "plane")
#: Record of a point in a map file.
LAYERED_POINT = np.dtype([*MAP_POINT.descr, ("layer", "u1")])


@dataclass(frozen=True)
class Tile:
    """One cube of one layer of the map, frame map."""

    layer: str
    index: tuple[int, int, int]
    version: int
    points: NDArray[Any]
    #: Identifies the map that the tile belongs to; a reset begins a new map.
    map_id: int = 0


def merged(tiles: list[Tile]) -> tuple[NDArray[Any], NDArray[np.uint8]]:
    """All points in the order (tile, layer, insertion), and each point's layer: 0 edge, 1 plane."""
    ordered = sorted(tiles, key=lambda tile: (tile.index, tile.layer))
    if not ordered:
        return np.empty(0, MAP_POINT), np.empty(0, np.uint8)
    layers = [np.full(len(t.points), 0 if t.layer == "edge" else 1, np.uint8) for t in ordered]
    return np.concatenate([t.points for t in ordered]), np.concatenate(layers)


def layered(points: NDArray[Any], layers: NDArray[np.uint8]) -> NDArray[Any]:
    """Points and layers as an array of LAYERED_POINT."""
    rows = np.empty(len(points), LAYERED_POINT)
    for name in MAP_POINT.names or ():
        rows[name] = points[name]
    rows["layer"] = layers
    return rows


def write_pcd(
    path: Path,
    points: NDArray[Any],
    layers: NDArray[np.uint8],
    notes: Sequence[str] = (),
) -> None:
    """Writes binary PCD 0.7 with x y z intensity (float32) and layer (uint8: 0 edge, 1 plane).
    notes: comment lines for the header, which readers skip."""
    rows = layered(points, layers)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\n"
        + "".join(f"# {note}\n" for note in notes)
        + "VERSION 0.7\nFIELDS x y z intensity layer\nSIZE 4 4 4 4 1\nTYPE F F F F U\n"
        f"COUNT 1 1 1 1 1\nWIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(rows)}\nDATA binary\n"
    )
    with written_whole(path, "wb") as out:
        out.write(header.encode())
        out.write(rows.tobytes())


def read_pcd(path: Path) -> NDArray[Any]:
    """Reads a file written by write_pcd."""
    data = path.read_bytes()
    marker = b"DATA binary\n"
    start = data.index(marker) + len(marker)
    return np.frombuffer(data, LAYERED_POINT, -1, start)
