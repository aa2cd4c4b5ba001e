"""A trajectory: instants in integer nanoseconds, poses, the sweep of each; TUM and KITTI files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from zloam_monitor import se3
from zloam_monitor.files import written_whole

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]


class TrajectoryError(ValueError):
    """A trajectory file that cannot be used, with the reason."""


@dataclass(frozen=True)
class Trajectory:
    """Poses T_parent_child, ascending in time.

    stamps_ns is None for a KITTI file, whose poses are known by their sweep number only.
    """

    transforms: Array
    stamps_ns: Int64 | None = None
    sweeps: Int64 = field(default_factory=lambda: np.empty(0, np.int64))

    def __len__(self) -> int:
        return len(self.transforms)

    @property
    def positions(self) -> Array:
        found: Array = self.transforms[:, :3, 3]
        return found

    def path_length_m(self) -> float:
        """Sum of the steps between poses."""
        return float(path_m(self.transforms)[-1]) if len(self) else 0.0

    def times_s(self, origin_ns: int = 0) -> Array:
        """Instants as seconds after origin_ns."""
        if self.stamps_ns is None:
            raise TrajectoryError("a trajectory without time stamps")
        return np.asarray((self.stamps_ns - origin_ns) * 1e-9, np.float64)

    def carried(self, T_child_grandchild: Array) -> Trajectory:
        """The same motion for another frame fixed to the child."""
        return Trajectory(self.transforms @ T_child_grandchild, self.stamps_ns, self.sweeps)

    def relative_to_first(self) -> Trajectory:
        """In the frame of the first pose."""
        if len(self) == 0:
            return self
        first = se3.inverse(self.transforms[:1])
        return Trajectory(first @ self.transforms, self.stamps_ns, self.sweeps)


def path_m(transforms: Array) -> Array:
    """Path length up to each pose."""
    steps = np.linalg.norm(np.diff(transforms[:, :3, 3], axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))


def interpolate(truth: Trajectory, stamps_ns: Int64) -> tuple[Trajectory, NDArray[np.bool_]]:
    """Truth at the given instants (linear, slerp), and which instants lie within it."""
    if truth.stamps_ns is None:
        raise TrajectoryError("truth without time stamps cannot be interpolated")
    known = truth.stamps_ns
    inside = (stamps_ns >= known[0]) & (stamps_ns <= known[-1])
    wanted = stamps_ns[inside]
    # differences of integers first: a double holds Unix nanoseconds only to a quarter of a us
    origin = known[0]
    t_known, t = (known - origin) * 1e-9, (wanted - origin) * 1e-9
    out = np.tile(np.eye(4), (len(wanted), 1, 1))
    if len(wanted):
        turn = Slerp(t_known, Rotation.from_matrix(truth.transforms[:, :3, :3]))
        out[:, :3, :3] = turn(t).as_matrix()
        for axis in range(3):
            out[:, axis, 3] = np.interp(t, t_known, truth.positions[:, axis])
    return Trajectory(out, wanted), inside


def stamp_text(stamp_ns: int) -> str:
    """Seconds with nine digits, exact."""
    sign = "-" if stamp_ns < 0 else ""
    seconds, nanoseconds = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{sign}{seconds}.{nanoseconds:09d}"


def parse_stamp(text: str) -> int:
    """Seconds as text to ns, exact when written with up to nine digits."""
    if "e" in text.lower() or "." not in text:
        return round(float(text) * 1e9)
    whole, fraction = text.split(".")
    sign = -1 if whole.startswith("-") else 1
    return sign * (abs(int(whole or "0")) * 1_000_000_000 + int((fraction + "0" * 9)[:9]))


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """`stamp x y z qx qy qz qw`, one pose a line."""
    if trajectory.stamps_ns is None:
        raise TrajectoryError("TUM needs time stamps")
    quats = se3.quaternions(trajectory.transforms)
    with written_whole(path) as out:
        for stamp, p, q in zip(trajectory.stamps_ns, trajectory.positions, quats, strict=True):
            out.write(stamp_text(int(stamp)) + "".join(f" {v:.9f}" for v in (*p, *q)) + "\n")


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """The upper three rows of each transform, row by row, one pose a line."""
    with written_whole(path) as out:
        for transform in trajectory.transforms:
            out.write(" ".join(f"{v:.9f}" for v in transform[:3].ravel()) + "\n")


def read(path: Path) -> Trajectory:
    """A TUM (8 columns) or KITTI (12 columns) file."""
    rows = _rows(path)
    columns = {len(row) for row in rows}
    if columns == {8}:
        return _from_tum(rows, path)
    if columns == {12}:
        return _from_kitti(rows)
    raise TrajectoryError(
        f"{path}: {sorted(columns)} columns; a trajectory has 8 (TUM) or 12 (KITTI) in each line"
    )


def _rows(path: Path) -> list[list[str]]:
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise TrajectoryError(f"{path}: {error.strerror}") from error
    rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    if not rows:
        raise TrajectoryError(f"{path}: no poses")
    return rows


def _numbers(rows: list[list[str]], path: Path) -> Array:
    try:
        return np.array([[float(cell) for cell in row] for row in rows])
    except ValueError as error:
        raise TrajectoryError(f"{path}: {error}") from error


def _from_tum(rows: list[list[str]], path: Path) -> Trajectory:
    values = _numbers(rows, path)
    stamps = np.array([parse_stamp(row[0]) for row in rows], np.int64)
    order = np.argsort(stamps, kind="stable")
    keep = np.concatenate(([True], np.diff(stamps[order]) > 0))
    order = order[keep]
    transforms = se3.matrices(values[order, 1:4], values[order, 4:8])
    return Trajectory(transforms, stamps[order], np.arange(len(order), dtype=np.int64))


def _from_kitti(rows: list[list[str]]) -> Trajectory:
    values = _numbers(rows, Path("KITTI poses"))
    transforms = np.tile(np.eye(4), (len(values), 1, 1))
    transforms[:, :3, :] = values.reshape(-1, 3, 4)
    return Trajectory(transforms, None, np.arange(len(values), dtype=np.int64))


def from_records(records: dict[int, tuple[int, Any, Any]]) -> Trajectory:
    """From sweep -> (instant_ns, translation, quaternion), in the order of the sweeps."""
    sweeps = np.array(sorted(records), np.int64)
    stamps = np.array([records[int(s)][0] for s in sweeps], np.int64)
    positions = np.array([records[int(s)][1] for s in sweeps], float).reshape(-1, 3)
    quats = np.array([records[int(s)][2] for s in sweeps], float).reshape(-1, 4)
    return Trajectory(se3.matrices(positions, quats), stamps, sweeps)
