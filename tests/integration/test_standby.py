"""Stages are killed with SIGKILL while second instances stand by: every sweep has its pose."""

from __future__ import annotations

import os
import random
import time
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import Capture, kill, monitor, simulate
from tests.integration.live_run import REPLACED, LiveRun, rmse_m, written_in
from tests.integration.test_handover import waiting
from zloam_monitor import doctor
from zloam_monitor.link import STANDING_BY

#: length of the drive, at least, and of its capture
SECONDS, CAPTURE_S = 20.0, 32.0
#: poses before the first kill (by then there is a map), and between two
FIRST, APART = 40, 25
#: order of the kills; stages on the pose's path come more often
VICTIMS = ("odometry", "mapping", "integration", "registration", "odometry", "integration")
#: kills during one drive; the store has no standby, and no pose needs it
KILLS = int(os.environ.get("ZLOAM_KILLS", "100"))
KILLED = ("odometry", "mapping", "integration", "registration", "store")
BETWEEN_S = 2.5
SEED = 1
#: Limit of the error: a factor on the undisturbed run's, plus metres.
WORSE, FLOOR_M = 1.1, 0.002


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    return simulate(build, folder, "--world", "city", "--seed", "4", "--duration", str(CAPTURE_S))


def until_stood_by(run: LiveRun, *stages: str) -> None:
    """Waits until an instance of each of these stages stands by, as one that was started again on
    a busy machine does only after seconds."""
    run._until(lambda: all(waiting(run.chain.link, stage) for stage in stages))


def assert_one_long_trajectory(run: LiveRun, last_sweep: int | None) -> None:
    written = run.assert_one_trajectory(last_sweep)
    assert np.linalg.norm(np.diff(written.positions, axis=0), axis=1).sum() > 50.0


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
        until_stood_by(run, *REPLACED)
        standbys = [s for s in chain.link.statuses.values() if s.reason == STANDING_BY]
        assert {s.stage for s in standbys} == set(REPLACED)
        heard = doctor.listen(chain.link, 1.0)
        assert [f for f in doctor.findings(heard) if "instance" in f.what] == []
        working = {s: s for s in VICTIMS}
        for count, stage in enumerate(VICTIMS):
            run.until_poses(FIRST + APART * count)
            until_stood_by(run, *REPLACED)
            victim = working[stage]
            kill(chain, victim)
            # The standby works from now on, and the restarted instance stands by for it.
            other = f"{stage}-standby" if victim == stage else stage
            working[stage] = other
            chain.start(victim, f"{victim}-again-{count}")
        run.until_poses(FIRST + APART * len(VICTIMS))
        until_stood_by(run, *REPLACED)
        statuses = run.end()
    assert_one_long_trajectory(run, statuses["driver"].last_sweep)
    assert max(sweep for _, sweep in run.poses) == statuses["driver"].last_sweep


@pytest.mark.slow
def test_a_hundred_kills_cost_no_pose(build: Path, robot_file: Path, tmp_path: Path) -> None:
    """At the sensor's own pace. The kills may only increase the error, and only a little."""
    seconds = BETWEEN_S * KILLS + 12.0
    options = ("--world", "city", "--seed", "4", "--laps", "20", "--duration", str(seconds + 1))
    drive = simulate(build, tmp_path, *options)
    calm = tmp_path / "calm"
    done = monitor("demo", "--preset-dir", build, "--pcap", drive.pcap, "--out", calm)
    assert done.code == 0, done.said
    out = tmp_path / "out"
    out.mkdir()
    more = ("recovery.standby=true",)
    run = LiveRun(build, robot_file, drive, out, seconds=seconds, slower=1.0, more=more)
    dice = random.Random(SEED)
    with run:
        chain = run.chain
        chain.start_standbys()
        chain._commands["store"] = run._store
        run.until_poses(FIRST)
        working = {stage: stage for stage in KILLED}
        pauses: dict[str, list[float]] = {stage: [] for stage in KILLED}
        for count in range(KILLS):
            stage = dice.choice(KILLED)
            victim = working[stage]
            kill(chain, victim)
            killed_s = time.monotonic()
            if stage != "store":
                working[stage] = f"{stage}-standby" if victim == stage else stage
            chain.start(victim, f"{victim}-again-{count}")
            run.wait(BETWEEN_S)
            pauses[stage].append(run.longest_pause_s(killed_s))
        statuses = run.end()
    assert_one_long_trajectory(run, statuses["driver"].last_sweep)
    for stage, found in pauses.items():
        print(f"{stage}: {len(found)} kills, pauses {np.round(sorted(found), 2)}")
    # The poses are compared by sweep number: the host's clock is not the capture's.
    found_poses, _ = run.trajectory(calm)
    assert rmse_m(found_poses, drive) <= WORSE * rmse_m(written_in(calm), drive) + FLOOR_M
