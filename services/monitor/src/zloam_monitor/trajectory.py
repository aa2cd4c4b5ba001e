"""Trajectories: poses with instants in integer ns and sweep numbers; TUM and KITTI files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import se3
from zloam_monitor.files import written_whole
from zloam_monitor.pose_rows import (
    Row,
    TrajectoryError,
    parse_stamp,
    read_rows,
    stamps_ns,
    unit_quaternions,
    unit_rotations,
)
from zloam_monitor.pose_table import COLUMNS, PoseTable

__all__ = ["Trajectory", "TrajectoryError", "parse_stamp", "read"]

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]

#: A step longer than this many usual ones is a hole, in which the poses are unknown.
HOLE_STEPS = 3


@dataclass(frozen=True)
class Trajectory:
    """Poses T_parent_child, ascending in time.

    stamps_ns is None for a KITTI file, whose poses are known by their sweep number only.
    """

    transforms: Array
    stamps_ns: Int64 | None = None
    sweeps: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    #: Lines of the file with a stamp that a line before them has.
    left_out: int = 0
    #: Lines of the file with an earlier stamp than the line before them.
    backwards: int = 0

    def __len__(self) -> int:
        return len(self.transforms)

    @property
    def positions(self) -> Array:
        found: Array = self.transforms[:, :3, 3]
        return found

    def path_length_m(self) -> float:
        """Sum of the distances between successive poses."""
        return float(path_m(self.transforms)[-1]) if len(self) else 0.0

    def times_s(self, origin_ns: int = 0) -> Array:
        """Instants as seconds after origin_ns."""
        if self.stamps_ns is None:
            raise TrajectoryError("a trajectory without time stamps")
        return np.asarray((self.stamps_ns - origin_ns) * 1e-9, np.float64)

    def carried(self, T_child_grandchild: Array) -> Trajectory:
        """The motion of another frame that is fixed to the child."""
        return Trajectory(self.transforms @ T_child_grandchild, self.stamps_ns, self.sweeps)

    def relative_to_first(self) -> Trajectory:
        """The trajectory in the frame of its first pose."""
        if len(self) == 0:
            return self
        first = se3.inverse(self.transforms[:1])
        return Trajectory(first @ self.transforms, self.stamps_ns, self.sweeps)


def path_m(transforms: Array) -> Array:
    """Path length up to each pose."""
    steps = np.linalg.norm(np.diff(transforms[:, :3, 3], axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))


def longest_step_ns(truth: Trajectory) -> int:
    """The longest time between two poses that does not count as a hole."""
    if truth.stamps_ns is None or len(truth) < 2:
        return 0
    return round(HOLE_STEPS * float(np.median(np.diff(truth.stamps_ns))))


def interpolate(
    truth: Trajectory, stamps_ns: Int64, longest_ns: int | None = None
) -> tuple[Trajectory, NDArray[np.bool_]]:
    """Truth at the given instants (linear, slerp), and a mask of the instants that it covers.

    Between poses further apart than longest_ns there is no truth.
    """
    if truth.stamps_ns is None:
        raise TrajectoryError("truth without time stamps cannot be interpolated")
    known = truth.stamps_ns
    inside = (stamps_ns >= known[0]) & (stamps_ns <= known[-1])
    if longest_ns is not None:
        after = np.minimum(np.searchsorted(known, stamps_ns), len(known) - 1)
        step = known[after] - known[np.maximum(after - 1, 0)]
        inside &= (step <= longest_ns) | np.isin(stamps_ns, known)
    wanted = stamps_ns[inside]
    out = np.tile(np.eye(4), (len(wanted), 1, 1))
    if len(known) == 1:
        out[:] = truth.transforms[0]
    elif len(wanted):
        # Integers are subtracted first: a double resolves Unix nanoseconds only to 0.25 us.
        t_known, t = (known - known[0]) * 1e-9, (wanted - known[0]) * 1e-9
        at = np.clip(np.searchsorted(known, wanted, side="right"), 1, len(known) - 1)
        part = (t - t_known[at - 1]) / (t_known[at] - t_known[at - 1])
        out[:, :3, :3] = se3.slerp(truth.transforms[at - 1], truth.transforms[at], part)
        for axis in range(3):
            out[:, axis, 3] = np.interp(t, t_known, truth.positions[:, axis])
    return Trajectory(out, wanted), inside


def stamp_text(stamp_ns: int) -> str:
    """Seconds with nine digits, without rounding."""
    sign = "-" if stamp_ns < 0 else ""
    seconds, nanoseconds = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{sign}{seconds}.{nanoseconds:09d}"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Writes `stamp x y z qx qy qz qw`, one pose per line."""
    if trajectory.stamps_ns is None:
        raise TrajectoryError("TUM needs time stamps")
    quats = se3.quaternions(trajectory.transforms)
    with written_whole(path) as out:
        for stamp, p, q in zip(trajectory.stamps_ns, trajectory.positions, quats, strict=True):
            out.write(stamp_text(int(stamp)) + "".join(f" {v:.9f}" for v in (*p, *q)) + "\n")


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Writes the upper three rows of each transform, row by row, one pose per line."""
    with written_whole(path) as out:
        for transform in trajectory.transforms:
            out.write(" ".join(f"{v:.9f}" for v in transform[:3].ravel()) + "\n")


def write_csv(path: Path, trajectory: Trajectory, known: PoseTable | None = None) -> None:
    """Writes a table with a header: TUM's columns, the sweep's or line's number, and for each pose
    what `known` has of its instant: health, degenerate direction, covariance."""
    quats = se3.quaternions(trajectory.transforms)
    numbers = trajectory.sweeps if len(trajectory.sweeps) else np.arange(len(trajectory))
    stamps = trajectory.stamps_ns
    times = [""] * len(trajectory) if stamps is None else [stamp_text(int(s)) for s in stamps]
    more = [] if known is None else COLUMNS
    with written_whole(path) as out:
        out.write(",".join(["time_s,x_m,y_m,z_m,qx,qy,qz,qw,number", *more]) + "\n")
        for i, (p, q) in enumerate(zip(trajectory.positions, quats, strict=True)):
            cells = [times[i], *(f"{v:.9f}" for v in (*p, *q)), str(numbers[i])]
            found = None if known is None or stamps is None else known.get(int(stamps[i]))
            cells += found or [""] * len(more)
            out.write(",".join(cells) + "\n")


def read(path: Path) -> Trajectory:
    """Reads a TUM (8 columns) or KITTI (12 columns) file; refuses lines that are not poses."""
    rows, values = read_rows(path)
    columns = len(rows[0].cells)
    if columns == 8:
        return _from_tum(rows, values)
    if columns == 12:
        return _from_kitti(rows, values)
    raise TrajectoryError(
        f"{path}: {columns} columns; a trajectory has 8 (TUM) or 12 (KITTI) in each line"
    )


def remarks(path: Path, found: Trajectory) -> list[str]:
    """What a person should know about the file that the poses were read from."""
    said = []
    if found.left_out:
        said.append(f"{found.left_out} lines with a stamp that another line has were left out")
    if found.backwards:
        said.append(
            f"its stamps go backwards at {found.backwards} lines: the poses were sorted by time"
        )
    return [f"{path}: {each}" for each in said]


def _from_tum(rows: list[Row], values: Array) -> Trajectory:
    unit_quaternions(rows, values[:, 4:8])
    stamps = stamps_ns(rows, values[:, 0])
    order = np.argsort(stamps, kind="stable")
    keep = np.concatenate(([True], np.diff(stamps[order]) > 0))
    order = order[keep]
    transforms = se3.matrices(values[order, 1:4], values[order, 4:8])
    sweeps = np.arange(len(order), dtype=np.int64)
    return Trajectory(
        transforms,
        stamps[order],
        sweeps,
        left_out=len(rows) - len(order),
        backwards=int((np.diff(stamps) < 0).sum()),
    )


def _from_kitti(rows: list[Row], values: Array) -> Trajectory:
    transforms = np.tile(np.eye(4), (len(values), 1, 1))
    transforms[:, :3, :] = values.reshape(-1, 3, 4)
    unit_rotations(rows, transforms[:, :3, :3])
    return Trajectory(transforms, None, np.arange(len(values), dtype=np.int64))


def from_records(records: dict[int, tuple[int, Any, Any]]) -> Trajectory:
    """Trajectory from sweep -> (instant_ns, translation, quaternion), by ascending sweep."""
    sweeps = np.array(sorted(records), np.int64)
    stamps = np.array([records[int(s)][0] for s in sweeps], np.int64)
    positions = np.array([records[int(s)][1] for s in sweeps], float).reshape(-1, 3)
    quats = np.array([records[int(s)][2] for s in sweeps], float).reshape(-1, 4)
    return Trajectory(se3.matrices(positions, quats), stamps, sweeps)
