"""A replay in which a stage is killed with SIGKILL, for tests of what it leaves behind."""

from __future__ import annotations

import time
from pathlib import Path

from tests.integration.conftest import PATIENCE_S, kill
from tests.integration.live_run import (
    KILL_AT,
    STAGES,
    STORE_LINK_S,
    store_command,
)
from zloam_monitor import outputs, sources
from zloam_monitor.chain import Chain
from zloam_monitor.records import StatusRecord
from zloam_monitor.robot_file import names
from zloam_monitor.sources import Source


def assert_books(statuses: dict[str, StatusRecord], stages: tuple[str, ...]) -> None:
    for stage in stages:
        for account in statuses[stage].inputs:
            assert account.balanced(), (stage, account)


def chain_of(
    build: Path,
    robot_file: Path,
    pcap: Path,
    out: Path,
    *more: str,
    rate: str = "max",
    beside: tuple[str, ...] = (),
) -> Chain:
    """A chain that replays a capture as `zloam demo` does, with these settings in addition."""
    robot = names(robot_file, [])
    settings = [
        *outputs.stage_settings(out),
        *sources.from_pcap(pcap).driver_settings(rate),
        *more,
    ]
    where = (build, robot_file, robot.robot, settings, out / "logs", robot.sensor)
    return Chain(*where, beside=beside)


def replayed(
    build: Path,
    robot_file: Path,
    source: Source,
    out: Path,
    stage: str | None,
    tiles: Path | None = None,
) -> dict[str, StatusRecord]:
    """Final statuses of a replay in which the stage, if given, is killed once; with a store if
    `tiles` is given."""
    robot = names(robot_file, [])
    settings = [
        *source.driver_settings("realtime"),
        f"integration.output_dir={out}",
        f"mapping.map_path={out / 'map.pcd'}",
        f"mapping.store_link_s={STORE_LINK_S if tiles else 0}",
    ]
    chain = Chain(build, robot_file, robot.robot, settings, out, robot.sensor)
    if tiles is not None:
        command = store_command(build, robot_file, chain, tiles)
        chain.processes.start("store", command, out / "store.log")
    with chain:
        if stage is not None:
            _kill_under_way(chain, stage)
        deadline = time.monotonic() + 3 * PATIENCE_S
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
            assert time.monotonic() < deadline, "the run does not end"
        chain.link.query_statuses()
        poses = dict(chain.link.poses)
        codes = chain.stop()
        statuses = chain.statuses()
    assert set(codes.values()) == {0}, codes
    assert sorted(poses) == list(range(statuses["driver"].last_sweep + 1))
    assert_books(statuses, STAGES)
    return statuses


def _kill_under_way(chain: Chain, stage: str) -> None:
    while len(chain.link.poses) < KILL_AT:
        chain.link.poll(0.1)
        chain.check()
    kill(chain, stage)
    chain.start(stage, f"{stage}-again")
