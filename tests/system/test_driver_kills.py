"""The live driver is killed with SIGKILL, later all containers at once: the packets that the sensor
sent meanwhile are counted exactly, and the map is restored."""

from __future__ import annotations

import itertools
import os
import struct
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.decoded import udp_payloads
from tests.system.compose import Container
from tests.system.conftest import Drive, drive_of
from tests.system.live import LiveDeployment, running
from zloam_monitor import messages
from zloam_monitor.keys import Keys
from zloam_monitor.link import open_client
from zloam_monitor.records import StatusRecord

pytestmark = pytest.mark.system
#: fewer rounds are practical during development
ROUNDS = int(os.environ.get("ZLOAM_KILL_ROUNDS", "10"))
APART_S = 12.0
REPLICAS = 2
BACK_S = 40.0
BEFORE_SWEEPS = 100
#: limit of the time until every container is healthy again after all were killed at once
ALL_BACK_S = 90.0
ALL = ("router", "store", "registration", "odometry", "mapping", "integration", "driver")


@dataclass(frozen=True)
class Heard:
    """A sweep's number, and the stamps of its first and last packets."""

    number: int
    first_toh_us: int
    last_toh_us: int


class Sweeps:
    """The driver's sweeps as received by any subscriber, in order of arrival; each driver process
    is a run."""

    def __init__(self, port: int) -> None:
        self._session = open_client([f"tcp/127.0.0.1:{port}"])
        self.runs: dict[int, list[Heard]] = {}
        key = Keys("robot").sweep
        self._subscriber = self._session.declare_subscriber(key, self._heard)

    def _heard(self, sample: Any) -> None:
        sweep = messages.decode("Sweep", sample.payload.to_bytes())
        number = sweep.Header().Sweep()
        run = self.runs.setdefault(sweep.Header().Run(), [])
        if not run or number > run[-1].number:
            run.append(Heard(number, sweep.FirstPacketTohUs(), sweep.LastPacketTohUs()))

    def close(self) -> list[list[Heard]]:
        self._subscriber.undeclare()
        self._session.close()
        return list(self.runs.values())


def stamps_us(capture: Path) -> list[int]:
    """Stamps of all data packets in the order of sending."""
    return [
        struct.unpack_from("<I", payload, 1200)[0]
        for _, payload in udp_payloads(capture)
        if len(payload) == 1206
    ]


@dataclass(frozen=True)
class Killed:
    """The results of a live drive during which the driver was killed repeatedly."""

    runs: list[list[Heard]]
    registrations: list[StatusRecord]


@pytest.fixture(scope="module")
def driver_drive(images: None, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    seconds = round(1.4 * APART_S * ROUNDS) + 60
    return drive_of(tmp_path_factory.mktemp("driver"), seconds, "--laps", "4")


@pytest.fixture(scope="module")
def killed(driver_drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Killed:
    out = tmp_path_factory.mktemp("driver-killed")
    with running(driver_drive.pcap, out, "--scale", f"registration={REPLICAS}") as live:
        sweeps = Sweeps(live.deployment.router_port)
        live.until_sweep(BEFORE_SWEEPS)
        for _ in range(ROUNDS):
            began = time.monotonic()
            live.deployment.wait_back("driver", live.deployment.kill("driver"), BACK_S)
            time.sleep(max(0.0, began + APART_S - time.monotonic()))
        live.stop_sending()
        found = live.statuses()
    registrations = [s for (stage, _), s in found.items() if stage == "registration"]
    return Killed(sweeps.close(), registrations)


def test_each_kill_begins_a_run(killed: Killed) -> None:
    assert len(killed.runs) == ROUNDS + 1


def packets_of_a_sweep(runs: list[list[Heard]], place: dict[int, int]) -> tuple[int, int]:
    """The fewest and the most packets of a sweep."""
    counts = [
        place[after.last_toh_us] - place[before.last_toh_us]
        for run in runs
        for before, after in itertools.pairwise(run)
        if after.number == before.number + 1
    ]
    return min(counts), max(counts)


def test_the_packets_of_its_down_time_are_counted_exactly(
    killed: Killed, driver_drive: Drive
) -> None:
    """The sweep during which the driver was killed may have reached one subscriber and not another;
    a subscriber with one sweep more has missed that many packets less."""
    place = {stamp: number for number, stamp in enumerate(stamps_us(driver_drive.pcap))}
    missed = sum(
        place[after[0].first_toh_us] - place[before[-1].last_toh_us] - 1
        for before, after in itertools.pairwise(killed.runs)
    )
    assert missed > 0
    # Counted from each run's first to its last sweep, since sweeps missed here in between hide no
    # packets. Before the very first sweep received here, this subscriber was not connected yet.
    heard = killed.runs[0][0].number
    heard += sum(run[-1].number - run[0].number + 1 for run in killed.runs)
    fewest, most = packets_of_a_sweep(killed.runs, place)
    assert len(killed.registrations) == REPLICAS
    for status in killed.registrations:
        sweeps = status.inputs[0]
        more = sweeps.processed + sweeps.not_mine + sweeps.lost - heard
        assert abs(more) <= ROUNDS, (status.instance, sweeps, heard)
        difference = missed - status.figures["packets_between_runs"]
        bounds = sorted((more * fewest, more * most))
        assert bounds[0] <= difference <= bounds[1], (status.instance, more, difference)


def kill_all(live: LiveDeployment) -> list[tuple[str, Container]]:
    counts = {service: len(live.deployment.replicas(service)) for service in ALL}
    return [
        (service, live.deployment.kill(service, replica))
        for service, count in counts.items()
        for replica in range(count)
    ]


def test_all_killed_at_once_the_map_is_there(
    driver_drive: Drive, tmp_path_factory: pytest.TempPathFactory
) -> None:
    out = tmp_path_factory.mktemp("all-killed")
    with running(driver_drive.pcap, out, "--scale", f"registration={REPLICAS}") as live:
        live.until_sweep(2 * BEFORE_SWEEPS)
        before = live.newest("mapping").figures["map_points"]
        killed = kill_all(live)
        for service, container in killed:
            live.deployment.wait_back(service, container, ALL_BACK_S)
        live.until_sweep(BEFORE_SWEEPS)
        mapping = live.newest("mapping")
        live.stop_sending()
    assert before > 0
    # The store writes once a second; points sent after its last write are not in the map.
    assert mapping.figures["map_points_taken_back"] > 0.8 * before
    assert mapping.figures["map_points"] >= mapping.figures["map_points_taken_back"]
