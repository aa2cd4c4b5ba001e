"""`zloam ros-lidar`: clouds as ROS 2 drivers publish them over rmw_zenoh become the robot's sweeps.
The reference is the simulator's truth; the library rosbags writes the clouds."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from tests.integration.conftest import PATIENCE_S, ROOT, Capture, WithoutDriver
from tests.recordings import variants
from tests.recordings.variants import CLOUD, Layout, Scan
from zloam_monitor import messages
from zloam_monitor.processes import endpoints, free_port
from zloam_monitor.recordings.sweeps import JUDGED
from zloam_monitor.records import HEALTH
from zloam_monitor.robot_file import names
from zloam_monitor.stages import PORT_ORDER
from zloam_monitor.trajectory import interpolate, read

STAGES = ("registration", "odometry", "mapping", "integration")
TYPES = get_typestore(Stores.ROS2_JAZZY)
DOMAIN = 78
TOPIC = "/sensors/points"
SECONDS = 6
#: The clouds are sent this many times slower than recorded, so that a busy machine drops nothing.
SLOWER = 2.0
RMSE_M = 0.05
LAYOUTS = {
    "t in ns": Layout(),
    "time in s, padded": Layout(time=("time", "f4"), unit_ns=1e9, padding=2, nan_returns=True),
    "timestamp since 1970": Layout(time=("timestamp", "f8"), unit_ns=1e9, origin="epoch"),
}


@pytest.fixture(scope="module")
def scans(build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> list[Scan]:
    return variants.decoded(build, capture.pcap, tmp_path_factory.mktemp("decoded"))[1:-1]


class Ros:
    """The ROS side: listens as a router does, publishes messages with rmw_zenoh's attachments."""

    def __init__(self, port: int) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session: Any = zenoh.open(config)
        kind = f"sensor_msgs::msg::dds_::PointCloud2_/{TYPES.hash_rihs01(CLOUD)}"
        self._publisher: Any = self.session.declare_publisher(f"{DOMAIN}{TOPIC}/{kind}")
        zid, name = self.session.info.zid(), TOPIC.replace("/", "%")
        self._token = self.session.liveliness().declare_token(
            f"@ros2_lv/{DOMAIN}/{zid}/0/9/MP/%/%/lidar/{name}/{kind}/2::,5:,:,:,,"
        )

    def readers(self) -> list[str]:
        pattern = f"@ros2_lv/{DOMAIN}/*/*/*/MS/**"
        return [str(r.ok.key_expr) for r in self.session.liveliness().get(pattern) if r.ok]

    def until_read(self) -> None:
        ends = time.monotonic() + PATIENCE_S
        while not self._publisher.matching_status.matching:
            assert time.monotonic() < ends, "nobody reads the topic"
            time.sleep(0.1)

    def send(self, scan: Scan, layout: Layout, number: int) -> None:
        message = variants.message(TYPES.types, scan, layout)
        payload = bytes(TYPES.serialize_cdr(message, CLOUD))
        beside = number.to_bytes(8, "little") + bytes(8) + b"\x10" + bytes(16)
        self._publisher.put(payload, attachment=beside)


@contextmanager
def ros_lidar(port: int, robot_endpoint: str, log: Path, *more: str) -> Iterator[Any]:
    words = [
        *(sys.executable, "-m", "zloam_monitor", "ros-lidar", TOPIC),
        *("--ros", f"tcp/127.0.0.1:{port}", "--domain", str(DOMAIN)),
        *("--connect", robot_endpoint, *more),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "services/monitor/src")}
    with (
        log.open("w") as said,
        subprocess.Popen(
            words, stdout=said, stderr=subprocess.STDOUT, env=environment, cwd=ROOT
        ) as process,
    ):
        try:
            yield process
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_topic_is_the_robots_lidar(
    build: Path,
    robot_file: Path,
    capture: Capture,
    scans: list[Scan],
    tmp_path: Path,
    name: str,
) -> None:
    robot, layout = names(robot_file, []), LAYOUTS[name]
    settings = ["driver.source=udp", f"integration.output_dir={tmp_path}"]
    chain = WithoutDriver(build, robot_file, robot.robot, settings, tmp_path, robot.sensor)
    endpoint = endpoints(chain.base_port)[PORT_ORDER.index("registration")]
    said = tmp_path / "ros-lidar.txt"
    ros = Ros(port := free_port())
    with chain, ros_lidar(port, endpoint, said):
        ros.until_read()
        while any(chain.link.stage(stage) is None for stage in STAGES):
            chain.link.poll(0.1)
            chain.check()
        begun = time.monotonic()
        for number, scan in enumerate(scans):
            ros.send(scan, layout, number)
            due = begun + SLOWER * (scan.stamp_ns - scans[0].stamp_ns) * 1e-9
            while (left := due - time.monotonic()) > 0:
                chain.link.poll(left)
        (reader,) = ros.readers()
        ends = time.monotonic() + 3.0
        while time.monotonic() < ends:
            chain.link.poll(0.2)
        codes = chain.stop()
        statuses = chain.statuses()
        inputs = [i for s in STAGES if s != "mapping" for i in statuses[s].inputs]
    ros.session.close()
    assert set(codes.values()) == {0}
    assert "%sensors%points" in reader
    found = read(tmp_path / "trajectory.tum")
    assert found.stamps_ns is not None
    (told,) = re.findall(r"^(\d+) sweeps.*no registration", said.read_text(), re.M)
    # The first clouds serve to determine unit and origin of the times, and the rings.
    assert len(scans) / 2 < len(found) <= len(scans) - JUDGED
    given_up = sum(i.lost + sum(i.dropped.values()) for i in inputs)
    assert 0 <= int(told) - len(found) <= given_up, said.read_text()
    # A machine that is too slow for the sensor drops sweeps; poses that bridge such a gap are
    # flagged and do not count.
    sure = [p for p in chain.link.poses.values() if HEALTH[p.health] not in ("bridging", "lost")]
    stamps_ns = np.array([p.instant_ns for p in sure])
    truth, inside = interpolate(read(capture.truth_base), stamps_ns)
    first = np.linalg.inv(truth.transforms[0]) @ truth.transforms
    seen = np.array([p.translation for p in sure])[inside]
    # The run's map begins at its first sweep.
    turned = first[:, :3, 3] - first[0, :3, 3]
    error = np.linalg.norm(turned - (seen - seen[0]), axis=1)
    assert np.sqrt(np.mean(error**2)) < RMSE_M


def test_a_sweep_that_was_missed_can_be_asked_for(scans: list[Scan], tmp_path: Path) -> None:
    """A late reader queries the sweep, as a stage does."""
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    robot_port = free_port()
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{robot_port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    heard: list[bytes] = []
    ros = Ros(port := free_port())
    said = tmp_path / "said.txt"
    with (
        zenoh.open(config) as robot,
        robot.declare_subscriber("loam/robot/lidar/lidar/sweep") as sweeps,
        ros_lidar(port, f"tcp/127.0.0.1:{robot_port}", said),
    ):
        ros.until_read()
        for number, scan in enumerate(scans[:30]):
            ros.send(scan, LAYOUTS["t in ns"], number)
            time.sleep(0.1)
            heard += [s.payload.to_bytes() for s in iter(sweeps.try_recv, None)]
        assert len(heard) > 5
        header = messages.decode("Sweep", heard[2]).Header()
        run, number = header.Run(), header.Sweep()
        selector = "loam/robot/lidar/lidar/sweep?"

        def asked(question: str) -> list[bytes]:
            replies = robot.get(selector + question, consolidation=zenoh.ConsolidationMode.NONE)
            return [reply.ok.payload.to_bytes() for reply in replies]

        assert asked(f"run={run};sweep={number}..{number}") == [heard[2]]
        assert asked(f"run={run};sweep={number}..{number + 2}") == heard[2:5]
        for other in (f"run={run + 1};sweep={number}..{number}", f"run={run};sweep=900..901", ""):
            assert asked(other) == []
    ros.session.close()


def test_what_can_not_be_told_is_refused(scans: list[Scan], tmp_path: Path) -> None:
    """Two fields of the cloud could be the time."""
    layout, said = Layout(more=(("timestamp", "f8"),)), tmp_path / "said.txt"
    ros = Ros(port := free_port())
    with ros_lidar(port, "tcp/127.0.0.1:1", said) as process:
        ros.until_read()
        for number, scan in enumerate(scans[:12]):
            ros.send(scan, layout, number)
            time.sleep(0.1)
        assert process.wait(PATIENCE_S) != 0
    ros.session.close()
    assert "driver.time_field" in said.read_text()
    assert "Traceback" not in said.read_text()


def test_a_topic_that_is_silent_is_said_with_those_that_there_are(tmp_path: Path) -> None:
    said = tmp_path / "said.txt"
    ros = Ros(port := free_port())
    ends = time.monotonic() + PATIENCE_S
    with ros_lidar(port, "tcp/127.0.0.1:1", said):
        while "no cloud on" not in said.read_text() and time.monotonic() < ends:
            time.sleep(0.2)
    ros.session.close()
    assert f"clouds on {TOPIC}" in said.read_text()
