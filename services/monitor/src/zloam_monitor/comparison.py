"""Compares two runs: the distance between their trajectories, and the figures of their reports."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import se3, trajectory
from zloam_monitor.report import number_text
from zloam_monitor.trajectory import Trajectory, TrajectoryError, interpolate, longest_step_ns

Array = NDArray[np.float64]
#: Figures of report.json: name, path in the JSON, digits.
FIGURES = (
    ("sweeps", ("identities", "sweeps"), 0),
    ("poses", ("identities", "poses"), 0),
    ("given up", ("identities", "given_up"), 0),
    ("path, m", ("path_m",), 1),
    ("ATE of the pose, m", ("ate_rmse_m", "pose"), 4),
    ("ATE of odometry, m", ("ate_rmse_m", "odometry"), 4),
    ("drift of the pose, %", ("drift_percent", "pose"), 3),
    ("latency p50, ms", ("latency_ms", "end_to_end", "p50"), 1),
    ("latency p99, ms", ("latency_ms", "end_to_end", "p99"), 1),
    ("wall time, s", ("wall_s",), 1),
    ("jumps", ("health", "jumps"), 0),
)


@dataclass(frozen=True)
class Finished:
    """Results of a run, from its folder."""

    folder: Path
    report: dict[str, Any]
    poses: Trajectory


def read(folder: Path) -> Finished:
    """Reads a run's results; raises TrajectoryError with the file and the reason."""
    path = folder / "report.json"
    try:
        report = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise TrajectoryError(
            f"{path}: No such file; the folder that a run has left is expected, e.g. out/demo"
        ) from error
    except NotADirectoryError as error:
        raise TrajectoryError(
            f"{folder}: is no folder; that which a run has left is expected, e.g. out/demo, and "
            "zloam evaluate compares two files"
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise TrajectoryError(f"{path}: cannot be read: {error}") from error
    if not isinstance(report, dict):
        raise TrajectoryError(f"{path}: is no report of a run")
    # A folder in which the stages saw several runs has the poses of each in a file of its own.
    poses = folder / str(report.get("trajectory_file") or "trajectory.tum")
    return Finished(folder, report, trajectory.read(poses))


def apart(a: Trajectory, b: Trajectory) -> tuple[Array, Array]:
    """Distances in m and angles in deg, without alignment, at the instants of b that lie within
    a."""
    if a.stamps_ns is None or b.stamps_ns is None:
        raise TrajectoryError("trajectories without time stamps cannot be compared")
    at, inside = interpolate(a, b.stamps_ns, longest_step_ns(a))
    between = se3.inverse(at.transforms) @ b.transforms[inside]
    far_m = np.linalg.norm(at.positions - b.positions[inside], axis=1)
    return np.asarray(far_m, np.float64), np.degrees(se3.rotation_angle_rad(between))


def _same(a: Trajectory, b: Trajectory) -> bool:
    """All poses are equal, with their instants and headings."""
    return (
        a.stamps_ns is not None
        and b.stamps_ns is not None
        and np.array_equal(a.stamps_ns, b.stamps_ns)
        and np.array_equal(a.transforms, b.transforms)
    )


def _figure(report: dict[str, Any], where: tuple[str, ...]) -> float | None:
    value: Any = report
    for name in where:
        value = value.get(name) if isinstance(value, dict) else None
    if isinstance(value, dict):  # Counts by reason.
        value = sum(each for each in value.values() if isinstance(each, (int, float)))
    return float(value) if isinstance(value, (int, float)) else None


@dataclass(frozen=True)
class Compared:
    """Comparison of two runs."""

    first: Path
    second: Path
    #: All poses of both runs are equal, with their instants.
    same_poses: bool
    #: Number of the second run's poses at whose instants the first has a pose, too; of all poses of
    #: the second; and of all poses of the first.
    instants: int
    of_poses: int
    first_poses: int
    rms_m: float | None
    max_m: float | None
    max_deg: float | None
    #: name -> (first, second); None if a run does not have the figure.
    figures: dict[str, tuple[float | None, float | None]]


def _figures(first: Finished, second: Finished) -> dict[str, tuple[float | None, float | None]]:
    """The figures that at least one run has; those of the health only if they differ."""
    wheres = {name: where for name, where, _ in FIGURES}
    costs = first.report.get("cpu_ms_per_sweep")
    for stage in costs if isinstance(costs, dict) else ():
        wheres[f"CPU of {stage}, ms"] = ("cpu_ms_per_sweep", stage)
    pairs = {
        name: (_figure(first.report, where), _figure(second.report, where))
        for name, where in wheres.items()
    }
    counted = [_health(each.report) for each in (first, second)]
    for state in sorted({state for counts in counted for state in counts or ()}):
        a, b = (None if counts is None else float(counts.get(state, 0)) for counts in counted)
        if a != b:
            pairs[f"health: {state}"] = a, b
    return {name: pair for name, pair in pairs.items() if pair != (None, None)}


def _health(report: dict[str, Any]) -> dict[str, float] | None:
    """Number of poses by their health; those that do not occur are left out. None: not reported."""
    health = report.get("health")
    counts = health.get("counts") if isinstance(health, dict) else None
    if not isinstance(counts, dict):
        return None
    return {state: n for state, n in counts.items() if isinstance(n, (int, float))}


def compared(first: Finished, second: Finished) -> Compared:
    """Compares two runs; raises TrajectoryError if their trajectories cannot be compared."""
    far_m, turned_deg = apart(first.poses, second.poses)
    any_m = len(far_m) > 0
    return Compared(
        first.folder,
        second.folder,
        _same(first.poses, second.poses),
        len(far_m),
        len(second.poses),
        len(first.poses),
        float(np.sqrt(np.mean(far_m**2))) if any_m else None,
        float(far_m.max()) if any_m else None,
        float(turned_deg.max()) if any_m else None,
        _figures(first, second),
    )


def _apart(found: Compared) -> str:
    if found.rms_m is None:
        return "no instant in common: recordings of different times"
    if found.same_poses:
        return "the same poses"
    return (
        f"{found.rms_m:.4f} m apart (rms), at most {found.max_m:.4f} m and "
        f"{found.max_deg:.3f} deg, "
        f"at {found.instants} common instants of {found.first_poses} and {found.of_poses} poses"
    )


def lines(found: Compared) -> list[str]:
    """Text for a person: the trajectories first, then the figures."""
    rows = [("", found.first.name, found.second.name)]
    known = {figure: digits for figure, _, digits in FIGURES}
    for name, (a, b) in found.figures.items():
        digits = known.get(name, 0 if name.startswith("health") else 1)
        rows.append((name, number_text(a, digits), number_text(b, digits)))
    return [f"trajectories: {_apart(found)}", *(f"{n:<24}{a:>14}{b:>14}" for n, a, b in rows)]
