"""zloam-ros beside a replay, read as ROS 2 nodes read: topics listed by PyPI's zenoh-ros2-sdk, CDR
decoded by rosbags, messages kept for late readers through Zenoh's own advanced subscriber."""

from __future__ import annotations

import json
import math
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tests.integration.conftest import PATIENCE_S, Capture, WithoutDriver, kill, simulate
from tests.integration.live_run import SECONDS, SPARE_S, LiveRun
from zloam_monitor import messages, sources
from zloam_monitor.chain import Chain, binary
from zloam_monitor.processes import free_port
from zloam_monitor.robot_file import names
from zloam_monitor.trajectory import Trajectory, read

discovery = pytest.importorskip("zenoh_ros2_sdk.discovery")
attachments = pytest.importorskip("zenoh_ros2_sdk.attachment")
qualities = pytest.importorskip("zenoh_ros2_sdk.qos")

#: a ROS domain that no other node of this machine uses
DOMAIN = 77
#: /map is published at most this often
MAP_PERIOD_S = 5.0
TOPICS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/path": "nav_msgs/msg/Path",
    "/points": "sensor_msgs/msg/PointCloud2",
    "/map": "sensor_msgs/msg/PointCloud2",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
LATCHED = ("/map", "/path", "/tf_static")
TYPES = get_typestore(Stores.ROS2_JAZZY)
IMU = "sensor_msgs/msg/Imu"
PLACE = "geometry_msgs/msg/PoseWithCovarianceStamped"


@dataclass
class Heard:
    """All messages of each topic, and what the ROS graph listed."""

    out: Path
    samples: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    late: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    listed: dict[str, list[str]] = field(default_factory=dict)
    info: dict[str, Any] = field(default_factory=dict)
    imu: list[Any] = field(default_factory=list)
    #: payloads of the `place` commands to mapping, and the node's reason before the last one
    places: list[dict[str, float]] = field(default_factory=list)
    reason: str = ""
    #: number of points in mapping's own tiles at the end
    map_points: int = 0

    def decoded(self, topic: str) -> list[Any]:
        kind = TOPICS[topic]
        return [TYPES.deserialize_cdr(s.payload.to_bytes(), kind) for s in self.samples[topic]]


def key_of(topic: str, kind: str) -> str:
    package, _, name = kind.split("/")
    return f"{DOMAIN}{topic}/{package}::msg::dds_::{name}_/{TYPES.hash_rihs01(kind)}"


def session(port: int) -> Any:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def command(build: Path, robot_file: Path, chain: Chain, port: int, *more: str) -> list[str]:
    settings = [
        f"zenoh.base_port={chain.base_port}",
        f"ros.listen=[tcp/127.0.0.1:{port}]",
        "ros.connect=[]",
        f"ros.domain={DOMAIN}",
        *more,
    ]
    words = [str(binary(build, "ros")), "--config", str(robot_file)]
    return [*words, *(word for setting in settings for word in ("--set", setting))]


def imu_message(stamp_ns: int, little: bool) -> bytes:
    make = TYPES.types
    vector = make["geometry_msgs/msg/Vector3"]
    nothing = np.zeros(9)
    stamp = make["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    message = make[IMU](
        header=make["std_msgs/msg/Header"](stamp=stamp, frame_id="imu"),
        orientation=make["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=nothing,
        angular_velocity=vector(x=0.125, y=-0.25, z=0.5),
        angular_velocity_covariance=nothing,
        linear_acceleration=vector(x=1.5, y=-2.5, z=9.75),
        linear_acceleration_covariance=nothing,
    )
    return bytes(TYPES.serialize_cdr(message, IMU, little_endian=little))


def place_message(frame: str, x_m: float, y_m: float, yaw_rad: float) -> bytes:
    """A message as sent by RViz's "2D Pose Estimate"."""
    make = TYPES.types
    pose = make["geometry_msgs/msg/Pose"](
        position=make["geometry_msgs/msg/Point"](x=x_m, y=y_m, z=0.0),
        orientation=make["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(0.5 * yaw_rad), w=math.cos(0.5 * yaw_rad)
        ),
    )
    stamp = make["builtin_interfaces/msg/Time"](sec=1_700_000_000, nanosec=0)
    message = make[PLACE](
        header=make["std_msgs/msg/Header"](stamp=stamp, frame_id=frame),
        pose=make["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
    )
    return bytes(TYPES.serialize_cdr(message, PLACE))


def say_places(chain: Chain, reader: zenoh.Session, heard: Heard) -> None:
    """Publishes a pose in a frame that is not the map's, then one that is; answers the command
    `place` instead of mapping."""
    key = chain.link.keys.command("mapping", "place")

    def answer(query: zenoh.Query) -> None:
        heard.places.append(json.loads(query.payload.to_bytes()))

    with chain.link.session.declare_queryable(key, answer):
        reader.put(key_of("/initialpose", PLACE), place_message("base_link", 1.0, 1.0, 0.0))
        ends = time.monotonic() + PATIENCE_S
        while "'base_link'" not in heard.reason and time.monotonic() < ends:
            chain.link.poll(0.2)
            status = chain.link.stage("ros")
            heard.reason = status.reason if status else ""
        reader.put(key_of("/initialpose", PLACE), place_message("map", 12.0, -3.5, 0.5 * math.pi))
        while not heard.places and time.monotonic() < ends:
            chain.link.poll(0.2)


def graph(heard: Heard, port: int) -> None:
    """Lists topics as a ROS node does, until the publisher's tokens are there."""
    where = {"domain_id": DOMAIN, "router_ip": "127.0.0.1", "router_port": port}
    ends = time.monotonic() + PATIENCE_S
    while set(TOPICS) - set(heard.listed) and time.monotonic() < ends:
        heard.listed = dict(discovery.get_topic_names_and_types(**where))
    for topic in TOPICS:
        heard.info[topic] = discovery.get_topic_info(topic, verbose=True, **where)


def imu_samples(heard: Heard) -> list[Any]:
    """All IMU readings that the bridge published on the robot's side."""
    samples = []
    for sample in heard.imu:
        batch = messages.decode("ImuBatch", sample.payload.to_bytes())
        samples += messages.struct_vector(batch, "Samples", messages.IMU_SAMPLE).tolist()
    return samples


def is_complete(heard: Heard) -> bool:
    """Whether the run has ended, and the messages sent at most once a second show its end."""
    if not (heard.out / "trajectory.tum").is_file() or not all(heard.late.values()):
        return False
    poses = len(read(heard.out / "trajectory.tum"))
    paths, maps = heard.decoded("/path"), heard.decoded("/map")
    return (
        len(imu_samples(heard)) == 2
        and bool(paths)
        and len(paths[-1].poses) == poses
        and bool(maps)
        and maps[-1].width == heard.map_points
    )


@pytest.fixture(scope="module")
def heard(
    build: Path, robot_file: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Heard]:
    out = tmp_path_factory.mktemp("ros")
    found, port = Heard(out), free_port()
    robot = names(robot_file, [])
    settings = [
        *sources.from_pcap(capture.pcap).driver_settings("realtime"),
        f"integration.output_dir={out}",
        "flow.wait_for=[registration, odometry, mapping, integration, ros]",
    ]
    chain = WithoutDriver(build, robot_file, robot.robot, settings, out / "logs", robot.sensor)
    with chain:
        ros = command(build, robot_file, chain, port, "ros.imu_topic=/imu")
        # The router comes first: Zenoh's clients do not wait for one.
        chain.processes.start("ros", ros, out / "logs/ros.log")
        while chain.link.stage("ros") is None:
            chain.link.poll(0.1)
        with session(port) as reader:
            plain = {
                topic: reader.declare_subscriber(key_of(topic, kind), found.samples[topic].append)
                for topic, kind in TOPICS.items()
            }
            readings = chain.link.session.declare_subscriber(
                chain.link.keys.below(f"imu/{robot.sensor}"), found.imu.append
            )
            graph(found, port)
            # The reader is connected before the driver starts: the replay waits for zloam-ros, but
            # not for its readers.
            Chain.start(chain, "driver")
            while not chain.finished():
                chain.link.poll(0.2)
                chain.check()
            tiles = chain.link.query_tiles()
            found.map_points = sum(len(t.points) for t in tiles)
            late = {
                topic: zenoh.ext.declare_advanced_subscriber(
                    reader,
                    key_of(topic, TOPICS[topic]),
                    found.late[topic].append,
                    history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
                )
                for topic in LATCHED
            }
            for little in (True, False):
                reader.put(key_of("/imu", IMU), imu_message(1_700_000_000_250_000_000, little))
            say_places(chain, reader, found)
            ends = time.monotonic() + PATIENCE_S
            while time.monotonic() < ends and not is_complete(found):
                chain.link.poll(0.2)
            del plain, late, readings
        yield found
        codes = chain.stop()
    assert codes["ros"] == 0


def stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def matrix(translation: Any, rotation: Any) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([rotation.x, rotation.y, rotation.z, rotation.w]).as_matrix()
    pose[:3, 3] = translation.x, translation.y, translation.z
    return pose


def at(trajectory: Trajectory, instant_ns: int) -> NDArray[np.float64]:
    assert trajectory.stamps_ns is not None
    # Stamps in TUM files have microseconds.
    nearest = int(np.argmin(np.abs(trajectory.stamps_ns - instant_ns)))
    assert abs(int(trajectory.stamps_ns[nearest]) - instant_ns) < 2_000
    return np.asarray(trajectory.transforms[nearest])


def test_every_topic_is_listed_with_type_hash_and_qos(heard: Heard) -> None:
    for topic, kind in TOPICS.items():
        assert heard.listed[topic] == [kind]
        (publisher,) = heard.info[topic].publishers
        assert publisher.node_name == "zenoh_loam"
        assert publisher.topic_type == kind
        assert publisher.type_hash == TYPES.hash_rihs01(kind)
        qos = qualities.QosProfile.decode(publisher.qos)
        latched = qos.durability == qualities.QosDurability.TRANSIENT_LOCAL
        assert latched == (topic in LATCHED)
        assert (qos.reliability == qualities.QosReliability.BEST_EFFORT) == (topic == "/points")
    assert heard.listed["/imu"] == [IMU]


def test_each_message_has_an_attachment_that_ros_can_read(heard: Heard) -> None:
    """A ROS process that cannot read the attachment aborts."""
    for topic in TOPICS:
        came = [*heard.samples[topic], *heard.late[topic]]
        assert came, topic
        read_back = [attachments.Attachment.from_bytes(s.attachment.to_bytes()) for s in came]
        assert {len(s.attachment.to_bytes()) for s in came} == {33}
        assert len({a.gid for a in read_back}) == 1
        numbers = [a.sequence_id for a in read_back[: len(heard.samples[topic])]]
        assert numbers == sorted(set(numbers))


def test_odometry_and_pose_are_the_stages_own(heard: Heard) -> None:
    for topic, file in (("/odom", "odometry.tum"), ("/pose", "trajectory.tum")):
        trajectory = read(heard.out / file)
        came = heard.decoded(topic)
        assert len(came) == len(trajectory)
        for message in came:
            pose = message.pose.pose
            wanted = at(trajectory, stamp_ns(message.header))
            np.testing.assert_allclose(matrix(pose.position, pose.orientation), wanted, atol=2e-6)
            covariance = np.asarray(message.pose.covariance).reshape(6, 6)
            np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
            assert np.linalg.eigvalsh(covariance)[0] >= -1e-12
    last = heard.decoded("/odom")[-1]
    assert last.header.frame_id == "odom"
    assert last.child_frame_id == "base_link"
    assert 1.0 < last.twist.twist.linear.x < 30.0


def test_frames_lead_from_the_map_to_the_robot(heard: Heard) -> None:
    trajectory = read(heard.out / "trajectory.tum")
    of: dict[tuple[str, str], dict[int, NDArray[np.float64]]] = defaultdict(dict)
    for message in heard.decoded("/tf"):
        for each in message.transforms:
            t = each.transform
            of[each.header.frame_id, each.child_frame_id][stamp_ns(each.header)] = matrix(
                t.translation, t.rotation
            )
    assert set(of) == {("map", "odom"), ("odom", "base_link")}
    both = of["map", "odom"].keys() & of["odom", "base_link"].keys()
    assert len(both) >= 0.9 * len(trajectory)
    for instant in both:
        found = of["map", "odom"][instant] @ of["odom", "base_link"][instant]
        np.testing.assert_allclose(found, at(trajectory, instant), atol=2e-6)


def cloud(message: Any) -> NDArray[np.float32]:
    fields = {f.name: (f.offset, f.datatype) for f in message.fields}
    assert fields == {"x": (0, 7), "y": (4, 7), "z": (8, 7), "intensity": (12, 7)}
    assert message.width * message.point_step == message.row_step == len(message.data)
    return np.asarray(message.data).view("<f4").reshape(-1, 4)


def test_clouds_lie_in_the_map(heard: Heard) -> None:
    trajectory = read(heard.out / "trajectory.tum")
    clouds = heard.decoded("/points")
    assert len(clouds) > 5
    for message in clouds:
        assert message.header.frame_id == "map"
        points = cloud(message)
        here = at(trajectory, stamp_ns(message.header))[:3, 3]
        ranges = np.linalg.norm(points[:, :3] - here, axis=1)
        assert ranges.min() > 0.4
        assert ranges.max() < 135.0
    # The last sweep ends where the capture ends.
    assert np.median([len(cloud(message)) for message in clouds]) > 1000
    whole = cloud(heard.decoded("/map")[-1])
    assert len(whole) == heard.map_points > 1000
    # The points of the sweeps lie where the map has points.
    tiles = {tuple(v) for v in np.floor(whole[:, :3] / 2.0).astype(int).tolist()}
    last = {tuple(v) for v in np.floor(cloud(clouds[-2])[:, :3] / 2.0).astype(int).tolist()}
    assert len(last & tiles) > 0.6 * len(last)


def test_the_path_is_the_trajectory(heard: Heard) -> None:
    trajectory = read(heard.out / "trajectory.tum")
    path = heard.decoded("/path")[-1]
    assert len(path.poses) == len(trajectory)
    for stamped in path.poses:
        pose = stamped.pose
        wanted = at(trajectory, stamp_ns(stamped.header))
        np.testing.assert_allclose(matrix(pose.position, pose.orientation), wanted, atol=2e-6)


def test_late_readers_have_what_is_latched(heard: Heard) -> None:
    (static,) = {s.payload.to_bytes() for s in heard.late["/tf_static"]}
    message: Any = TYPES.deserialize_cdr(static, TOPICS["/tf_static"])
    frames = {(t.header.frame_id, t.child_frame_id) for t in message.transforms}
    assert frames == {("base_link", "lidar"), ("base_link", "imu")}
    assert heard.late["/map"]
    kind = TOPICS["/path"]
    paths: list[Any] = [
        TYPES.deserialize_cdr(s.payload.to_bytes(), kind) for s in heard.late["/path"]
    ]
    whole = len(read(heard.out / "trajectory.tum"))
    assert max(len(path.poses) for path in paths) == whole


def test_diagnostics_name_every_stage(heard: Heard) -> None:
    last = heard.decoded("/diagnostics")[-1]
    levels = {s.name: s.level for s in last.status}
    for stage in ("driver", "registration", "odometry", "mapping", "integration", "ros"):
        assert f"zenoh-loam: {stage}" in levels
    assert "zenoh-loam: pose" in levels


def test_an_initial_pose_reaches_mapping(heard: Heard) -> None:
    assert "is in the frame 'base_link'; 'map' is expected" in heard.reason
    assert len(heard.places) == 1
    assert heard.places[0] == pytest.approx({"x_m": 12.0, "y_m": -3.5, "yaw_deg": 90.0})
    assert heard.listed["/initialpose"] == [PLACE]


def test_an_imu_of_either_byte_order_becomes_the_robots(heard: Heard) -> None:
    samples = imu_samples(heard)
    assert len(samples) == 2
    for stamp, force, rate in samples:
        assert stamp == 1_700_000_000_250_000_000
        assert tuple(force) == (1.5, -2.5, 9.75)
        assert tuple(rate) == (0.125, -0.25, 0.5)


@pytest.mark.slow
def test_the_map_stays_when_the_driver_starts_again(
    build: Path, robot_file: Path, tmp_path: Path
) -> None:
    """In a map that is only localized in, no tile is published again."""
    seconds = str(SECONDS + SPARE_S)
    drive = simulate(build, tmp_path, "--world", "city", "--seed", "3", "--duration", seconds)
    mapped = LiveRun(build, robot_file, drive, tmp_path)
    with mapped:
        mapped.end()
    run = LiveRun(build, robot_file, drive, tmp_path, more=("mapping.mode=localize",))
    port = free_port()
    widths: list[int] = []

    def note(sample: Any) -> None:
        cloud: Any = TYPES.deserialize_cdr(sample.payload.to_bytes(), TOPICS["/map"])
        widths.append(cloud.width)

    with run:
        ros = command(build, robot_file, run.chain, port)
        run.chain.processes.start("ros", ros, tmp_path / "ros.log")
        run._until(lambda: run.chain.link.stage("ros") is not None)
        with session(port) as reader:
            subscriber = reader.declare_subscriber(key_of("/map", TOPICS["/map"]), note)
            run._until(lambda: bool(widths) and widths[-1] > 0)
            before = widths[-1]
            kill(run.chain, "driver")
            run.chain.start("driver", "driver-again")
            run.until_runs(2)
            run.wait(2 * MAP_PERIOD_S)
            del subscriber
    assert widths[-1] == before
