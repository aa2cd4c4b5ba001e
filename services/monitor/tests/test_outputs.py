"""References and trajectories of a run keep their files' names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from test_doctor import status
from test_report import STEP_NS, run_with
from zloam_monitor import comparison, outputs, report, trajectory


def test_what_a_stage_could_not_write_is_not_written(tmp_path: Path) -> None:
    run = run_with([n * STEP_NS for n in range(1, 20)])
    reason = "imu: none comes; map file: cannot write out/map.pcd: No space left on device"
    said = status("mapping", health="degraded", reason=reason)
    found = outputs.write_all(
        tmp_path, "a run", replace(run, statuses={"mapping": said}), stages_write_here=False
    )
    assert found["not_written"] == [
        "mapping: map file: cannot write out/map.pcd: No space left on device"
    ]
    assert report.exit_code(found) == 3


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
