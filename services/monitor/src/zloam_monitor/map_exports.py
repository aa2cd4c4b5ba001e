"""Maps for other systems: an occupancy grid for Nav2, tiles for Autoware.

Formats: map_server's image and YAML (Nav2), pointcloud_map_metadata.yaml and
map_projector_info.yaml (Autoware's map loaders). Frame and origin are those of the map.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from zloam_monitor.files import written_whole
from zloam_monitor.maps import MapError, MapFileError, MapOptionError, PointMap, cell_numbers, write

#: Pixel values that map_server reads as occupied, free and unknown with the thresholds below.
OCCUPIED, FREE, UNKNOWN = 0, 254, 205
THRESHOLDS = {"occupied_thresh": 0.65, "free_thresh": 0.196}
#: Edge of the squares whose lowest points determine the height of the ground.
GROUND_M = 1.0
#: A map has at most one plane point per voxel of this edge.
PLANE_LEAF_M = 0.4
MOST_CELLS = 100_000_000

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Occupancy grid: cells by row (y) and column (x), from the lower left corner."""

    cells: NDArray[np.uint8]
    cell_m: float
    low: tuple[float, float]

    def count(self, value: int) -> int:
        return int((self.cells == value).sum())


def occupancy(found: PointMap, cell_m: float, height: tuple[float, float]) -> Grid:
    """Occupied: a point lies within these heights above the ground around it; free: only ground
    was seen; unknown otherwise."""
    low_m, high_m = height
    if not 0.0 < low_m < high_m:
        raise MapOptionError(f"--height: {low_m:g} to {high_m:g} m is nothing above the ground")
    if not len(found):
        raise MapError("the map has no points: nothing written")
    xyz = found.xyz
    numbers = cell_numbers(xyz[:, :2], cell_m, "--cell")
    lowest = numbers.min(axis=0)
    above_m = xyz[:, 2] - _ground(xyz)
    at = numbers - lowest
    columns, rows = (int(count) for count in at.max(axis=0) + 1)
    if rows * columns > MOST_CELLS:
        raise MapOptionError(f"{columns} x {rows} cells: a larger --cell is needed")
    obstacle = (above_m >= low_m) & (above_m <= high_m)
    # Closing (dilation, then erosion) by half a voxel fills the gaps between the points of a wall.
    steps = math.ceil(0.5 * PLANE_LEAF_M / cell_m)
    wide = _widened(_marked(at[obstacle], (rows, columns)), steps)
    occupied = ~_widened(~wide, steps)
    ground = _marked(at[np.abs(above_m) < low_m], (rows, columns))
    cells = np.full((rows, columns), UNKNOWN, np.uint8)
    cells[_widened(ground, round(PLANE_LEAF_M / cell_m))] = FREE
    cells[occupied] = OCCUPIED
    return Grid(cells, cell_m, (float(lowest[0] * cell_m), float(lowest[1] * cell_m)))


def _marked(at: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    out = np.zeros(shape, bool)
    out[at[:, 1], at[:, 0]] = True
    return out


def _widened(cells: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """Dilates the marked cells by `steps` in each direction."""
    out = cells.copy()
    for axis in (0, 1):
        once = out.copy()
        for step in range(1, steps + 1):
            ahead = [slice(None), slice(None)]
            behind = [slice(None), slice(None)]
            ahead[axis], behind[axis] = slice(step, None), slice(None, -step)
            out[tuple(ahead)] |= once[tuple(behind)]
            out[tuple(behind)] |= once[tuple(ahead)]
    return out


def _ground(xyz: Array) -> Array:
    """Height of the ground below each point: the median of the lowest points in its square and the
    eight around it, so that neither a wall nor a stray point below the ground counts as ground."""
    at = np.floor(xyz[:, :2] / GROUND_M).astype(np.int64)
    at -= at.min(axis=0)
    columns, rows = at.max(axis=0) + 3
    if rows * columns > MOST_CELLS:
        raise MapError(f"{columns:.0f} x {rows:.0f} m is too wide for a grid: crop it")
    lowest = np.full((rows, columns), np.inf)
    np.minimum.at(lowest, (at[:, 1] + 1, at[:, 0] + 1), xyz[:, 2])
    lowest[np.isinf(lowest)] = np.nan
    squares, which = np.unique(at[:, 1] * columns + at[:, 0], return_inverse=True)
    y, x = squares // columns, squares % columns
    around = np.stack([lowest[y + dy, x + dx] for dy in range(3) for dx in range(3)])
    return np.asarray(np.nanmedian(around, axis=0)[which.ravel()], np.float64)


def write_grid(path: Path, grid: Grid) -> Path:
    """Writes YAML to `path`, which ends with .yaml, and the image beside it; returns the image."""
    if path.suffix.lower() not in {".yaml", ".yml"}:
        raise MapOptionError(f"{path}: .yaml is expected; the image is written beside it")
    image = path.with_suffix(".pgm")
    rows, columns = grid.cells.shape
    with written_whole(image, "wb") as out:
        out.write(f"P5\n{columns} {rows}\n255\n".encode())
        out.write(grid.cells[::-1].tobytes())
    described = {
        "image": image.name,
        "mode": "trinary",
        "resolution": grid.cell_m,
        "origin": [*grid.low, 0.0],
        "negate": 0,
        **THRESHOLDS,
    }
    with written_whole(path) as text:
        yaml.safe_dump(described, text, sort_keys=False)
    return image


def write_autoware(folder: Path, found: PointMap, tile_m: float) -> int:
    """Writes a folder with the tiles, their metadata, and a local projector, as the map is not
    georeferenced: all of it or nothing. Returns the number of tiles."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise MapFileError(f"{folder}: exists already; name a folder that does not")
    if not len(found):
        raise MapError("the map has no points: nothing written")
    tiles, which = np.unique(
        cell_numbers(found.xyz[:, :2], tile_m, "--tile"), axis=0, return_inverse=True
    )
    with _filled(folder) as made:
        _write_tiles(made, found, tiles, which.ravel(), tile_m)
    return len(tiles)


@contextmanager
def _filled(folder: Path) -> Iterator[Path]:
    """A folder whose contents move into this empty or new one at the end of the block."""
    new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(".part", ".", folder) as made:
            yield Path(made)
            # The metadata last: without this file no program takes the folder for a map.
            for each in sorted(Path(made).iterdir()):
                each.rename(folder / each.name)
    except BaseException:
        if new:
            folder.rmdir()
        raise


def _write_tiles(
    folder: Path,
    found: PointMap,
    tiles: NDArray[np.int64],
    which: NDArray[np.int64],
    tile_m: float,
) -> None:
    """tiles: numbers along x and y of each tile; which: the tile of each point."""
    described: dict[str, float | list[float]] = {"x_resolution": tile_m, "y_resolution": tile_m}
    for number, (i, j) in enumerate(tiles):
        name = f"{i}_{j}.pcd"
        write(folder / "pointcloud_map.pcd" / name, found.kept(which == number))
        described[name] = [float(i * tile_m), float(j * tile_m)]
    with written_whole(folder / "map_projector_info.yaml") as text:
        yaml.safe_dump({"projector_type": "Local"}, text)
    with written_whole(folder / "pointcloud_map_metadata.yaml") as text:
        yaml.safe_dump(described, text, sort_keys=False)
