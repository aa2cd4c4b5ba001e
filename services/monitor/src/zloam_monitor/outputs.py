"""The files of a run: trajectories, map, picture, report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zloam_monitor import clouds, evaluation, picture, report, se3, trajectory
from zloam_monitor.clouds import Tile
from zloam_monitor.report import Run
from zloam_monitor.trajectory import Trajectory


@dataclass(frozen=True)
class Files:
    """Where everything goes."""

    folder: Path

    def __getattr__(self, name: str) -> Path:
        known = {
            "trajectory_tum": "trajectory.tum",
            "trajectory_kitti": "trajectory.kitti",
            "odometry_tum": "odometry.tum",
            "ground_truth": "ground_truth.tum",
            "map": "map.pcd",
            "picture": "picture.png",
            "report": "report.json",
            "logs": "logs",
        }
        if name not in known:
            raise AttributeError(name)
        return self.folder / known[name]


def mounting(configs: dict[str, dict[str, Any]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """T_base_lidar out of the stages' own configuration."""
    for values in configs.values():
        if "mounting.xyz_m" in values:
            return se3.from_xyz_rpy_deg(values["mounting.xyz_m"], values["mounting.rpy_deg"])
    raise ValueError("no stage said its mounting")


def truths_of_base(
    paths: list[Path], T_base_lidar: np.ndarray[Any, np.dtype[np.float64]]
) -> dict[str, Trajectory]:
    """References are of the sensor; carried to base_link, as all poses are."""
    return {path.name: trajectory.read(path).carried(se3.inverse(T_base_lidar)) for path in paths}


def stamped_truth(truth: Trajectory, poses: Trajectory) -> Trajectory:
    """Truth as a stamped trajectory; where it is known by sweep, with the poses' instants."""
    if truth.stamps_ns is not None or poses.stamps_ns is None:
        return truth
    at = {int(s): int(t) for s, t in zip(poses.sweeps, poses.stamps_ns, strict=True)}
    rows = [i for i, s in enumerate(truth.sweeps) if int(s) in at]
    stamps = np.array([at[int(truth.sweeps[i])] for i in rows], np.int64)
    return Trajectory(truth.transforms[rows], stamps, truth.sweeps[rows])


def write_path_and_map(folder: Path, run: Run, tiles: list[Tile]) -> None:
    """What a run leaves even when it was broken off."""
    files = Files(folder)
    trajectory.write_tum(files.trajectory_tum, run.trajectory)
    trajectory.write_kitti(files.trajectory_kitti, run.trajectory)
    trajectory.write_tum(files.odometry_tum, run.odometry)
    points, layers = clouds.merged(tiles)
    clouds.write_pcd(files.map, points, layers)


def write_picture(folder: Path, title: str, run: Run, tiles: list[Tile]) -> None:
    """The map, the path, and the error against the first reference."""
    points, _ = clouds.merged(tiles)
    stamps = run.trajectory.stamps_ns
    first = int(stamps[0]) if stamps is not None and len(stamps) else 0
    compared = None
    for truth in run.truths.values():
        compared = compared or evaluation.compare(run.trajectory, truth)
    scene = picture.Scene(
        title, points, run.trajectory.positions, run.trajectory.times_s(first), compared
    )
    picture.draw(Files(folder).picture, scene)


def write_all(folder: Path, title: str, run: Run, tiles: list[Tile]) -> dict[str, Any]:
    """Every file; returns the report."""
    write_path_and_map(folder, run, tiles)
    files = Files(folder)
    files.ground_truth.unlink(missing_ok=True)
    for truth in list(run.truths.values())[:1]:
        stamped = stamped_truth(truth, run.trajectory)
        if stamped.stamps_ns is not None:
            trajectory.write_tum(files.ground_truth, stamped)
    found = report.build(run)
    report.write(files.report, found)
    write_picture(folder, title, run, tiles)
    return found
