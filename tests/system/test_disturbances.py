"""A live drive in which each stage hangs for a while, the router disappears, and mapping gets only
a part of a core: the poses continue in the same map, and missed sweeps are counted."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from dataclasses import dataclass

import numpy as np
import pytest

from tests.system.conftest import Drive, Replayed, drive_of, replay
from tests.system.live import STAGES, Driven, LiveDeployment, Window, gap_of, running
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_client
from zloam_monitor.records import StatusRecord
from zloam_monitor.trajectory import read

pytestmark = pytest.mark.system
#: sweeps of a lap, after which the whole map exists
BEFORE_SWEEPS = 780
REPLICAS = 2
HANG_S, AFTER_HANG_S = 5.0, 10.0
ROUTER_GONE_S, AFTER_ROUTER_S = 30.0, 10.0
#: shares of a core for mapping: the one of the acceptance, and one that is too small
CPUS, TOO_FEW_CPUS = 0.5, 0.1
SHORT_OF_CPU_S = 20.0
#: Limit of mapping's resident memory at the end: a factor on that before CPU time was short, plus
#: MiB.
GROWTH, FLOOR_MIB = 1.2, 32.0
DRIVE_SECONDS = 300


@dataclass(frozen=True)
class Disturbance:
    """A disturbance, its time, and the disturbed stage's status shortly afterwards."""

    name: str
    at_ns: int
    status: StatusRecord | None = None


@dataclass(frozen=True)
class Disturbed:
    """The drive after all disturbances."""

    done: list[Disturbance]
    driven: Driven
    poses_after_router: int

    def of(self, name: str) -> tuple[Disturbance, Window]:
        found = self.driven.windows([d.at_ns for d in self.done])
        return next(pair for pair in zip(self.done, found, strict=True) if pair[0].name == name)


def hang(live: LiveDeployment, stage: str) -> Disturbance:
    process = live.deployment.replicas(stage)[0].pid
    at_ns = time.time_ns()
    os.kill(process, signal.SIGSTOP)
    time.sleep(HANG_S)
    os.kill(process, signal.SIGCONT)
    time.sleep(AFTER_HANG_S)
    return Disturbance(f"hang {stage}", at_ns, live.newest(stage))


def without_router(live: LiveDeployment) -> tuple[Disturbance, int]:
    """Stops the router for a while; also returns the number of poses that a client, connected
    before, received after the router's return."""
    session = open_client([f"tcp/127.0.0.1:{live.deployment.router_port}"])
    link = Link(session, Keys("robot"))
    at_ns = time.time_ns()
    live.deployment.run("stop", "router")
    time.sleep(ROUTER_GONE_S)
    link.poll()
    before = len(link.poses)
    live.deployment.run("start", "router")
    deadline = time.monotonic() + AFTER_ROUTER_S
    while time.monotonic() < deadline:
        link.poll(0.2)
    heard = len(link.poses) - before
    link.close()
    session.close()
    return Disturbance("router gone", at_ns), heard


def short_of_cpu(live: LiveDeployment, cpus: float) -> Disturbance:
    container = live.deployment.replicas("mapping")[0]
    at_ns = time.time_ns()

    def limit(value: float) -> None:
        limits = ["docker", "update", "--cpus", str(value), container.name]
        subprocess.run(limits, check=True, capture_output=True)

    limit(cpus)
    time.sleep(SHORT_OF_CPU_S)
    status = live.newest("mapping")
    limit(float(os.cpu_count() or 1))
    return Disturbance(f"cpus {cpus}", at_ns, status)


@pytest.fixture(scope="module")
def disturbed_drive(images: None, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return drive_of(tmp_path_factory.mktemp("disturbed-drive"), DRIVE_SECONDS, "--laps", "4")


@pytest.fixture(scope="module")
def calm(disturbed_drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    return replay(disturbed_drive, tmp_path_factory.mktemp("calm"), seconds=600)


@pytest.fixture(scope="module")
def disturbed(disturbed_drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Disturbed:
    out = tmp_path_factory.mktemp("disturbed")
    with running(disturbed_drive.pcap, out, "--scale", f"registration={REPLICAS}") as live:
        live.until_sweep(BEFORE_SWEEPS, seconds=200.0)
        done = [hang(live, stage) for stage in STAGES]
        gone, heard = without_router(live)
        done.append(gone)
        done += [Disturbance("calm", time.time_ns(), live.newest("mapping"))]
        done += [short_of_cpu(live, cpus) for cpus in (CPUS, TOO_FEW_CPUS)]
        return Disturbed(done, live.end(), heard)


def test_a_hanging_registration_costs_no_sweep(disturbed: Disturbed) -> None:
    """The hanging replica's token stays alive, yet the other replica processes its sweeps."""
    assert disturbed.of("hang registration")[1].absent == []


@pytest.mark.parametrize("stage", ["odometry", "integration"])
def test_a_hang_on_the_way_of_the_pose_is_counted(disturbed: Disturbed, stage: str) -> None:
    hang, window = disturbed.of(f"hang {stage}")
    assert hang.status is not None
    assert len(window.absent) <= gap_of(hang.status)


def test_a_hanging_mapping_costs_no_pose(disturbed: Disturbed) -> None:
    assert disturbed.of("hang mapping")[1].absent == []


@pytest.mark.parametrize("stage", STAGES)
def test_after_a_hang_the_trajectory_goes_on_in_its_map(
    disturbed: Disturbed, calm: Replayed, disturbed_drive: Drive, stage: str
) -> None:
    undisturbed, truth = read(calm.out / "trajectory.tum"), read(disturbed_drive.truth_base)
    _, window = disturbed.of(f"hang {stage}")
    after = np.flatnonzero(window.poses)[round(10 * HANG_S) :]
    disturbed.driven.assert_as_good(undisturbed, truth, after, BEFORE_SWEEPS)


def test_without_the_router_nothing_is_missing_on_the_host(disturbed: Disturbed) -> None:
    assert disturbed.of("router gone")[1].absent == []


def test_whoever_hears_through_the_router_hears_again(disturbed: Disturbed) -> None:
    # There are 10 poses per second, but the router and both links need a part of the time to come
    # back.
    assert disturbed.poses_after_router >= 5 * AFTER_ROUTER_S / 2


@pytest.mark.parametrize("cpus", [CPUS, TOO_FEW_CPUS])
def test_with_little_time_for_mapping_the_pose_keeps_its_rate(
    disturbed: Disturbed, cpus: float
) -> None:
    assert disturbed.of(f"cpus {cpus}")[1].absent == []


def test_mapping_names_its_want_of_time_and_does_not_grow(disturbed: Disturbed) -> None:
    before, short = disturbed.of("calm")[0].status, disturbed.of(f"cpus {TOO_FEW_CPUS}")[0].status
    assert before is not None
    assert short is not None
    assert short.health == "degraded"
    assert short.reason
    dropped = sum(i.dropped.get("queue_full", 0) for i in short.inputs)
    assert dropped > sum(i.dropped.get("queue_full", 0) for i in before.inputs)
    assert short.rss_mib["end"] <= GROWTH * before.rss_mib["end"] + FLOOR_MIB


def test_accounts_balance(disturbed: Disturbed) -> None:
    disturbed.driven.assert_accounts_balance()
