"""The default deployment starts in time, gives right poses, and leaves nothing but the map."""

from __future__ import annotations

from typing import Any

import pytest

from tests.system.conftest import Finished, versions

pytestmark = [pytest.mark.system, pytest.mark.smoke]


def test_all_are_healthy_within_a_minute(run: Finished) -> None:
    assert run.healthy_after_s <= 60.0


def test_poses_flow_to_a_program_outside(run: Finished) -> None:
    assert run.poses_seen >= 10


def test_the_run_ends_with_every_sweep_accounted_for(run: Finished) -> None:
    identities = run.report["identities"]
    assert identities["sweeps_accounted"], identities
    assert identities["inputs_balanced"], identities
    assert identities["poses"] == identities["sweeps"]
    assert run.containers["monitor"]["ExitCode"] == 0
    assert run.containers["driver"]["ExitCode"] == 0


def test_the_error_is_that_of_the_demo(run: Finished, demo_report: dict[str, Any]) -> None:
    ours, theirs = run.report["ate_rmse_m"]["pose"], demo_report["ate_rmse_m"]["pose"]
    assert ours == pytest.approx(theirs, rel=0.10)


def test_files_are_left(run: Finished) -> None:
    for name in ("trajectory.tum", "map.pcd", "picture.png", "report.json"):
        assert (run.deployment.out / name).stat().st_size > 0, name


def test_down_leaves_nothing_and_the_map_comes_back(run: Finished) -> None:
    assert run.tiles_live
    run.deployment.run("down", "--timeout", "20")
    assert run.deployment.leftovers() == {"containers": [], "networks": [], "mounts": []}
    # Only the store runs: no other process has the map.
    run.deployment.run("up", "--no-build", "--detach", "--wait", "store")
    assert versions(run.deployment.router_port) == run.tiles_live
