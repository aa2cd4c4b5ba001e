"""Map files: reads and writes PCD, PLY, LAS and LAZ; crops, thins and describes maps.

A map's points have x, y, z in m (frame map), an intensity and the layer (0 edge, 1 plane). Formats:
PCD 0.7 (Point Cloud Library), PLY (Turk 1994), LAS 1.4 (ASPRS), in which the layer is an extra
dimension.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import clouds
from zloam_monitor.failures import Explained, FileTrouble, Misuse
from zloam_monitor.files import written_whole
from zloam_monitor.messages import MAP_POINT
from zloam_monitor.point_files import READERS
from zloam_monitor.recordings.fields import INTENSITIES

#: Resolution of coordinates in LAS, and how far its 32 bits then reach.
LAS_STEP_M = 1e-4
LAS_REACH_M = LAS_STEP_M * np.iinfo(np.int32).max
#: Largest intensity in LAS, and the part of a map's range of intensities that may be rounded off.
LAS_INTENSITY, LAS_INTENSITY_LOSS = 65535, 0.01
#: Largest difference from a file's coordinates that the 32-bit numbers of a map may have.
LARGEST_LOSS_M = 0.005
#: Limit on the number of a cell of a grid.
MOST_STEPS = 2**40
#: User and number of the record in a LAS file that holds the notes.
LAS_USER, LAS_NOTES = "zenoh-loam", 1


class MapError(Explained, ValueError):
    """A map cannot be read, written or cut as requested; the text says why."""


class MapFileError(MapError, FileTrouble):
    """A file cannot be read, or cannot hold the map."""


class MapOptionError(MapError, Misuse):
    """An option's value is none."""


@dataclass(frozen=True)
class PointMap:
    """Points, and the layer of each point."""

    points: NDArray[Any]
    layers: NDArray[np.uint8]
    #: Points of the file without finite coordinates.
    left_out: int = 0

    def __len__(self) -> int:
        return len(self.points)

    @property
    def xyz(self) -> NDArray[np.float64]:
        return np.column_stack([self.points[axis].astype(np.float64) for axis in "xyz"])

    def kept(self, which: NDArray[Any]) -> PointMap:
        """Selects points by a mask or by indices."""
        return PointMap(self.points[which], self.layers[which])


def read(path: Path) -> PointMap:
    """Reads a map, or another file of points."""
    if path.suffix.lower() not in READERS:
        raise MapOptionError(f"{path}: {_endings()} is expected")
    if not path.is_file():
        raise MapFileError(f"{path}: No such file")
    if not path.stat().st_size:
        raise MapFileError(f"{path}: is empty")
    try:
        found, _, _ = READERS[path.suffix.lower()](path)
    except Exception as error:  # Each library has error types of its own.
        raise MapFileError(f"{path}: cannot be read: {error}") from error
    return _map_of(found, path)


def _map_of(found: NDArray[Any], path: Path) -> PointMap:
    names = found.dtype.names or ()
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise MapFileError(f"{path}: has no {', '.join(missing)}")
    xyz = np.column_stack([found[axis].astype(np.float64) for axis in "xyz"])
    finite = np.isfinite(xyz).all(axis=1)
    found, xyz = found[finite], xyz[finite]
    _refuse_if_rounded(xyz, path)
    points = np.zeros(len(found), MAP_POINT)
    for axis, column in zip("xyz", xyz.T, strict=True):
        points[axis] = column
    intensity = _named(found, INTENSITIES)
    if intensity:
        # A point without an intensity has none: LAS and the viewers know no NaN.
        points["intensity"] = np.nan_to_num(found[intensity].astype(np.float32))
    return PointMap(points, _layers(found), int((~finite).sum()))


def _named(found: NDArray[Any], wanted: Sequence[str]) -> str | None:
    """The field that has the first of these names, in any case; CloudCompare puts a prefix before
    the names in PLY files."""
    there = {n.lower().removeprefix("scalar_"): n for n in found.dtype.names or ()}
    return next((there[name] for name in wanted if name in there), None)


def _layers(found: NDArray[Any]) -> NDArray[np.uint8]:
    """The layer of each point: all plane in a file without layers. Other programs have dimensions
    of this name with another meaning, so it counts only if each value is one of ours; of any type,
    because programs that show our maps write whole columns back as floats."""
    if name := _named(found, ("layer",)):
        layer = found[name]
        if np.isin(layer, range(len(clouds.POINT_LAYERS))).all():
            return layer.astype(np.uint8)
    return np.ones(len(found), np.uint8)


def _refuse_if_rounded(xyz: NDArray[np.float64], path: Path) -> None:
    """Georeferenced coordinates, e.g. of UTM, are too large for a map's 32-bit numbers."""
    with np.errstate(over="ignore"):
        loss_m = np.abs(xyz - xyz.astype(np.float32)).max(initial=0.0)
    if loss_m > LARGEST_LOSS_M:
        raise MapFileError(
            f"{path}: its coordinates reach {np.abs(xyz).max():.9g} m, where the 32-bit numbers "
            f"of a map are up to {loss_m:.3g} m off: subtract an origin from them first"
        )


def _write_pcd(path: Path, found: PointMap, notes: Sequence[str]) -> None:
    clouds.write_pcd(path, found.points, found.layers, notes)


def _write_ply(path: Path, found: PointMap, notes: Sequence[str]) -> None:
    rows = clouds.layered(found.points, found.layers)
    properties = "".join(f"property float {name}\n" for name in MAP_POINT.names or ())
    comments = "".join(f"comment {note}\n" for note in notes)
    with written_whole(path, "wb") as out:
        out.write(
            f"ply\nformat binary_little_endian 1.0\n{comments}element vertex {len(rows)}\n"
            f"{properties}property uchar layer\nend_header\n".encode()
        )
        out.write(rows.tobytes())


def _write_las(path: Path, found: PointMap, notes: Sequence[str]) -> None:
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, LAS_STEP_M)
    header.add_extra_dim(laspy.ExtraBytesParams("layer", np.uint8, "0 edge, 1 plane"))
    if notes:
        text = "\n".join(notes).encode()
        header.vlrs.append(laspy.VLR(LAS_USER, LAS_NOTES, "frame and parameters", text))
    xyz = found.xyz
    header.offsets = np.floor(xyz.min(axis=0)) if len(found) else np.zeros(3)
    reach_m = float((xyz - header.offsets).max(initial=0.0))
    if reach_m > LAS_REACH_M:
        raise MapFileError(
            f"{path}: the points reach {reach_m:.9g} m far, and LAS at steps of {LAS_STEP_M:g} m "
            f"only {LAS_REACH_M:.0f} m: crop the map, or write .pcd or .ply"
        )
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    las.intensity = np.clip(np.rint(found.points["intensity"]), 0, LAS_INTENSITY).astype(np.uint16)
    las["layer"] = found.layers
    # laspy chooses between LAS and LAZ by the file's name, but for a stream by do_compress.
    with written_whole(path, "wb") as out:
        las.write(out, do_compress=path.suffix.lower() == ".laz")


WRITERS: dict[str, Callable[[Path, PointMap, Sequence[str]], None]] = {
    ".pcd": _write_pcd,
    ".ply": _write_ply,
    ".las": _write_las,
    ".laz": _write_las,
}


def writable(path: Path) -> None:
    """Raises if the extension has no writer, so that a command can refuse before its work."""
    if path.suffix.lower() not in WRITERS:
        raise MapOptionError(f"{path}: {_endings()} is expected")


def write(path: Path, found: PointMap, notes: Sequence[str] = ()) -> None:
    """Writes the format of the extension, completely or not at all. notes: lines for the header."""
    writable(path)
    WRITERS[path.suffix.lower()](path, found, notes)


def losses(path: Path, found: PointMap) -> list[str]:
    """Texts about what the format of the file does not hold. LAS has whole intensities."""
    values = found.points["intensity"]
    if path.suffix.lower() not in (".las", ".laz") or not len(values):
        return []
    off = np.abs(values - np.clip(np.rint(values), 0, LAS_INTENSITY)).max()
    if off <= LAS_INTENSITY_LOSS * np.ptp(values):
        return []
    return [
        f"{path}: intensities of {values.min():g} to {values.max():g} are rounded to whole numbers "
        f"from 0 to {LAS_INTENSITY}; .pcd and .ply keep them"
    ]


def _endings() -> str:
    *others, last = WRITERS
    return f"{', '.join(others)} or {last}"


def cropped(found: PointMap, limits: dict[str, tuple[float, float]]) -> PointMap:
    """The points within all limits, both ends included."""
    keep = np.ones(len(found), bool)
    for axis, (low, high) in limits.items():
        if not low <= high:
            raise MapOptionError(f"--{axis}: {low:g} is above {high:g}")
        keep &= (found.points[axis] >= low) & (found.points[axis] <= high)
    return found.kept(keep)


def of_layer(found: PointMap, layer: str) -> PointMap:
    if layer not in clouds.POINT_LAYERS:
        raise MapOptionError(f"--layer: '{layer}' is none of {', '.join(clouds.POINT_LAYERS)}")
    return found.kept(found.layers == clouds.POINT_LAYERS.index(layer))


def check_voxel(voxel_m: float) -> None:
    """Raises if it is no edge of a cube, so that a command can refuse before its work."""
    if not 0.0 < voxel_m < np.inf:
        raise MapOptionError(f"--voxel: {voxel_m:g} m is no edge of a cube")


def cell_numbers(values_m: NDArray[np.float64], edge_m: float, option: str) -> NDArray[np.int64]:
    """The numbers of the cells of this edge that the coordinates lie in."""
    if not 0.0 < edge_m < np.inf:
        raise MapOptionError(f"{option}: {edge_m:g} m is no edge of a cell")
    # Below the resolution of the coordinates, each point has a cell of its own; far below it, the
    # numbers of the cells do not fit in 64 bits.
    if np.abs(values_m).max(initial=0.0) > MOST_STEPS * edge_m:
        raise MapOptionError(f"{option}: {edge_m:g} m is too small for a map of this extent")
    return np.floor(values_m / edge_m).astype(np.int64)


def thinned(found: PointMap, voxel_m: float) -> PointMap:
    """For each cube with this edge, the point nearest to the mean of its points."""
    check_voxel(voxel_m)
    if not len(found):
        return found
    xyz = found.xyz
    _, cube, count = np.unique(
        cell_numbers(xyz, voxel_m, "--voxel"), axis=0, return_inverse=True, return_counts=True
    )
    cube = cube.ravel()
    means = np.column_stack([np.bincount(cube, xyz[:, axis]) for axis in range(3)])
    off = np.linalg.norm(xyz - (means / count[:, None])[cube], axis=1)
    order = np.lexsort((np.arange(len(xyz)), off, cube))
    first = np.concatenate(([0], np.cumsum(count)[:-1]))
    return found.kept(np.sort(order[first]))


def described(path: Path, found: PointMap) -> dict[str, Any]:
    """Describes the contents of a map file; limits are left out if there are no points."""
    out: dict[str, Any] = {"file": path, "points": len(found), "bytes": path.stat().st_size}
    out["points_left_out"] = found.left_out
    if not len(found):
        return out
    columns = {f"{axis}_m": found.xyz[:, k] for k, axis in enumerate("xyz")}
    columns["intensity"] = found.points["intensity"]
    out["layers"] = {
        name: int((found.layers == number).sum()) for number, name in enumerate(clouds.POINT_LAYERS)
    }
    out["limits"] = {n: (float(each.min()), float(each.max())) for n, each in columns.items()}
    return out


def left_out_text(count: int) -> str:
    return f"{count} points without finite coordinates were left out"


def lines(described: dict[str, Any]) -> list[str]:
    """Text for a person."""
    said = [f"{described['file']}: {described['points']} points, {described['bytes'] / 1e6:.1f} MB"]
    if count := described["points_left_out"]:
        said.append(left_out_text(count))
    said += [f"{name}: {count} points" for name, count in described.get("layers", {}).items()]
    for name, (low, high) in described.get("limits", {}).items():
        axis, unit, _ = name.partition("_m")
        said.append(
            f"{axis}: {low:.2f} to {high:.2f} m" if unit else f"{name}: {low:g} to {high:g}"
        )
    return said
