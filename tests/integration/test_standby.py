"""Stages are killed with -9 while second instances stand by: every sweep has its pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import Capture, kill, simulate
from tests.integration.live_run import BRIDGING, LiveRun
from zloam_monitor import doctor
from zloam_monitor.link import STANDING_BY
from zloam_monitor.records import HEALTH
from zloam_monitor.trajectory import read

SECONDS = 26.0
#: poses between two kills; the first when there is a map
FIRST, APART = 40, 25
#: each of them, twice those that poses pass through
VICTIMS = ("odometry", "mapping", "integration", "registration", "odometry", "integration")
LOST = HEALTH.index("lost")


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    return simulate(build, folder, "--world", "city", "--seed", "4", "--duration", str(SECONDS + 1))


def test_no_kill_costs_a_pose(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    run = LiveRun(
        build, robot_file, drive, tmp_path, seconds=SECONDS, more=("recovery.standby=true",)
    )
    with run:
        chain = run.chain
        chain.start_standbys()
        run.until_poses(FIRST)
        waiting = [s for s in chain.link.statuses.values() if s.reason == STANDING_BY]
        assert {s.stage for s in waiting} == {"odometry", "mapping", "integration"}
        heard = doctor.listen(chain.link, 1.0)
        assert [f for f in doctor.findings(heard) if "instance" in f.what] == []
        working = {s: s for s in VICTIMS}
        for count, stage in enumerate(VICTIMS):
            run.until_poses(FIRST + APART * count)
            victim = working[stage]
            kill(chain, victim)
            # the other one works from now on, and this one stands by for it
            other = f"{stage}-standby" if victim == stage else stage
            working[stage] = other
            chain.start(victim, f"{victim}-again-{count}")
        statuses = run.end()
    numbers = sorted(sweep for _, sweep in run.poses)
    assert len({run_id for run_id, _ in run.poses}) == 1
    written = read(tmp_path / "trajectory.tum")
    last_sweep = statuses["driver"].last_sweep
    assert last_sweep is not None
    assert len(written) == last_sweep + 1
    assert numbers[-1] == last_sweep
    said = [pose.health for pose in run.poses.values()]
    assert said.count(LOST) == 0
    assert said.count(BRIDGING) == 0
    # nobody began a map or a frame of its own: at 10 Hz a car goes less than that in a sweep
    steps = np.linalg.norm(np.diff(written.positions, axis=0), axis=1)
    assert steps.max() < 2.0
    assert steps.sum() > 50.0
