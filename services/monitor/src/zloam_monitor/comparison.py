"""Two runs beside each other: how far their trajectories are apart, and their reports' figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zloam_monitor import trajectory
from zloam_monitor.report import number_text
from zloam_monitor.trajectory import Trajectory, TrajectoryError, interpolate, longest_step_ns

#: figures of report.json: name, where, digits
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
)


@dataclass(frozen=True)
class Finished:
    """A folder that a run left."""

    folder: Path
    report: dict[str, Any]
    poses: Trajectory


def read(folder: Path) -> Finished:
    """Raises TrajectoryError, with the file and the reason."""
    path = folder / "report.json"
    try:
        report = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise TrajectoryError(
            f"{path}: No such file; the folder that a run has left is expected, e.g. out/demo"
        ) from error
    except (OSError, ValueError) as error:
        raise TrajectoryError(f"{path}: cannot be read: {error}") from error
    if not isinstance(report, dict):
        raise TrajectoryError(f"{path}: is no report of a run")
    return Finished(folder, report, trajectory.read(folder / "trajectory.tum"))


def apart_m(a: Trajectory, b: Trajectory) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Distances at the instants of b at which a is known; both as they are, unaligned."""
    if a.stamps_ns is None or b.stamps_ns is None:
        raise TrajectoryError("trajectories without time stamps cannot be compared")
    at, inside = interpolate(a, b.stamps_ns, longest_step_ns(a))
    return np.asarray(np.linalg.norm(at.positions - b.positions[inside], axis=1), np.float64)


def _figure(report: dict[str, Any], where: tuple[str, ...]) -> float | None:
    value: Any = report
    for name in where:
        value = value.get(name) if isinstance(value, dict) else None
    return float(value) if isinstance(value, (int, float)) else None


def _row(name: str, a: str, b: str) -> str:
    return f"{name:<24}{a:>14}{b:>14}"


def lines(first: Finished, second: Finished) -> list[str]:
    """For a person: what differs, the trajectories first."""
    far_m = apart_m(first.poses, second.poses)
    if len(far_m):
        same = bool((far_m == 0.0).all()) and len(first.poses) == len(second.poses)
        said = (
            "the same poses"
            if same
            else f"{np.sqrt(np.mean(far_m**2)):.4f} m apart (rms), at most {far_m.max():.4f} m, "
            f"at {len(far_m)} instants of {len(second.poses)}"
        )
    else:
        said = "no instant in common: recordings of different times"
    out = [f"trajectories: {said}", _row("", first.folder.name, second.folder.name)]
    for name, where, digits in FIGURES:
        a, b = (_figure(run.report, where) for run in (first, second))
        if a is not None or b is not None:
            out.append(_row(name, number_text(a, digits), number_text(b, digits)))
    for stage in first.report.get("cpu_ms_per_sweep", {}):
        a, b = (_figure(r.report, ("cpu_ms_per_sweep", stage)) for r in (first, second))
        out.append(_row(f"CPU of {stage}, ms", number_text(a, 1), number_text(b, 1)))
    health = [run.report.get("health", {}) for run in (first, second)]
    for name in sorted({*health[0], *health[1]}):
        a, b = (_figure({"h": each}, ("h", name)) for each in health)
        if (a is not None or b is not None) and a != b:
            out.append(_row(f"health: {name}", number_text(a, 3), number_text(b, 3)))
    return out
