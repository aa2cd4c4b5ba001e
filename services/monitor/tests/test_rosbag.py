"""A ROS bag given as a capture is answered by what to do, and what is advised works."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import dpkt
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from zloam_monitor import cli

EXAMPLE = Path(__file__).parents[1] / "examples" / "rosbag_to_pcap.py"
SCAN = "velodyne_msgs/msg/VelodyneScan"
STAMPS = [(1_700_000_000 + i // 2, 400_000_000 * (i % 2)) for i in range(6)]


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("rosbag_to_pcap", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def payloads() -> list[bytes]:
    rng = np.random.default_rng(4)
    return [rng.integers(0, 256, 1206, np.uint8).tobytes() for _ in STAMPS]


def write(folder: Path, version: int) -> Path:
    """Three scans of two packets."""
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    time = "time" if version == 1 else "builtin_interfaces/Time"
    packet = f"{time} stamp\nuint8[1206] data\n"
    store.register(get_types_from_msg(packet, "velodyne_msgs/msg/VelodynePacket"))
    scan = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
    store.register(get_types_from_msg(scan, SCAN))
    types = store.types
    Time, Header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    Packet, Scan = types["velodyne_msgs/msg/VelodynePacket"], types[SCAN]
    packets = [
        Packet(Time(*stamp), np.frombuffer(data, np.uint8))
        for stamp, data in zip(STAMPS, payloads(), strict=True)
    ]
    number = {"seq": 0} if version == 1 else {}
    path = folder / ("drive.bag" if version == 1 else "drive")
    writer = Writer1(path) if version == 1 else Writer2(path, version=9)
    with writer:
        topic = writer.add_connection("/velodyne_packets", SCAN, typestore=store)
        for i in range(0, len(packets), 2):
            header = Header(stamp=Time(*STAMPS[i]), frame_id="velodyne", **number)
            message = Scan(header, packets[i : i + 2])
            raw = (store.serialize_ros1 if version == 1 else store.serialize_cdr)(message, SCAN)
            writer.write(topic, STAMPS[i][0] * 10**9 + STAMPS[i][1], raw)
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_a_bag_is_answered_by_what_to_do(
    version: int, example: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write(tmp_path, version)
    files = [bag, *bag.glob("*.db3")] if version == 2 else [bag]
    for file in files:
        assert cli.main(["demo", "--pcap", str(file)]) == 1
        said = capsys.readouterr().err
        assert f"is a ROS {version} bag" in said
        assert EXAMPLE.name in said
    assert example.convert(bag, tmp_path / "drive.pcap") == len(STAMPS)
    with (tmp_path / "drive.pcap").open("rb") as capture:
        rows = list(dpkt.pcap.Reader(capture))
    assert [bytes(dpkt.ethernet.Ethernet(frame).data.data.data) for _, frame in rows] == payloads()
    stamps = [round(float(t), 6) for t, _ in rows]
    assert stamps == [seconds + nanoseconds * 1e-9 for seconds, nanoseconds in STAMPS]


def test_a_bag_without_packets_says_what_it_has(example: ModuleType, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(tmp_path / "other.bag") as writer:
        topic = writer.add_connection("/words", "std_msgs/msg/String", typestore=store)
        text = store.types["std_msgs/msg/String"]("hello")
        writer.write(topic, 1, store.serialize_ros1(text, "std_msgs/msg/String"))
    with pytest.raises(SystemExit, match=r"no packets of a Velodyne in it, but /words"):
        example.convert(tmp_path / "other.bag", tmp_path / "none.pcap")
