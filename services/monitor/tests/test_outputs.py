"""References and trajectories of a run keep their files' names."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from test_doctor import status
from test_report import STEP_NS, run_with
from zloam_monitor import claims, comparison, outputs, report, trajectory
from zloam_monitor.keys import Keys
from zloam_monitor.records import HEALTH, Input, StatusRecord
from zloam_monitor.report import Run
from zloam_monitor.stages import STAGES
from zloam_monitor.trajectory import Trajectory

KEYS = Keys("robot", "lidar")


def test_what_a_stage_could_not_write_is_not_written(tmp_path: Path) -> None:
    run = run_with([n * STEP_NS for n in range(1, 20)])
    reason = "imu: none comes; map file: cannot write out/map.pcd: No space left on device"
    said = status("mapping", health="degraded", reason=reason)
    run = replace(run, statuses={"mapping": said})
    found = outputs.write_all(tmp_path, "a run", run, stages_write_here=False)
    assert found["not_written"] == [
        "mapping: map file: cannot write out/map.pcd: No space left on device"
    ]
    assert report.exit_code(found) == 3


@contextmanager
def full_disk() -> Iterator[None]:
    """No file can grow."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_on_a_full_disk_the_run_is_still_reported(tmp_path: Path) -> None:
    run = run_with([n * STEP_NS for n in range(1, 20)])
    claim = outputs.claim(tmp_path)
    with full_disk(), claim:
        claim.begin()
        found = outputs.write_all(tmp_path, "a run", run, stages_write_here=False)
    lacking = ("heard.tum", "heard.kitti", "poses.csv", "report.json", "picture.png")
    for name in lacking:
        assert f"{tmp_path / name}: File too large" in found["not_written"]
        assert not (tmp_path / name).exists()
    assert report.exit_code(found) == 3
    assert f"not written: {tmp_path / 'poses.csv'}: File too large" in report.table(found)
    # A later run may replace what was written.
    claims.let_go()
    (tmp_path / "heard.tum").write_text("1 0 0 0 0 0 0 1\n")
    outputs.claim(tmp_path)


def test_the_report_names_the_file_of_its_own_run(tmp_path: Path) -> None:
    run = run_with([n * STEP_NS for n in range(1, 20)])
    earlier = run_with([n * STEP_NS for n in range(101, 120)])
    trajectory.write_tum(tmp_path / "trajectory.tum", earlier.trajectory)
    trajectory.write_tum(tmp_path / "trajectory_2.tum", run.trajectory)
    found = outputs.write_all(tmp_path, "second run", run)
    assert found["trajectory_file"] == "trajectory_2.tum"
    assert comparison.read(tmp_path).poses.stamps_ns is not None
    np.testing.assert_array_equal(
        comparison.read(tmp_path).poses.stamps_ns, run.trajectory.stamps_ns
    )


def test_a_run_without_poses_names_no_file(tmp_path: Path) -> None:
    assert outputs.write_all(tmp_path, "nothing", run_with([]))["trajectory_file"] is None


def moved(run: Run, factor: float) -> Run:
    """The same recording with another outcome: the instants stay."""
    poses = run.trajectory.transforms.copy()
    poses[:, 0, 3] *= factor
    path = replace(run.trajectory, transforms=poses)
    return replace(run, trajectory=path, odometry=path)


def followed(folder: Path, run: Run) -> dict[str, Any]:
    with outputs.claim_own(folder) as claim:
        claim.begin()
        return outputs.write_all(folder, "followed", run, stages_write_here=False)


@pytest.mark.parametrize("later_ns", [0, 3600 * 10**9])
def test_a_second_followed_run_is_reported_with_its_own_poses(
    tmp_path: Path, later_ns: int
) -> None:
    """Also where the recording, and so each instant, is the same."""
    first = run_with([n * STEP_NS for n in range(1, 20)])
    second = moved(run_with([n * STEP_NS + later_ns for n in range(1, 20)]), 10.0)
    assert followed(tmp_path, first)["path_m"] == pytest.approx(18.0)
    found = followed(tmp_path, second)
    assert found["path_m"] == pytest.approx(180.0)
    assert found["trajectory_file"] == "heard.tum"
    for name, is_of in (("heard.tum", second.trajectory), ("heard_odometry.tum", second.odometry)):
        written = trajectory.read(tmp_path / name)
        np.testing.assert_array_equal(written.stamps_ns, is_of.stamps_ns)
        np.testing.assert_allclose(written.positions, is_of.positions, atol=1e-8)


@pytest.mark.parametrize("name", ["trajectory", "odometry", "trajectory_world"])
def test_files_of_an_earlier_run_of_the_stages_are_not_the_run(tmp_path: Path, name: str) -> None:
    run = run_with([n * STEP_NS for n in range(1, 20)])
    trajectory.write_tum(tmp_path / f"{name}.tum", moved(run, 3.0).trajectory)
    before = (tmp_path / f"{name}.tum").read_bytes()
    truth = {"truth.tum": run.trajectory}
    found = followed(tmp_path, replace(run, truths=truth))
    assert found["path_m"] == pytest.approx(18.0)
    errors = found["references"]["truth.tum"]
    assert [each["ate_rmse_m"] for each in errors.values()] == pytest.approx([0.0, 0.0])
    assert (tmp_path / f"{name}.tum").read_bytes() == before


def counted(run: int, poses: int, driver: int | None = None) -> dict[str, StatusRecord]:
    """Statuses of stages that published so many sweeps each; the driver may have begun again,
    and the run that all are in has its sweeps only."""
    found = {}
    last = (poses if driver is None else driver) - 1
    for stage in STAGES:
        count = driver if stage == "driver" and driver is not None else poses
        name = KEYS.main_input(stage)
        inputs = (Input(name, count, count, 0, 0, 0, {}, 0, 0),) if name else ()
        made = status(stage, run=run, last_sweep=last, inputs=inputs, cpu_ms=10.0 * count)
        found[stage] = replace(made, published={KEYS.main_output(stage): count})
    return found


@pytest.mark.parametrize("came", [12, 20])
def test_a_file_with_a_part_of_the_poses_is_no_good_end(tmp_path: Path, came: int) -> None:
    """All figures of the trajectory are then of that part."""
    run = run_with([n * STEP_NS for n in range(20)])
    kept = {n: pose for n, pose in run.poses.items() if n < came}
    some = run_with([n * STEP_NS for n in range(came)]).trajectory
    run = replace(run, poses=kept, trajectory=some, statuses=counted(1, 20))
    found = followed(tmp_path, run)
    lacks = [] if came == 20 else ["8 of 20 poses in heard.tum"]
    assert found["not_written"] == lacks
    assert report.exit_code(found) == (3 if lacks else 0)
    assert ("not written: 8 of 20 poses in heard.tum" in report.table(found)) == bool(lacks)


def test_the_stages_file_has_what_did_not_come_here(tmp_path: Path) -> None:
    whole = run_with([n * STEP_NS for n in range(20)])
    trajectory.write_tum(tmp_path / "trajectory.tum", whole.trajectory)
    some = run_with([n * STEP_NS for n in range(12)])
    found = followed(tmp_path, replace(some, statuses=counted(1, 20)))
    assert (found["not_written"], found["trajectory_file"]) == ([], "trajectory.tum")
    assert found["path_m"] == pytest.approx(19.0)


def test_a_driver_that_began_again_spoils_no_figure(tmp_path: Path) -> None:
    """55 sweeps, 5 of them since the driver was started again; each cost every stage 10 ms."""
    run = replace(run_with([n * STEP_NS for n in range(5)]), statuses=counted(2, 55, driver=5))
    found = followed(tmp_path, run)
    assert (found["identities"]["sweeps"], found["identities"]["poses"]) == (55, 55)
    assert (report.complaints(found), report.exit_code(found)) == ([], 0)
    assert found["cpu_ms_per_sweep"] == dict.fromkeys(STAGES, pytest.approx(10.0))
    assert report.SEVERAL_RUNS in report.table(found)
    assert report.SEVERAL_RUNS in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(("poses", "error_known"), [(20, True), (12, True), (60, False)])
def test_a_reference_by_sweep_number_is_of_this_drive(
    tmp_path: Path, poses: int, error_known: bool
) -> None:
    run = replace(run_with([n * STEP_NS for n in range(20)]), statuses=counted(1, 20))
    truth = Trajectory(np.tile(np.eye(4), (poses, 1, 1)), None, np.arange(poses))
    truth.transforms[:, 0, 3] = np.arange(poses) - 0.5
    found = followed(tmp_path, replace(run, truths={"07.txt": truth}))
    assert list(found["references"]) == (["07.txt"] if error_known else [])
    said = (
        "07.txt: has no times and 60 poses, the run 20 sweeps; no error against this reference: "
        "cut it to the drive's scans, or give one with times (TUM)"
    )
    assert found["no_reference"] == ([] if error_known else [said])
    assert (said in report.table(found)) != error_known
    if error_known:
        remark = "no truth for 8 of 20 poses, which do not count"
        assert found["references"]["07.txt"]["pose"]["remark"] == (remark if poses < 20 else None)
        assert found["ate_rmse_m"]["pose"] == pytest.approx(0.0, abs=1e-9)


def test_a_comparison_shows_health_and_losses(tmp_path: Path) -> None:
    well = replace(run_with([n * STEP_NS for n in range(20)]), statuses=counted(1, 20))
    lost = {n: replace(pose, health=HEALTH.index("lost")) for n, pose in well.poses.items()}
    dropped = Input(str(KEYS.main_input("odometry")), 20, 15, 0, 0, 0, {"queue_full": 5}, 0, 0)
    statuses = counted(1, 15)
    statuses |= {stage: counted(1, 20)[stage] for stage in ("driver", "registration")}
    statuses["odometry"] = replace(statuses["odometry"], inputs=(dropped,))
    ill = replace(well, poses=lost, statuses=statuses)
    folders = [tmp_path / name for name in ("well", "ill")]
    for folder, run in zip(folders, (well, ill), strict=True):
        folder.mkdir()
        outputs.write_all(folder, folder.name, run)
    first, second = map(comparison.read, folders)
    figures = comparison.compared(first, second).figures
    assert figures["health: lost"] == (0.0, 20.0)
    assert figures["health: ok"] == (20.0, 0.0)
    assert figures["given up"] == (0.0, 5.0)
    assert figures["jumps"] == (0.0, 0.0)
    said = comparison.lines(comparison.compared(first, second))
    assert any(line.split() == ["health:", "lost", "0", "20"] for line in said)
    assert not any("health: degenerate" in line for line in said)
