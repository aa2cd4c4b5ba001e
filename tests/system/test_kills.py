"""The main process of each container is killed from the host with SIGKILL, in rounds during a live
drive: each restarts by itself and continues in the same map, and missed sweeps are counted."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.system.compose import ROOT
from tests.system.conftest import Drive, demo_command, demo_environment, drive_of
from tests.system.live import STAGES, Driven, LiveDeployment, Window, gap_of, running
from zloam_monitor.records import StatusRecord
from zloam_monitor.trajectory import Trajectory, read

pytestmark = pytest.mark.system
#: fewer rounds are practical during development
ROUNDS = int(os.environ.get("ZLOAM_KILL_ROUNDS", "10"))
APART_S = 12.0
KILLED = ("registration", "router", "store", "mapping", "odometry", "integration")
REPLICAS = 2
#: limit of the time until a container is healthy again; the health check runs every 2 s
BACK_S = 40.0
#: Sweeps before the first kill: a lap, so that the whole map exists. The errors are then those of
#: using the map; those of building it differ widely after the slightest change.
BEFORE_SWEEPS = 780
#: limit of the used /dev/shm in the last round: a factor on the first round's, plus bytes
FLAT, FLOOR_BYTES = 1.1, 1 << 20


@dataclass(frozen=True)
class Kill:
    """The end of one container, and its next process's status shortly before the next kill."""

    round: int
    service: str
    at_ns: int
    status: StatusRecord | None
    shared_bytes: int


@dataclass(frozen=True)
class Killed:
    """The drive after all rounds."""

    kills: list[Kill]
    driven: Driven

    def of(self, *services: str) -> list[tuple[Kill, Window]]:
        """The kills of these services, each with its window."""
        found = self.driven.windows([k.at_ns for k in self.kills])
        return [(k, w) for k, w in zip(self.kills, found, strict=True) if k.service in services]


def kill_and_wait(running: LiveDeployment, turn: int, service: str) -> Kill:
    deployment = running.deployment
    replica = turn % len(deployment.replicas(service))
    began, at_ns = time.monotonic(), time.time_ns()
    killed = deployment.kill(service, replica)
    deployment.wait_back(service, killed, BACK_S)
    time.sleep(max(0.0, began + APART_S - time.monotonic()))
    status = running.newest(service) if service in STAGES else None
    return Kill(turn, service, at_ns, status, deployment.shared_bytes())


@pytest.fixture(scope="module")
def long_drive(images: None, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """Laps of the city, longer than all rounds together."""
    seconds = round(1.4 * APART_S * ROUNDS * len(KILLED) + 0.1 * BEFORE_SWEEPS) + 30
    return drive_of(tmp_path_factory.mktemp("laps"), seconds, "--laps", "20")


@dataclass(frozen=True)
class Beside:
    """A replay that runs beside the test."""

    out: Path
    process: subprocess.Popen[str]

    def end(self) -> Path:
        said, _ = self.process.communicate()
        assert self.process.returncode == 0, said[-3000:]
        return self.out / "trajectory.tum"


@pytest.fixture(scope="module")
def calm_beside(long_drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Beside]:
    """The undisturbed replay, by plain processes, which give the same bytes. It runs during the
    kills with idle CPU time: this is the load that the acceptance demands, and it saves minutes."""
    out = tmp_path_factory.mktemp("calm")
    process = subprocess.Popen(
        ["chrt", "--idle", "0", *demo_command(out, "--pcap", long_drive.pcap)],
        cwd=ROOT,
        env=demo_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    yield Beside(out, process)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.communicate()


@pytest.fixture(scope="module")
def calm(killed: Killed, calm_beside: Beside) -> Trajectory:
    return read(calm_beside.end())


@pytest.fixture(scope="module")
def killed(
    long_drive: Drive, calm_beside: Beside, tmp_path_factory: pytest.TempPathFactory
) -> Killed:
    out = tmp_path_factory.mktemp("killed")
    options = ("--scale", f"registration={REPLICAS}")
    with running(long_drive.pcap, out, *options, shared_memory=True) as live:
        live.until_sweep(BEFORE_SWEEPS, seconds=200.0)
        kills = [kill_and_wait(live, t, service) for t in range(ROUNDS) for service in KILLED]
        return Killed(kills, live.end())


@pytest.mark.parametrize("service", [s for s in KILLED if s != "odometry"])
def test_no_sweep_is_missing(killed: Killed, service: str) -> None:
    missing = {kill.round: window.absent for kill, window in killed.of(service)}
    assert missing == {turn: [] for turn in range(ROUNDS)}


def test_the_odometrys_gap_is_counted(killed: Killed) -> None:
    for kill, window in killed.of("odometry"):
        assert kill.status is not None
        assert len(window.absent) <= gap_of(kill.status), (kill.round, window.absent)


@pytest.mark.parametrize("service", KILLED)
def test_the_trajectory_goes_on_in_its_map(
    killed: Killed, calm: Trajectory, long_drive: Drive, service: str
) -> None:
    truth = read(long_drive.truth_base)
    for _, window in killed.of(service):
        killed.driven.assert_as_good(calm, truth, window.poses, BEFORE_SWEEPS)


def test_shared_memory_is_flat(killed: Killed) -> None:
    rounds = [max(k.shared_bytes for k in killed.kills if k.round == t) for t in range(ROUNDS)]
    assert rounds[-1] <= FLAT * rounds[0] + FLOOR_BYTES, rounds


def test_accounts_balance(killed: Killed) -> None:
    killed.driven.assert_accounts_balance()
