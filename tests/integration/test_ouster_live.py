"""An Ouster sensor through the driver: a capture with the sensor's own IMU, and live over UDP with
metadata fetched from the sensor's HTTP API."""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fake_sensor import sensor
from tests import ouster_peer
from tests.acceptance.live import free_udp_port
from tests.integration.conftest import PATIENCE_S, ROOT
from zloam_monitor import cli, messages, sensor_metadata, sources
from zloam_monitor.chain import Chain
from zloam_monitor.keys import Keys
from zloam_monitor.link import open_session
from zloam_monitor.processes import Processes, free_port

CAPTURE = "data/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap"
ROBOT = ROOT / "deploy" / "robots" / "ouster.yaml"
KEYS = Keys("robot")
#: frames of the capture, number of repetitions, and the period of a frame (10 Hz)
FRAMES, TIMES, FRAME_NS = 3, 7, 100_000_000


@pytest.fixture
def capture(shared: Path) -> Path:
    return shared / CAPTURE


class Driver:
    """The driver alone, and the messages that it publishes."""

    def __init__(self, build: Path, logs: Path, *settings: str) -> None:
        own = f"tcp/127.0.0.1:{free_port()}"
        self.session = open_session([], own)
        self.sweeps: list[Any] = []
        self.subscriber = self.session.declare_subscriber(
            KEYS.sweep,
            lambda sample: self.sweeps.append(messages.decode("Sweep", sample.payload.to_bytes())),
        )
        links = (f"zenoh.connect=[{own}]", f"zenoh.listen=[tcp/127.0.0.1:{free_port()}]")
        command = [str(build / "bin" / "zloam-driver"), "--config", str(ROBOT)]
        command += [word for setting in (*settings, *links) for word in ("--set", setting)]
        self.processes = Processes()
        self.process = self.processes.start("driver", command, logs / "driver.log")

    def until(self, count: int) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while len(self.sweeps) < count:
            assert self.process.code() is None, self.process.last_lines()
            assert time.monotonic() < deadline, f"{len(self.sweeps)} sweeps came"
            time.sleep(0.05)

    def until_listening(self, port: int) -> None:
        """Waits until the driver has opened this UDP port: a sensor's packets before are lost."""
        deadline = time.monotonic() + PATIENCE_S
        while f":{port:04X} " not in Path("/proc/net/udp").read_text():
            assert self.process.code() is None, self.process.last_lines()
            assert time.monotonic() < deadline
            time.sleep(0.05)

    def close(self) -> dict[str, int]:
        codes = self.processes.stop()
        self.session.close()
        return codes


def readings_of(sweep: Any) -> np.ndarray:
    return messages.struct_vector(sweep, "Imu", messages.IMU_SAMPLE)


def test_live_with_a_description_from_the_sensor(
    build: Path, capture: Path, tmp_path: Path
) -> None:
    recording = ouster_peer.recorded(capture)
    described = tmp_path / "os.json"
    page = json.loads(ouster_peer.metadata_of(capture).read_text())
    nested = {"beam_intrinsics": page, "lidar_data_format": page["data_format"], **page}
    with sensor({sensor_metadata.PATH: nested}) as host:
        assert cli.main(["metadata", host, str(described)]) == 0
    ports = [free_udp_port(), free_udp_port()]
    driver = Driver(
        build,
        tmp_path,
        f"driver.port={ports[0]}",
        f"driver.position_port={ports[1]}",
        f"driver.metadata={described}",
    )
    driver.until_listening(ports[0])
    stop = threading.Event()
    sender = threading.Thread(target=send, args=(recording, ports, stop))
    sender.start()
    try:
        driver.until(15)
    finally:
        stop.set()
        sender.join()
        codes = driver.close()
    assert codes == {"driver": 0}
    whole = [sweep for sweep in driver.sweeps if sweep.Complete()]
    assert len(whole) >= 10
    for sweep in whole:
        assert (sweep.Rings(), sweep.Model()) == (128, b"OS-1-128")
        assert sweep.PeriodNs() == pytest.approx(FRAME_NS, rel=1e-3)
        assert sweep.PointsLength() > 100_000
        stamps = readings_of(sweep)["stamp_ns"]
        # Ten readings per revolution, and some more before and after it.
        assert len(stamps) >= 10
        assert (np.diff(stamps) > 0).all()


def send(recording: ouster_peer.Recorded, ports: list[int], stop: threading.Event) -> None:
    """Sends data packets and IMU packets at the sensor's pace."""
    stream = ouster_peer.repeated(recording, TIMES)
    packet_ns = FRAMES * FRAME_NS // len(recording.packets)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        begin = time.monotonic_ns()
        for number, payload in enumerate(stream):
            ahead_s = (begin + number * packet_ns - time.monotonic_ns()) * 1e-9
            if stop.is_set() or stop.wait(max(0.0, ahead_s)):
                return
            out.sendto(payload.tobytes(), ("127.0.0.1", ports[0]))
            if number % 6 == 0:  # about 100 Hz
                out.sendto(reading(recording, stream[number]), ("127.0.0.1", ports[1]))


def reading(recording: ouster_peer.Recorded, packet: np.ndarray) -> bytes:
    """An IMU packet with the time of the data packet."""
    made = bytearray(bytes(recording.imu[0].buf))
    column = recording.layout.packet_header_size
    for at in (8, 16):
        made[at : at + 8] = packet[column : column + 8].tobytes()
    return bytes(made)


def test_a_capture_with_its_imu(build: Path, capture: Path, tmp_path: Path) -> None:
    given = ["--pcap", str(capture), "--config", str(ROBOT), "--out", str(tmp_path)]
    seam = ["--set", "driver.seam_azimuth_deg=180"]
    assert cli.main(["demo", *given, *seam, "--preset-dir", str(build)]) == 0
    assert len((tmp_path / "trajectory.tum").read_text().splitlines()) == FRAMES
    log = (tmp_path / "logs" / "driver.log").read_text()
    assert "warning" not in log


def test_a_replay_carries_the_readings_of_its_sweeps(
    build: Path, capture: Path, tmp_path: Path
) -> None:
    settings = [
        *sources.from_pcap(capture).driver_settings("max"),
        "driver.seam_azimuth_deg=180",
        f"integration.output_dir={tmp_path}",
    ]
    chain = Chain(build, ROBOT, "robot", settings, tmp_path)
    sweeps: list[Any] = []
    subscriber = chain.link.session.declare_subscriber(
        KEYS.sweep,
        lambda sample: sweeps.append(messages.decode("Sweep", sample.payload.to_bytes())),
    )
    with chain:
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
        subscriber.undeclare()
    # Late sweeps are queried and may arrive twice.
    once = {sweep.Header().Sweep(): sweep for sweep in sweeps}
    assert sorted(once) == list(range(FRAMES))
    for sweep in once.values():
        begin, end = sweep.Header().StampNs(), sweep.Header().StampNs() + sweep.PeriodNs()
        stamps = readings_of(sweep)["stamp_ns"]
        inside = (stamps >= begin) & (stamps <= end)
        assert 8 <= inside.sum() <= 11
