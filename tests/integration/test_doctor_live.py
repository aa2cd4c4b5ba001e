"""Faults that are made on purpose on a robot that runs: the doctor names each (issue 41), and what
it says of a healthy one is in test_readme.py."""

from __future__ import annotations

import signal
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.acceptance import live
from tests.integration.conftest import Capture, kill, simulate
from tests.integration.live_run import LiveRun
from zloam_monitor import doctor

SECONDS = 14.0
#: of the drive before the fault
HEALTHY_POSES = 25
#: the product byte of the VLP-16's packets, and the HDL-32E's
PRODUCT_BYTE, HDL32E = 1205, 0x21
STAMP_BYTES = slice(1200, 1204)
HOUR_US = 3_600_000_000


def nothing(_run: LiveRun) -> None: ...


@dataclass(frozen=True)
class Fault:
    """What is done, and words of what the doctor says of it."""

    words: str
    do: Callable[[LiveRun], None] = nothing
    change: live.Change = live.as_recorded
    settings: tuple[str, ...] = ()
    #: that the doctor listens
    seconds: float = 3.0
    #: poses before it listens
    after_poses: int = HEALTHY_POSES


def without_odometry(run: LiveRun) -> None:
    kill(run.chain, "odometry")


def hanging_mapping(run: LiveRun) -> None:
    run.chain.processes.running["mapping"].send(signal.SIGSTOP)


def second_mapping(run: LiveRun) -> None:
    run.chain.start_replica("mapping", "another")


def mounted_elsewhere(run: LiveRun) -> None:
    kill(run.chain, "mapping")
    run.chain._commands["mapping"] += ["--set", "mounting.xyz_m=[9, 9, 9]"]
    run.chain.start("mapping", "mapping-again")
    run.wait(3.0)


def clock_ahead(run: LiveRun) -> None:
    kill(run.chain, "integration")
    run.chain.environments["integration"] = {"ZLOAM_FAULT_CLOCK_AHEAD_MS": "7000"}
    run.chain.start("integration", "integration-again")
    run.wait(4.0)


def silence(run: LiveRun) -> None:
    run.wait(3.0)


def junk(run: LiveRun) -> None:
    link = run.chain.link
    for _ in range(50):
        link.session.put(link.keys.features, b"\x01" * 200)


def every_tenth_missing() -> live.Change:
    counted = iter(range(1_000_000))
    return lambda _s, payload: None if next(counted) % 10 == 0 else payload


def other_product(_seconds: float, payload: bytes) -> bytes:
    return payload[:PRODUCT_BYTE] + bytes([HDL32E])


def clock_set(seconds: float, payload: bytes) -> bytes:
    """The sensor's clock is set forward by seven seconds on the way."""
    (stamp,) = struct.unpack("<I", payload[STAMP_BYTES])
    stamp = (stamp + (7_000_000 if seconds > 6.0 else 0)) % HOUR_US
    return payload[: STAMP_BYTES.start] + struct.pack("<I", stamp) + payload[STAMP_BYTES.stop :]


def silence_after(seconds: float) -> live.Change:
    return lambda s, payload: payload if s < seconds else None


FAULTS = {
    "a stage is missing": Fault("odometry is not there", without_odometry),
    # Its token goes with its link, after the lease.
    "a stage hangs": Fault("mapping is not there", hanging_mapping, seconds=7.0),
    "two instances": Fault("there is a second mapping", second_mapping),
    "another configuration": Fault("mounting.xyz_m differs between stages", mounted_elsewhere),
    "clocks of hosts apart": Fault("both need NTP or PTP", clock_ahead),
    "another version": Fault("features refused in a second as garbage", junk),
    "packets lost": Fault("packets were lost", change=every_tenth_missing()),
    "no packets": Fault("no packets came to the driver", silence, change=silence_after(4.0)),
    "another product": Fault("product byte says HDL-32E", change=other_product),
    "another model": Fault("packets say VLP-16", settings=("driver.model=HDL-32E",), after_poses=5),
    "clock of the sensor set": Fault("clock was set", change=clock_set, seconds=6.0),
    "no inertial sensor": Fault("driver is degraded: imu", settings=("driver.imu=zenoh",)),
}
QUICK = ("a stage is missing", "packets lost", "another version")


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    return simulate(build, folder, "--world", "city", "--seed", "5", "--duration", "16")


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in FAULTS],
)
def test_the_doctor_names_it(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, name: str
) -> None:
    fault = FAULTS[name]
    run = LiveRun(
        build,
        robot_file,
        drive,
        tmp_path,
        store=False,
        slower=1.0,
        seconds=SECONDS,
        change=fault.change,
        more=fault.settings,
    )
    with run:
        run.until_poses(fault.after_poses)
        fault.do(run)
        found = doctor.findings(doctor.listen(run.chain.link, fault.seconds))
        for process in run.chain.processes.running.values():
            process.send(signal.SIGCONT)
    assert any(fault.words in each.what for each in found), "\n".join(map(str, found))
