"""References of a run: poses of its sensor by another source, against which errors are computed.

A run is not lost by a reference that can't be used: the report then says why there is no error.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from zloam_monitor import se3, trajectory
from zloam_monitor.trajectory import Trajectory, TrajectoryError


def check(paths: Iterable[Path]) -> None:
    """Raises TrajectoryError if one of the existing files can't be read: before a run, as it can be
    mended then."""
    for path in paths:
        if path.exists():
            trajectory.read(path)


def of_drive(
    truths: Mapping[str, Trajectory], sweeps: int
) -> tuple[dict[str, Trajectory], list[str]]:
    """(references that can be of a drive with so many sweeps, remarks about the others). One
    without times (KITTI) has a pose for each sweep: with more of them it is of another drive."""
    others = {
        name: len(truth)
        for name, truth in truths.items()
        if truth.stamps_ns is None and len(truth) > sweeps
    }
    remarks = [
        f"{name}: has no times and {poses} poses, the run {sweeps} sweeps; no error "
        "against this reference: cut it to the drive's scans, or give one with times (TUM)"
        for name, poses in others.items()
    ]
    return {name: truth for name, truth in truths.items() if name not in others}, remarks


def of_base(
    paths: Iterable[Path], configs: Mapping[str, Mapping[str, Any]]
) -> tuple[dict[str, Trajectory], list[str]]:
    """(name -> poses of base_link, remarks about references that can't be used); the stages'
    configurations say where the sensor is."""
    found: dict[str, Trajectory] = {}
    remarks: list[str] = []
    for path in dict.fromkeys(paths):
        name = str(path) if path.name in found else path.name
        try:
            found[name] = trajectory.read(path)
        except (TrajectoryError, OSError) as error:
            why = "does not exist" if not path.exists() else f"can't be read ({error})"
            remarks.append(f"{path}: {why}; no error against this reference")
    if not found:
        return {}, remarks
    try:
        T_lidar_base = se3.inverse(se3.mounting(configs))
    except ValueError as error:
        remarks.append(f"{error}: no error against {', '.join(found)}")
        return {}, remarks
    return {name: each.carried(T_lidar_base) for name, each in found.items()}, remarks
