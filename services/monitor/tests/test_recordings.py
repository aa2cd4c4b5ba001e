"""Recordings that other programs leave in forms of their own."""

from __future__ import annotations

import contextlib
import random
import shutil
import sqlite3
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from zloam_monitor import cli, clouds, sources
from zloam_monitor.failures import Misuse
from zloam_monitor.mcap_file import McapFile
from zloam_monitor.messages import MAP_POINT
from zloam_monitor.recordings import Refused, bags, fields, folders, robot_log
from zloam_monitor.records import RevisionRecord

CLOUD = "sensor_msgs/msg/PointCloud2"
STAMP_NS = 10**18


def a_bag(path: Path, starts: dict[str, int]) -> Path:
    """A ROS 1 bag: topic with the name of its publisher -> number of messages."""
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](10**9, 0), "l")
    cloud = types[CLOUD](header, 1, 0, [], False, 1, 0, np.empty(0, np.uint8), True)
    with Writer(path) as bag:
        for publisher, count in starts.items():
            topic = publisher.partition(" ")[0]
            connection = bag.add_connection(topic, CLOUD, typestore=store, callerid=publisher)
            for n in range(count):
                bag.write(connection, STAMP_NS + n, store.serialize_ros1(cloud, CLOUD))
    return path


def test_a_topic_of_a_driver_that_was_restarted_is_one(tmp_path: Path) -> None:
    path = a_bag(tmp_path / "drive.bag", {"/points first": 3, "/points second": 4})
    with bags.opened(path) as bag:
        assert [str(topic) for topic in bag.topics] == ["/points (PointCloud2, 7 messages)"]
        assert bag.choose("") == bag.choose("/points") == bag.topics[0]
        assert len(list(bag.messages(bag.topics[0]))) == 7


def test_several_topics_remain_several(tmp_path: Path) -> None:
    path = a_bag(tmp_path / "drive.bag", {"/a 1": 1, "/b 1": 2, "/a 2": 3})
    with bags.opened(path) as bag:
        assert [(topic.name, topic.messages) for topic in bag.topics] == [("/a", 4), ("/b", 2)]
        with pytest.raises(Refused, match="several topics"):
            bag.choose("")


def test_of_several_topics_the_fullest_is_proposed(tmp_path: Path) -> None:
    path = a_bag(tmp_path / "drive.bag", {"/imu_packets": 2, "/lidar_packets": 6})
    with bags.opened(path) as bag, pytest.raises(Refused, match=r"driver\.topic=/lidar_packets$"):
        bag.choose("")


def a_bag2(path: Path, count: int, plugin: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    """The file of a ROS 2 bag with so many messages on one topic."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](10**9, 0), "l")
    cloud = types[CLOUD](header, 1, 0, [], False, 1, 0, np.empty(0, np.uint8), True)
    with Writer2(path, version=9, storage_plugin=plugin) as bag:
        connection = bag.add_connection("/points", CLOUD, typestore=store)
        for n in range(count):
            bag.write(connection, STAMP_NS + n, store.serialize_cdr(cloud, CLOUD))
    return next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))


def test_a_topic_of_inertial_readings_without_any_is_not_chosen(tmp_path: Path) -> None:
    """A driver may advertise raw readings that it never sends."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(tmp_path / "drive.bag") as bag:
        for topic, count in {"/imu/data": 2, "/imu/data_raw": 0}.items():
            connection = bag.add_connection(topic, bags.IMU, typestore=store)
            for n in range(count):
                bag.write(connection, STAMP_NS + n, bytes(320))
    with bags.opened(tmp_path / "drive.bag") as opened:
        assert opened.choose_imu("") == "/imu/data"
        with pytest.raises(Refused, match=r"no topic /imu/data_raw .*/imu/data_raw \(0 messages"):
            opened.choose_imu("/imu/data_raw")


def test_messages_in_sqlites_log_are_not_passed_over(tmp_path: Path) -> None:
    """As a recorder with the storage preset `resilient` leaves them that was killed."""
    file = a_bag2(tmp_path / "bag", 3)
    base = sqlite3.connect(file)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute(
        "INSERT INTO messages(topic_id, timestamp, data)"
        " SELECT topic_id, timestamp + 10, data FROM messages"
    )
    base.commit()
    killed = shutil.copytree(tmp_path / "bag", tmp_path / "killed")
    base.close()
    for path in (killed, killed / file.name):
        with pytest.raises(Refused, match=r"sqlite3 '.*bag\.db3' 'PRAGMA wal_checkpoint'$"):
            bags.opened(path).__enter__()
    # What is proposed.
    with contextlib.closing(sqlite3.connect(killed / file.name)) as base:
        base.execute("PRAGMA wal_checkpoint")
    with bags.opened(killed / file.name) as bag:
        assert len(list(bag.messages(bag.topics[0]))) == 6


@pytest.mark.parametrize("plugin", StoragePlugin)
def test_of_a_folder_without_metadata_a_file_is_named(
    tmp_path: Path, plugin: StoragePlugin
) -> None:
    file = a_bag2(tmp_path / "bag", 3, plugin)
    (file.parent / "metadata.yaml").unlink()
    said = rf"no metadata\.yaml.*such as {file.name}, or .*ros2 bag reindex"
    with pytest.raises(Refused, match=said):
        bags.opened(file.parent).__enter__()
    with pytest.raises(sources.SourceError, match=said):
        sources.from_bag(file.parent, [])
    with bags.opened(file) as bag:
        assert len(list(bag.messages(bag.topics[0]))) == 3


def test_signs_in_a_path_that_the_library_can_not_open_are_named(tmp_path: Path) -> None:
    a_bag2(tmp_path / "bag", 3).parent.rename(folder := tmp_path / "run#2")
    for path in (folder, folder / "bag.db3"):
        with pytest.raises(Refused, match=r"run#2.*path with \?, # or % in it: rename"):
            bags.opened(path).__enter__()


def test_of_a_file_that_was_cut_off_it_is_said_what_helps(tmp_path: Path) -> None:
    whole = a_bag2(tmp_path / "bag", 20, StoragePlugin.MCAP).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[:-100])
    with pytest.raises(Refused, match=r"cannot be read: .*`mcap recover"):
        bags.opened(tmp_path / "cut.mcap").__enter__()
    whole = a_bag(tmp_path / "drive.bag", {"/points": 3}).read_bytes()
    (tmp_path / "drive.bag.active").write_bytes(whole[:-100])
    with pytest.raises(Refused, match=r"`rosbag reindex`.*must end in \.bag"):
        bags.opened(tmp_path / "drive.bag.active").__enter__()


def test_fields_of_a_count_of_0_have_one_value() -> None:
    types = get_typestore(Stores.ROS2_JAZZY).types
    stamp = types["builtin_interfaces/msg/Time"](1, 0)
    header = types["std_msgs/msg/Header"](stamp, "lidar")
    field = types["sensor_msgs/msg/PointField"]
    xyz = [field(name, 4 * at, 7, 0) for at, name in enumerate("xyz")]
    data = np.array([1.0, 2.0, 3.0], "<f4").view(np.uint8)
    message = types[CLOUD](header, 1, 1, xyz, False, 12, 12, data, True)
    names = fields.names_of(list("xyz"), "")
    assert fields.cloud_of(message, names).xyz.tolist() == [[1.0, 2.0, 3.0]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a.pcd", "b.pcd"):
        clouds.write_pcd(tmp_path / name, np.zeros(1, MAP_POINT), np.zeros(1, np.uint8))
    return tmp_path


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ("0.0\n0.1\n".encode("utf-16"), r"times\.txt: is not UTF-8 text"),
        (b"0.0\ninf\n", r"times\.txt: "),
        (b"0.0\nnan\n", r"times\.txt: "),
        (b"0.0\nsoon\n", r"times\.txt: soon is no time"),
        (b"0.0\n1e99999999\n", r"times\.txt: 1e99999999 is no time"),
    ],
)
def test_times_that_can_not_be_read_name_their_file(folder: Path, data: bytes, said: str) -> None:
    (folder / "times.txt").write_bytes(data)
    with pytest.raises(Refused, match=said), folders.opened(folder, 0.1):
        pass


@pytest.mark.parametrize(
    ("texts", "stamps_ns"),
    [
        # As numpy.savetxt writes s and ns, and Python's print times of more than nine decimals.
        (
            ("1.403636579763555527e+09", "1.403636579863555431e+09"),
            (1_403_636_579_763_555_527, 1_403_636_579_863_555_431),
        ),
        (
            ("1.403636579763555584e+18", "1.403636579863555584e+18"),
            (1_403_636_579_763_555_584, 1_403_636_579_863_555_584),
        ),
        (
            ("1403636579.76355552673", "1403636579.86355543137"),
            (1_403_636_579_763_555_527, 1_403_636_579_863_555_431),
        ),
        (("0.000000e+00", "1.035900e-01"), (STAMP_NS, STAMP_NS + 103_590_000)),
    ],
)
def test_times_are_numbers_in_any_form(
    folder: Path, texts: tuple[str, str], stamps_ns: tuple[int, int]
) -> None:
    (folder / "times.txt").write_text("\n".join(texts))
    with folders.opened(folder, 0.1) as opened:
        tables = list(opened.messages(opened.topics[0]))
    assert tuple(table.stamp_ns for table in tables) == stamps_ns


def stamps_of(folder: Path, *names: str) -> list[int]:
    """Stamps of the clouds in a folder of files with these names."""
    for name in names:
        clouds.write_pcd(folder / f"{name}.pcd", np.zeros(1, MAP_POINT), np.zeros(1, np.uint8))
    with folders.opened(folder, 0.1) as opened:
        return [table.stamp_ns for table in opened.messages(opened.topics[0])]


@pytest.mark.parametrize("digits", [10, 13, 16, 19])
def test_numbers_of_as_many_digits_as_a_time_are_no_times(tmp_path: Path, digits: int) -> None:
    """KITTI's scans have ten digits, converted to PCD or not."""
    names = [f"{number:0{digits}d}" for number in range(3)]
    assert stamps_of(tmp_path, *names) == [STAMP_NS + n * 10**8 for n in range(3)]


def test_decimals_of_times_in_names_need_not_be_as_many(tmp_path: Path) -> None:
    """Python prints no zeros at the end."""
    names = ("1403636579.75", "1403636579.9", "1403636580.0", "1403636580.125")
    assert stamps_of(tmp_path, *names) == [
        1_403_636_579_750_000_000,
        1_403_636_579_900_000_000,
        1_403_636_580_000_000_000,
        1_403_636_580_125_000_000,
    ]


def test_nanoseconds_without_leading_zeros_are_not_taken_for_decimals(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="do not ascend"):
        stamps_of(tmp_path, "1403636579_5000000", "1403636579_105000000")


@pytest.mark.parametrize("more", [(), ("--stream",)])
def test_a_time_model_that_there_is_not(
    folder: Path, more: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["recording", str(folder), "--time-model", "foo", *more]) == 2
    assert "driver.time_model: foo is none of none, clockwise" in capsys.readouterr().err


@pytest.mark.parametrize("by_file", [True, False])
def test_a_time_model_that_there_is_not_is_a_wrong_configuration(
    folder: Path, tmp_path: Path, by_file: bool
) -> None:
    (robot := tmp_path / "robot.yaml").write_text(
        f"driver:\n  time_model: {'foo' if by_file else 'none'}\n"
    )
    settings = [] if by_file else ["driver.time_model=foo"]
    with pytest.raises(Misuse, match=r"driver\.time_model: foo is none of none, clockwise"):
        sources.from_bag(folder, settings, robot)


@pytest.mark.parametrize("value", ["nan", "inf", "-0.1", "0", "1e400"])
def test_a_period_that_is_none_is_refused(
    tmp_path: Path, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    clouds.write_pcd(tmp_path / "1.pcd", np.zeros(1, MAP_POINT), np.zeros(1, np.uint8))
    assert cli.main(["recording", str(tmp_path), "--period-s", value]) == 2
    assert "driver.scan_period_s: " in capsys.readouterr().err
    assert cli.main(["recording", str(tmp_path), "--seam-deg", "nan"]) == 2
    with pytest.raises(Misuse, match="scan_period_s"):
        sources.asked({"driver.scan_period_s": value})


def test_changes_of_other_runs_are_not_placed_by_their_sweeps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A change and its withdrawal in the run before would else be repeated in the replay."""
    own_run, first_sweep, begin_ns = 7, 100, 1000
    revisions = [
        RevisionRecord("mapping", 1, 6, 400, {"mapping.a": 3}, "i", at_ns=10),
        RevisionRecord("mapping", 2, 6, 800, {"mapping.a": 2}, "i", at_ns=20),
        RevisionRecord("mapping", 3, own_run, 150, {"mapping.a": 4}, "i", at_ns=2000),
        RevisionRecord("mapping", 4, 8, 30, {"mapping.a": 5}, "i", at_ns=3000),
    ]
    header = SimpleNamespace(Run=lambda: own_run, Sweep=lambda: first_sweep)
    begin = robot_log.Logged("sweep", "", begin_ns, b"")
    monkeypatch.setattr(robot_log, "_header", lambda _: header)
    monkeypatch.setattr(robot_log.RobotLog, "sweeps", lambda _: iter([begin]))
    logged = [SimpleNamespace(payload=revision) for revision in revisions]
    monkeypatch.setattr(robot_log.RobotLog, "found", lambda *_: logged)
    monkeypatch.setattr(
        robot_log, "records", SimpleNamespace(config_revision=lambda revision: revision)
    )
    assert robot_log.RobotLog(Path("run.mcap")).changes() == [
        "0:mapping.a=3",
        "0:mapping.a=2",
        "50:mapping.a=4",
    ]


def test_of_a_recording_no_damaged_message_is_used(tmp_path: Path) -> None:
    """A changed byte within random ones decompresses well; the chunk's checksum tells it."""
    file = McapFile(tmp_path / "run.mcap", {"robot": "r"})
    sent = [random.Random(n).randbytes(1_000_000) for n in range(12)]
    for n, data in enumerate(sent):
        file.put("loam/r/a", None, n, n, data)
    file.close()
    bytes_ = bytearray(file.path.read_bytes())
    bytes_[len(bytes_) // 2] ^= 0x40
    (damaged := tmp_path / "damaged.mcap").write_bytes(bytes_)
    log = robot_log.RobotLog(damaged)
    assert [m.payload for m in robot_log.RobotLog(file.path).messages()] == sent
    read = [m.payload for m in log.messages()]
    assert read[0] == sent[0]
    assert read[-1] == sent[-1]
    assert len(read) < len(sent)
    assert set(read) < set(sent)
    assert log.remarks == [
        "damaged.mcap is damaged within (CRCValidationError): what is whole is used"
    ]
    log = robot_log.RobotLog(damaged)
    found = [m.payload for m in log.found()]
    assert sent[: len(found)] == found
    assert ["what is whole before that is used" in remark for remark in log.remarks] == [True]
