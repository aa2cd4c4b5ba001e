"""A second container of each stage (deploy/compose/standby.yml): the working one is killed from the
host during a live drive, and no sweep is without a pose."""

from __future__ import annotations

import time

import pytest

from tests.system.conftest import Drive, Replayed, drive_of, replay
from tests.system.live import STAGES, Driven, LiveDeployment, running
from tests.system.test_replicas import digests

pytestmark = pytest.mark.system
LAYER = "deploy/compose/standby.yml"
#: By then the instance that takes over has its predecessor's map and motion.
APART_S = 8.0
BACK_S = 40.0


def working(live: LiveDeployment, stage: str) -> str:
    """Host name of the working container; instances that stand by receive no sweeps."""
    found = {i: s for (name, i), s in live.statuses().items() if name == stage}
    newest = max(s.stamp_ns for s in found.values())
    alive = {i: s for i, s in found.items() if newest - s.stamp_ns < 5_000_000_000}
    instance = max(alive, key=lambda i: alive[i].last_sweep or 0)
    return instance.rsplit("-", 1)[0]


@pytest.fixture(scope="module")
def laps(images: None, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """A drive longer than all kills take."""
    seconds = round(len(STAGES) * (APART_S + BACK_S / 2)) + 30
    return drive_of(tmp_path_factory.mktemp("laps"), seconds, "--laps", "20")


@pytest.fixture(scope="module")
def killed(laps: Drive, tmp_path_factory: pytest.TempPathFactory) -> Driven:
    with running(laps.pcap, tmp_path_factory.mktemp("standby"), layers=(LAYER,)) as live:
        live.until_sweep(80)
        for stage in STAGES:
            began = time.monotonic()
            host = working(live, stage)
            replicas = live.deployment.replicas(stage)
            (index,) = [k for k, each in enumerate(replicas) if each.hostname == host]
            gone = live.deployment.kill(stage, index)
            live.deployment.wait_back(stage, gone, BACK_S)
            time.sleep(max(0.0, began + APART_S - time.monotonic()))
        return live.end()


def test_no_sweep_is_without_a_pose(killed: Driven) -> None:
    assert killed.absent() == []


def test_accounts_balance(killed: Driven) -> None:
    killed.assert_accounts_balance()


def test_each_stage_had_two_and_one_that_came_back(killed: Driven) -> None:
    for stage in STAGES:
        assert len([name for name, _ in killed.statuses if name == stage]) == 3, stage


@pytest.fixture(scope="module")
def pair(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    return replay(drive, tmp_path_factory.mktemp("pair"), layers=(LAYER,))


def test_a_replay_beside_those_that_stand_by_has_the_same_bytes(
    pair: Replayed, undisturbed: Replayed
) -> None:
    assert digests(pair.out) == digests(undisturbed.out)
