"""The search's judgement of runs that are written here with known errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.bench.search import judge
from tests.bench.search.judge import DEGENERATE, LOST, OK
from zloam_monitor.trajectory import Trajectory, write_tum

STEP_M, STEP_NS = 0.5, 100_000_000
POSES = 60


def line_along_x(offsets_m: dict[int, float]) -> Trajectory:
    """A straight line with 0.5 m per pose; from each given pose on it is shifted sideways by the
    offset."""
    transforms = np.tile(np.eye(4), (POSES, 1, 1))
    transforms[:, 0, 3] = STEP_M * np.arange(POSES)
    transforms[:, 2, 3] = 0.1 * np.sin(
        0.1 * np.arange(POSES)
    )  # otherwise rotations about x would be free in the alignment
    for pose, offset in offsets_m.items():
        transforms[pose:, 1, 3] += offset
    return Trajectory(transforms, STEP_NS * np.arange(POSES, dtype=np.int64), np.arange(POSES))


def write_run(
    folder: Path, offsets_m: dict[int, float], health: dict[int, int], sigma_m: float
) -> Path:
    """Writes the files of a run of zloam-offline."""
    estimate = line_along_x(offsets_m)
    for name in ("odom.tum", "est.tum", "fused.tum"):
        write_tum(folder / name, estimate)
    rows = [f"{i},{health.get(i, OK)},0,0,0,0,{int(i in offsets_m)}" for i in range(POSES)]
    (folder / "fused.csv").write_text("head\n" + "\n".join(rows) + "\n")
    cells = ",".join(str(v) for v in (np.eye(6) * sigma_m**2).ravel())
    covariances = "".join(f"{i},{cells}\n" for i in range(POSES))
    (folder / "fused_covariance.csv").write_text(covariances)
    (folder / "cost.csv").write_text("head\n" + "".join(f"{i},9,1,2,3,9\n" for i in range(POSES)))
    return folder


def test_a_step_aside_that_says_ok_is_silently_wrong(tmp_path: Path) -> None:
    run = write_run(tmp_path, {20: 0.2}, {}, sigma_m=0.01)
    found = judge.verdict(run, line_along_x({}))
    assert (found.silent, found.first_silent, found.jumps) == (1, 20, 1)
    assert found.worst_silent_m == pytest.approx(0.2 - 0.03 - 0.02, abs=1e-6)
    assert found.false_flags == 0


def test_an_error_within_three_sigmas_is_not(tmp_path: Path) -> None:
    run = write_run(tmp_path, {20: 0.2}, {}, sigma_m=0.0601)
    found = judge.verdict(run, line_along_x({}))
    assert (found.silent, found.vague) == (0, 0)


def test_a_sigma_beyond_what_a_user_asks_for_is_vague(tmp_path: Path) -> None:
    run = write_run(tmp_path, {20: 0.2}, {3: LOST}, sigma_m=0.11)
    found = judge.verdict(run, line_along_x({}))
    assert (found.silent, found.vague) == (0, POSES - 1)


def test_lost_hides_an_error_only_while_it_is_said(tmp_path: Path) -> None:
    lost = dict.fromkeys(range(20, 25), LOST)
    found = judge.verdict(write_run(tmp_path, {20: 0.2}, lost, 0.01), line_along_x({}))
    assert (found.silent, found.first_silent) == (1, 25)
    back = {20: 0.2, 25: -0.2}
    found = judge.verdict(write_run(tmp_path, back, lost, 0.01), line_along_x({}))
    assert found.silent == 0


def test_a_flag_is_false_where_the_last_ten_metres_are_right(tmp_path: Path) -> None:
    flags = {5: DEGENERATE, 21: LOST, 39: DEGENERATE, 41: LOST}
    found = judge.verdict(write_run(tmp_path, {20: 0.2}, flags, 0.01), line_along_x({}))
    # The step at pose 20 is within the last ten metres (twenty poses) of the poses 20 to 39.
    assert (found.false_flags, found.right) == (2, POSES - 20)
    open_way = judge.verdict(tmp_path, line_along_x({}), open_direction=True)
    assert open_way.false_flags == 1


def test_missing_poses_are_not_passed_over(tmp_path: Path) -> None:
    run = write_run(tmp_path, {}, {}, 0.01)
    lines = (run / "fused.csv").read_text().splitlines()
    (run / "fused.csv").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(RuntimeError, match="60 poses, 59 flags"):
        judge.verdict(run, line_along_x({}))


@pytest.mark.parametrize("variance", ["nan", "-1e-4"])
def test_a_covariance_that_is_none_excuses_nothing(tmp_path: Path, variance: str) -> None:
    run = write_run(tmp_path, {20: 0.2}, {}, 0.01)
    lines = (run / "fused_covariance.csv").read_text().splitlines()
    lines[20] = f"20,{variance}" + lines[20][lines[20].index(",", 3) :]
    (run / "fused_covariance.csv").write_text("\n".join(lines) + "\n")
    found = judge.verdict(run, line_along_x({}))
    assert (found.silent, found.first_silent, found.vague) == (1, 20, 1)


def test_a_mapped_sweep_without_a_fused_pose_is_not_passed_over(tmp_path: Path) -> None:
    run = write_run(tmp_path, {}, {}, 0.01)
    for name in ("fused.tum", "fused.csv", "fused_covariance.csv"):
        lines = (run / name).read_text().splitlines()
        (run / name).write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(RuntimeError, match="59 poses of 60 mapped sweeps"):
        judge.verdict(run, line_along_x({}))
