"""References and trajectories of a run keep their files' names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from test_report import STEP_NS, run_with
from zloam_monitor import comparison, outputs, trajectory


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
