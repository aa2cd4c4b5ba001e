"""Faults that are injected into a running robot, and words that the doctor must say about each."""

from __future__ import annotations

import shutil
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.acceptance import live
from tests.acceptance.decoded import udp_payloads
from tests.integration.conftest import Capture, kill, simulate
from tests.integration.hosts import router
from tests.integration.live_run import LiveRun
from zloam_monitor import compose, messages
from zloam_monitor.processes import free_port
from zloam_monitor.records import StatusRecord

#: poses of the drive before the fault
HEALTHY_POSES = 25
#: VLP-16: byte of a data packet that names the product, and the HDL-32E's value; stamp of a data
#: packet; size of a position packet, its byte on the pulse per second, and the value for none
PRODUCT_BYTE, HDL32E = 1205, 0x21
STAMP_BYTES = slice(1200, 1204)
POSITION_BYTES, PPS_BYTE, PPS_ABSENT = 512, 202, 0
HOUR_US = 3_600_000_000
#: The stage runs for 4 ms and is stopped for 120 ms in turn, while sweeps come every 100 ms.
WORKS_S, STOPPED_S = 0.004, 0.12
LATE_S = 0.06
STRETCH = 1.25
DEG = 180.0 / np.pi


@dataclass
class Stand:
    """The robot on which a fault is injected, with what the faults need besides."""

    run: LiveRun
    drive: Capture
    #: free UDP port to which a fault may direct the sensor's packets
    other_port: int
    router_port: int
    _threads: list[threading.Thread] = field(default_factory=list)
    _over: threading.Event = field(default_factory=threading.Event)

    def beside(self, work: Callable[[threading.Event], None]) -> None:
        """Runs `work` in a thread until the robot ends."""
        thread = threading.Thread(target=work, args=(self._over,))
        self._threads.append(thread)
        thread.start()

    def close(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()
        for process in self.run.chain.processes.running.values():
            process.send(signal.SIGCONT)


def nothing(_stand: Stand) -> None: ...


@dataclass(frozen=True)
class Fault:
    """What is done to the robot, and words that the doctor must say about it."""

    words: str
    do: Callable[[Stand], None] = nothing
    change: Callable[[Capture], live.Change] = lambda _drive: live.as_recorded
    #: additional settings; `{other}` and `{router}` stand for the ports of the Stand
    settings: tuple[str, ...] = ()
    #: how long the doctor listens
    seconds: float = 3.0
    #: poses before the doctor listens; 0 if none will come
    after_poses: int = HEALTHY_POSES
    #: factor by which the capture is sent slower than it was recorded
    slower: float = 1.0
    #: options of the simulator instead of the city
    drive: tuple[str, ...] = ("--world", "city")
    #: program that the fault needs
    tool: str = ""


def without_odometry(stand: Stand) -> None:
    kill(stand.run.chain, "odometry")


def hanging_mapping(stand: Stand) -> None:
    stand.run.chain.processes.running["mapping"].send(signal.SIGSTOP)


def until_heard(stand: Stand, stage: str, instance: str) -> None:
    stand.run._until(lambda: (stage, instance) in stand.run.chain.link.statuses)


def second_mapping(stand: Stand) -> None:
    stand.run.chain.start_replica("mapping", "another")
    until_heard(stand, "mapping", "another")


def strangers_token(stand: Stand) -> None:
    """A token that says that another instance took over from the real one."""
    link = stand.run.chain.link
    claim = link.keys.below("service/mapping/ghost/active/9/0")

    def hold(over: threading.Event) -> None:
        with link.session.liveliness().declare_token(claim):
            over.wait()

    stand.beside(hold)
    stand.run._until(lambda: is_silent(link.stage("mapping")))


def is_silent(status: StatusRecord | None) -> bool:
    return status is not None and status.is_silent


def second_driver(stand: Stand) -> None:
    """Starts the driver of a second robot under the same name, which receives another sensor's
    packets."""
    chain = stand.run.chain
    command = chain._command_as("driver", "another")
    command += ["--set", f"driver.port={stand.other_port}"]
    chain.processes.start("another", command, stand.run.out / "another.log")
    until_heard(stand, "driver", "another")


def again(stand: Stand, stage: str, wait_s: float = 3.0) -> None:
    """Kills the stage if it runs, starts it again with its present command line, and lets it work
    for a while."""
    chain = stand.run.chain
    before = set(chain.link.statuses)
    if stage in chain.processes.running:
        kill(chain, stage)
    chain.start(stage, f"{stage}-again")
    stand.run._until(lambda: any(s == stage for s, _ in chain.link.statuses.keys() - before))
    stand.run.wait(wait_s)


def mapping_again(stand: Stand) -> None:
    again(stand, "mapping")


def mounted_elsewhere(stand: Stand) -> None:
    stand.run.chain._commands["mapping"] += ["--set", "mounting.xyz_m=[9, 9, 9]"]
    again(stand, "mapping")


def clock_ahead(stand: Stand) -> None:
    stand.run.chain.environments["integration"] = {"ZLOAM_FAULT_CLOCK_AHEAD_MS": "7000"}
    again(stand, "integration", 4.0)


def full_disk(stand: Stand) -> None:
    """Lets integration write its files into a file system of one page (4 KiB)."""
    out = stand.run.out / "full"
    out.mkdir()
    mounted = f'mount -t tmpfs -o size=4k tmpfs {out} && exec "$@"'
    command = stand.run.chain._commands["integration"]
    command += ["--set", f"integration.output_dir={out}"]
    stand.run.chain._commands["integration"] = [
        "unshare",
        "-m",
        "sh",
        "-c",
        mounted,
        "sh",
        *command,
    ]
    again(stand, "integration", 4.0)


def little_locked_memory(stand: Stand) -> None:
    """Restarts odometry without the right to lock a pool, so that its inputs come through
    sockets."""
    chain = stand.run.chain
    limited = ["setpriv", "--bounding-set=-ipc_lock", "--inh-caps=-ipc_lock", "prlimit"]
    limited += ["--memlock=1048576:1048576"]
    chain._commands["odometry"] = [*limited, *chain._commands["odometry"]]
    again(stand, "odometry", 4.0)


def slow_mapping(stand: Stand) -> None:
    process = stand.run.chain.processes.running["mapping"]

    def hold(over: threading.Event) -> None:
        while not over.is_set():
            process.send(signal.SIGSTOP)
            over.wait(STOPPED_S)
            process.send(signal.SIGCONT)
            over.wait(WORKS_S)

    stand.beside(hold)
    stand.run.wait(5.0)


def router_gone(stand: Stand) -> None:
    """Starts a router, waits until the stages are linked to it, and ends it."""
    processes = stand.run.chain.processes
    endpoint = f"tcp/127.0.0.1:{stand.router_port}"
    processes.start("router", router(endpoint), stand.run.out / "router.log")
    said = "nothing answers at"
    stand.run._until(lambda: not any(said in r for r in stand.run.reasons()))
    stand.run.wait(3.0)
    assert not any(said in reason for reason in stand.run.reasons())
    kill(stand.run.chain, "router")
    stand.run.wait(7.0)


def silence(stand: Stand) -> None:
    stand.run.wait(3.0)


def some_seconds(stand: Stand) -> None:
    stand.run.wait(6.0)


def junk(stand: Stand) -> None:
    link = stand.run.chain.link
    for _ in range(50):
        link.session.put(link.keys.features, b"\x01" * 200)


def every_tenth_missing(_drive: Capture) -> live.Change:
    counted = iter(range(1_000_000))
    return lambda _s, payload: None if next(counted) % 10 == 0 else payload


def other_product(_drive: Capture) -> live.Change:
    return lambda _s, payload: payload[:PRODUCT_BYTE] + bytes([HDL32E])


def stretched(drive: Capture) -> live.Change:
    """A sensor that rotates too slowly: the stamps of its packets are stretched accordingly."""
    payloads = (payload for _, payload in udp_payloads(drive.pcap))
    (first,) = struct.unpack("<I", next(payloads)[STAMP_BYTES])

    def change(_seconds: float, payload: bytes) -> bytes:
        (stamp,) = struct.unpack("<I", payload[STAMP_BYTES])
        slow = int(first + STRETCH * (stamp - first)) % HOUR_US
        return payload[: STAMP_BYTES.start] + struct.pack("<I", slow) + payload[STAMP_BYTES.stop :]

    return change


def clock_set(_drive: Capture) -> live.Change:
    """The sensor's clock is set forward by seven seconds during the drive."""

    def change(seconds: float, payload: bytes) -> bytes:
        (stamp,) = struct.unpack("<I", payload[STAMP_BYTES])
        stamp = (stamp + (7_000_000 if seconds > 6.0 else 0)) % HOUR_US
        return payload[: STAMP_BYTES.start] + struct.pack("<I", stamp) + payload[STAMP_BYTES.stop :]

    return change


def silence_after(seconds: float) -> Callable[[Capture], live.Change]:
    return lambda _drive: lambda s, payload: payload if s < seconds else None


def without_pps(stand: Stand) -> None:
    """Sends position packets of a sensor without a pulse per second."""
    payloads = (payload for _, payload in udp_payloads(stand.drive.pcap))
    position = bytearray(next(p for p in payloads if len(p) == POSITION_BYTES))
    position[PPS_BYTE] = PPS_ABSENT

    def send(over: threading.Event) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not over.wait(0.2):
                sender.sendto(position, ("127.0.0.1", stand.other_port))

    stand.beside(send)
    stand.run.wait(3.0)


Readings = NDArray[np.float64]


def inertia(do: Callable[[Readings], Readings], late_s: float = 0.0) -> Callable[[Stand], None]:
    """Publishes the simulated IMU readings (7 columns, as in ImuSample) at the pace of the drive,
    changed by `do` and with stamps late by `late_s`."""

    def begin(stand: Stand) -> None:
        rows = np.loadtxt(stand.drive.pcap.with_name("imu.csv"), delimiter=",", skiprows=1)
        first_s = next(udp_payloads(stand.drive.pcap))[0]
        times_s = rows[:, 0] * 1e-9 - first_s
        changed = do(rows[:, 1:7])
        stand.beside(lambda over: publish(stand, over, times_s, changed, late_s))

    return begin


def publish(
    stand: Stand, over: threading.Event, times_s: Readings, values: Readings, late_s: float
) -> None:
    """Publishes IMU readings; columns of `values`: angular rates, then specific forces. The stamps
    are late by `late_s`."""
    link, encoding = stand.run.chain.link, messages.encoding("ImuBatch")
    begun_s = stand.run.began_s()
    seq = 0
    for at_s, row in zip(times_s, values, strict=True):
        wait = begun_s + at_s - time.time()
        # Readings from before the first one that can still be sent in time are skipped.
        if seq == 0 and wait < 0.0:
            continue
        if over.wait(max(0.0, wait)):
            return
        sample = np.zeros(1, messages.IMU_SAMPLE)
        sample["stamp_ns"] = int(1e9 * (begun_s + at_s + late_s))
        for name, columns in (("angular_velocity", row[:3]), ("linear_acceleration", row[3:])):
            for axis, value in zip("xyz", columns, strict=True):
                sample[name][axis] = value
        header = compose.HeaderValues(run=0, sweep=0, seq=seq, frame="imu")
        batch = compose.imu(header, sample)
        link.session.put(link.keys.below("imu/lidar"), batch, encoding=encoding)
        seq += 1


def turned(rows: Readings) -> Readings:
    """Rotated by 90 degrees about z: the mounting differs from the configured one."""
    found = rows.copy()
    found[:, [0, 1, 3, 4]] = np.column_stack([-rows[:, 1], rows[:, 0], -rows[:, 4], rows[:, 3]])
    return found


def scaled(rates: float, forces: float) -> Callable[[Readings], Readings]:
    return lambda rows: rows * np.array([rates] * 3 + [forces] * 3)


HAND = ("--world", "handheld")
IMU = Fault("", settings=("driver.imu=zenoh",), drive=HAND, after_poses=1, seconds=3.0)


def imu(words: str, do: Callable[[Stand], None], wait_s: float = 10.0) -> Fault:
    def make(stand: Stand) -> None:
        do(stand)
        stand.run.wait(wait_s)

    return replace(IMU, words=words, do=make)


FAULTS = {
    "a stage is missing": Fault("odometry is not there", without_odometry),
    # A stopped stage's liveliness token disappears with its link, when the lease ends.
    "a stage hangs": Fault("mapping is not there", hanging_mapping, seconds=7.0),
    "a stage was started again": Fault("mapping was started again", mapping_again, after_poses=115),
    "which is slow": Fault("mapping takes", slow_mapping),
    "a queue drops": Fault("mapping dropped", slow_mapping),
    "two instances": Fault("there is a second mapping", second_mapping),
    "a stranger's token": Fault("a token of mapping (ghost, term 9)", strangers_token),
    "two robots of one name": Fault("there is a second driver", second_driver),
    "another configuration": Fault("mounting.xyz_m differs between stages", mounted_elsewhere),
    "clocks of hosts apart": Fault("both need NTP or PTP", clock_ahead),
    "another version": Fault("features refused in a second as garbage", junk),
    "disk full": Fault("No space left on device", full_disk, tool="unshare"),
    "no shared memory": Fault(
        "not receive through shared memory", little_locked_memory, tool="setpriv"
    ),
    "router gone": Fault(
        "nothing answers at tcp/127.0.0.1",
        router_gone,
        settings=("zenoh.connect=[tcp/127.0.0.1:{router}]",),
    ),
    "packets lost": Fault("packets were lost", change=every_tenth_missing),
    "no packets": Fault("no packets came to the driver", silence, change=silence_after(4.0)),
    "another port": Fault(
        "datagrams came to UDP ports on which no program listens",
        silence,
        settings=("driver.port={other}",),
        after_poses=0,
    ),
    "another product": Fault("product byte says HDL-32E", change=other_product),
    "another model": Fault("packets say VLP-16", settings=("driver.model=HDL-32E",), after_poses=5),
    "clock of the sensor set": Fault("clock was set", change=clock_set, seconds=6.0),
    "no time lock": Fault(
        "pulse per second is not locked",
        without_pps,
        settings=("driver.clock=utc", "driver.position_port={other}"),
    ),
    "turns too slowly": Fault(
        "the sensor turns 4.0 times a second",
        change=stretched,
        slower=STRETCH,
        drive=("--world", "city", "--rpm", "300"),
        seconds=4.0,
        after_poses=10,
    ),
    "nothing fixes the pose": Fault(
        "poses have a direction that nothing fixes", some_seconds, drive=("--world", "tunnel")
    ),
    "no inertial sensor": Fault("driver is degraded: imu", settings=("driver.imu=zenoh",)),
    "its force is in g": imu("as of a sensor that reads in g", inertia(scaled(1.0, 1 / 9.80665))),
    "its rates are in degrees": imu("IMU inconsistent", inertia(scaled(DEG, 1.0))),
    "its signs are turned": imu("is gravity's sign turned", inertia(scaled(-1.0, -1.0))),
    "its axes are turned": imu("IMU inconsistent", inertia(turned)),
    "its stamps are late": imu("stamps are", inertia(scaled(1.0, 1.0), LATE_S)),
}
QUICK = ("a stage is missing", "packets lost", "another version", "healthy, with an IMU")
#: robots about which the doctor must report nothing
HEALTHY = {
    "healthy": Fault("", some_seconds),
    "healthy, with an IMU": imu("", inertia(scaled(1.0, 1.0))),
}


def needs(fault: Fault) -> None:
    """Skips the test where this machine lacks the means to inject the fault."""
    if not fault.tool:
        return
    if shutil.which(fault.tool) is None:
        pytest.skip(f"needs {fault.tool}")
    if (
        fault.tool == "unshare"
        and subprocess.run(["unshare", "-m", "true"], check=False).returncode
    ):
        pytest.skip("needs the right to mount in a name space of its own")


def drive_for(build: Path, folder: Path, fault: Fault) -> Capture:
    """A drive with IMU readings, longer than any fault and the doctor need on a busy machine."""
    readings = ("--imu", str(folder / "imu.csv"))
    return simulate(build, folder, *fault.drive, "--seed", "5", "--duration", "24", *readings)


def made(build: Path, robot_file: Path, drive: Capture, out: Path, fault: Fault) -> Stand:
    """The robot for the fault, not started yet; faults in settings or packets are already in it."""
    other, router = live.free_udp_port(), free_port()
    run = LiveRun(
        build,
        robot_file,
        drive,
        out,
        store=False,
        slower=fault.slower,
        change=fault.change(drive),
        more=tuple(s.format(other=other, router=router) for s in fault.settings),
    )
    return Stand(run, drive, other, router)
