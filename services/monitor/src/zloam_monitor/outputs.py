"""The files of a run: trajectories, map, picture, report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from zloam_monitor import (
    beside_run,
    claims,
    clouds,
    evaluation,
    html_report,
    picture,
    pose_table,
    references,
    remarks,
    report,
    trajectory,
)
from zloam_monitor.claims import Claim
from zloam_monitor.messages import MAP_POINT
from zloam_monitor.report import Run
from zloam_monitor.stages import PORT_ORDER
from zloam_monitor.trajectory import Trajectory, TrajectoryError


@dataclass(frozen=True)
class Files:
    """Paths of a run's files."""

    folder: Path

    def __getattr__(self, name: str) -> Path:
        known = {
            "trajectory_tum": "trajectory.tum",
            "trajectory_kitti": "trajectory.kitti",
            "odometry_tum": "odometry.tum",
            "heard_tum": "heard.tum",
            "heard_kitti": "heard.kitti",
            "heard_odometry": "heard_odometry.tum",
            "world_tum": "trajectory_world.tum",
            "world_map": "map_world.pcd",
            "ground_truth": "ground_truth.tum",
            "map": "map.pcd",
            "picture": "picture.png",
            "report": "report.json",
            "poses": pose_table.NAME,
            "logs": "logs",
        }
        if name not in known:
            raise AttributeError(name)
        return self.folder / known[name]


def stamped_truth(truth: Trajectory, poses: Trajectory) -> Trajectory:
    """Truth with stamps. If it is known by sweep only, each pose gets the middle of its sweep."""
    if truth.stamps_ns is not None or poses.stamps_ns is None:
        return truth
    middle, stamps_ns = evaluation.at_part_of_sweep(poses, evaluation.SWEEP_PART_OF_REFERENCE)
    at = {int(s): int(t) for s, t in zip(middle.sweeps, stamps_ns, strict=True)}
    rows = [i for i, s in enumerate(truth.sweeps) if int(s) in at]
    stamps = np.array([at[int(truth.sweeps[i])] for i in rows], np.int64)
    return Trajectory(truth.transforms[rows], stamps, truth.sweeps[rows])


def stage_settings(folder: Path) -> list[str]:
    """Settings that make the stages write their files into this folder at the end of a run."""
    files = Files(folder.resolve())
    return [
        f"integration.output_dir={files.folder}",
        f"mapping.map_path={files.map}",
        f"graph.output_dir={files.folder}",
    ]


#: Files written by the stages, and by this program after them.
MADE_BY_STAGES = (
    "trajectory.tum",
    "trajectory.kitti",
    "odometry.tum",
    "trajectory_world.tum",
    "map.pcd",
    "map_world.pcd",
    *("trajectory.journal", "trajectory.state.0", "trajectory.state.1"),
    *(f"logs/{stage}.log" for stage in PORT_ORDER),
)
MADE_HERE = (
    *("ground_truth.tum", "picture.png", "report.json", "report.html", pose_table.NAME),
    *("heard.tum", "heard.kitti", "heard_odometry.tum"),
    *(beside_run.MCAP, beside_run.RERUN, "logs/web.log", "logs/view.log"),
)
#: Files of further runs that the stages saw, and of further instances.
FURTHER = (
    "trajectory_[0-9]*.tum",
    "trajectory_world_[0-9]*.tum",
    "trajectory_[0-9]*.kitti",
    "odometry_[0-9]*.tum",
    "map_[0-9]*.pcd",
    "map_world_[0-9]*.pcd",
    "run_[0-9]*.mcap",
    "logs/*.log",
)


def claim(folder: Path, inputs: Iterable[Path] = (), recording: Iterable[str] = ()) -> Claim:
    """Claims all files of a run, so that none of an earlier run is taken for a new one; also those
    of the recording if the run makes it."""
    return claims.claim(folder, (*MADE_BY_STAGES, *MADE_HERE, *recording), inputs, FURTHER)


def claim_own(folder: Path, inputs: Iterable[Path] = ()) -> Claim:
    """Claims only the files written here, for stages that write elsewhere."""
    return claims.claim(folder, MADE_HERE, inputs)


#: A pose of a file is a received one if it has its instant and is this close to it.
SAME_POSE_M = 1e-3


def numbered(path: Path, heard: Trajectory) -> Trajectory:
    """A stage's file, with the sweep of each pose found by the instants of the received poses."""
    written = trajectory.read(path)
    if heard.stamps_ns is None or written.stamps_ns is None:
        return written
    sweep_at = {int(t): int(n) for t, n in zip(heard.stamps_ns, heard.sweeps, strict=True)}
    sweeps = np.array([sweep_at.get(int(t), -1) for t in written.stamps_ns], np.int64)
    return replace(written, sweeps=sweeps)


def _in_common(path: Path, heard: Trajectory, within_m: float) -> int:
    """Number of received poses that the file contains; 0 if it cannot be read, or has other poses
    at most of their instants: each run of a recording begins at the same place."""
    try:
        written = trajectory.read(path)
    except TrajectoryError:
        return 0
    if heard.stamps_ns is None or written.stamps_ns is None:
        return 0
    _, own, of_heard = np.intersect1d(written.stamps_ns, heard.stamps_ns, return_indices=True)
    apart_m = np.linalg.norm(written.positions[own] - heard.positions[of_heard], axis=1)
    same = int((apart_m <= within_m).sum())
    return same if 2 * same > len(own) else 0


def _each_run(plain: Path) -> list[Path]:
    """A stage's existing files, one for each run."""
    further = sorted(plain.parent.glob(f"{plain.stem}_[0-9]*{plain.suffix}"))
    return [path for path in (plain, *further) if path.exists()]


def of_run(plain: Path, heard: Trajectory, within_m: float = SAME_POSE_M) -> Path | None:
    """The one of a stage's files, one for each run, that contains most of the received poses.
    None: all are of other runs, also of one that replayed the same recording."""
    counts = {path: _in_common(path, heard, within_m) for path in _each_run(plain)}
    most = max(counts.values(), default=0)
    return next((path for path, count in counts.items() if count == most > 0), None)


def _world_file(folder: Path, run: Run) -> Path | None:
    """The graph's file with this run's poses, which it has moved: only the instants are common."""
    if run.graph is None:
        return None
    return of_run(Files(folder).world_tum, run.trajectory, np.inf)


@contextmanager
def _noted(lacks: list[str]) -> Iterator[None]:
    """Notes a file that can't be written, as on a full disk: it costs none of the others."""
    try:
        yield
    except OSError as error:
        lacks.append(f"{error.filename}: {error.strerror or error}")


def collected(folder: Path, run: Run, lacks: list[str]) -> Run:
    """The run with the trajectories that the stages wrote, or else the received poses, which are
    then written to files of their own."""
    files = Files(folder)
    if not len(run.trajectory):
        return run  # An empty file would look like a drive.
    world = _world_file(folder, run)
    if world is not None:
        run = replace(run, world=numbered(world, run.trajectory))
    odometry = of_run(files.odometry_tum, run.odometry)
    if odometry is not None:
        run = replace(run, odometry=numbered(odometry, run.odometry))
    elif len(run.odometry):
        with _noted(lacks):
            trajectory.write_tum(files.heard_odometry, run.odometry)
    written = of_run(files.trajectory_tum, run.trajectory)
    if written is not None:
        return replace(run, trajectory=numbered(written, run.trajectory))
    with _noted(lacks):
        trajectory.write_tum(files.heard_tum, run.trajectory)
    with _noted(lacks):
        trajectory.write_kitti(files.heard_kitti, run.trajectory)
    return run


def trajectory_file(folder: Path, run: Run) -> str | None:
    """Name of the file with the reported run's poses; None: the run has none."""
    if not len(run.trajectory):
        return None
    files = Files(folder)
    return (of_run(files.trajectory_tum, run.trajectory) or files.heard_tum).name


def earlier_runs(folder: Path, run: Run) -> list[str]:
    """Files with poses of runs before the reported one."""
    plain = Files(folder).trajectory_tum
    own = of_run(plain, run.trajectory)
    return [f"{p.name} ({len(trajectory.read(p))} poses)" for p in _each_run(plain) if p != own]


def map_points(folder: Path) -> np.ndarray[Any, Any]:
    """The map that mapping wrote, for the picture; empty if the file is missing, which the report
    states."""
    path = Files(folder).map
    return clouds.read_pcd(path) if path.exists() else np.empty(0, MAP_POINT)


def write_picture(folder: Path, title: str, run: Run) -> None:
    """Draws map, path, and the error against the first reference."""
    stamps = run.trajectory.stamps_ns
    first = int(stamps[0]) if stamps is not None and len(stamps) else 0
    compared = None
    for truth in run.truths.values():
        compared = compared or evaluation.compare(run.trajectory, truth)
    scene = picture.Scene(
        title,
        map_points(folder),
        run.trajectory.positions,
        run.trajectory.times_s(first),
        compared,
    )
    picture.draw(Files(folder).picture, scene)


def missing_files(folder: Path, run: Run) -> list[str]:
    """The stages' files that are missing although there was something to write."""
    files = Files(folder)
    missing = []
    if len(run.trajectory) and of_run(files.trajectory_tum, run.trajectory) is None:
        missing.append(
            f"{files.trajectory_tum} by integration (what was heard is in {files.heard_tum.name})"
        )
    if run.mapped and not files.map.exists():
        missing.append(f"{files.map} by mapping")
    if len(run.trajectory) and run.graph is not None and _world_file(folder, run) is None:
        missing.append(f"{files.world_tum} by graph")
    return missing


def missing_poses(run: Run, found: dict[str, Any]) -> list[str]:
    """Says that the reported file has fewer poses than were published, as when some of them did not
    come here: all figures of the trajectory are then of a part of the run."""
    if found["identities"]["several_runs"]:
        return []  # Each run has its own file.
    published = found["identities"]["poses"]
    missing = published - len(run.trajectory) - run.trajectory.left_out
    if found["trajectory_file"] is None or missing <= 0:
        return []
    return [f"{missing} of {published} poses in {found['trajectory_file']}"]


#: Topics of a stage's health that tell of a result that is not in a file.
FILE_TOPICS = ("map file", "trajectory", "journal", "files", "points", "disk", "lost output")


def unwritten(run: Run) -> list[str]:
    """What the stages say that they could not write: in containers, nobody else learns of it."""
    return [
        f"{stage}: {text}"
        for stage, status in run.statuses.items()
        for text in remarks.reasons_in(status)
        if text.partition(": ")[0] in FILE_TOPICS
    ]


def write_all(
    folder: Path, title: str, run: Run, *, stages_write_here: bool = True
) -> dict[str, Any]:
    """Writes all files that the stages do not write themselves; returns the report."""
    files = Files(folder)
    missing = missing_files(folder, run) if stages_write_here else []
    run = collected(folder, run, missing)
    sweeps = max(report.accounts_of(run).sweeps, len(run.trajectory))
    truths, lacks = references.of_drive(run.truths, sweeps)
    run = replace(run, truths=truths, no_reference=[*run.no_reference, *lacks])
    for truth in list(run.truths.values())[:1]:
        stamped = stamped_truth(truth, run.trajectory)
        if stamped.stamps_ns is not None:
            with _noted(missing):
                trajectory.write_tum(files.ground_truth, stamped)
    with _noted(missing):
        pose_table.write(files.poses, run.poses)
    found = report.build(run)
    found["trajectory_file"] = trajectory_file(folder, run)
    found["not_written"] = [
        *missing,
        *missing_poses(run, found),
        *unwritten(run),
        *run.not_recorded,
    ]
    found["earlier_runs"] = earlier_runs(folder, run) if stages_write_here else []
    _write_report(folder, title, run, found)
    return found


def _write_report(folder: Path, title: str, run: Run, found: dict[str, Any]) -> None:
    """Writes report, picture and page; the report in memory names those that can't be written."""
    lacks, path = found["not_written"], Files(folder).report
    with _noted(lacks):
        report.write(path, found)
    with _noted(lacks):
        write_picture(folder, title, run)
    if path.exists():
        with _noted(lacks):
            html_report.write(folder, title)
