"""Of a damaged recording all that is whole is used, and the rest is named; never a traceback."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.recordings import made, variants
from tests.recordings.made import streamed, texts
from tests.recordings.test_folders import EXACT, written
from tests.recordings.variants import CONTAINERS, PLAIN
from zloam_monitor import cli, sources
from zloam_monitor.recordings import stream

COVARIANCES = ("angular_velocity_covariance", "linear_acceleration_covariance")
RATE, FORCE = np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.0, 9.81])


def cut_message(bag: Path, topic: str, number: int, length: int = 60) -> None:
    """Cuts one message of a bag with SQLite."""
    (file,) = bag.glob("*.db3")
    with sqlite3.connect(file) as base:
        ids = base.execute(
            "select m.id from messages m join topics t on t.id = m.topic_id where t.name = ?"
            " order by m.id",
            (topic,),
        ).fetchall()
        base.execute(
            "update messages set data = substr(data, 1, ?) where id = ?", (length, ids[number][0])
        )
    base.close()


def with_imu(path: Path, count: int, *unmeasured: str) -> Path:
    """A bag with readings before each cloud: one per name of a covariance that is -1 in it."""
    with variants.Recorder(CONTAINERS[3], path) as bag:
        for scan in made.scans(count):
            for n, name in enumerate(unmeasured):
                stamp_ns = scan.stamp_ns + n * 10_000_000
                bag.put_imu("/imu", stamp_ns, RATE, FORCE, unmeasured=name)
            bag.put_cloud("/points", scan, PLAIN)
    return path


def test_one_unreadable_message_costs_one_sweep(tmp_path: Path) -> None:
    bag = variants.write(tmp_path / "bag", made.scans(20), PLAIN)
    cut_message(bag, "/points", 3)
    frames = streamed(bag)
    assert len(frames[stream.SWEEP]) == 19
    assert "unreadable: 1 message of /points" in texts(frames, stream.REMARK)
    sources.from_bag(bag, [])  # What the driver can use, the demo does not refuse.


def test_an_unreadable_reading_costs_no_sweep(tmp_path: Path) -> None:
    bag = with_imu(tmp_path / "bag", 20, "")
    cut_message(bag, "/imu", 5)
    frames = streamed(bag, imu_topic="")
    assert len(frames[stream.SWEEP]) == 20
    assert len(frames[stream.READING]) == 19
    assert "1 message of /imu" in texts(frames, stream.REMARK)


def test_a_bag_of_unreadable_messages_is_refused(tmp_path: Path) -> None:
    bag = variants.write(tmp_path / "bag", made.scans(3), PLAIN)
    for number in range(3):
        cut_message(bag, "/points", number)
    assert "none of its 3 messages" in texts(streamed(bag), stream.REFUSAL)


@pytest.mark.parametrize("which", COVARIANCES)
def test_readings_without_a_measurement_are_left_out(tmp_path: Path, which: str) -> None:
    frames = streamed(with_imu(tmp_path / "bag", 12, "", which), imu_topic="")
    assert len(frames[stream.READING]) == len(frames[stream.SWEEP]) == 12
    assert "12 readings" in texts(frames, stream.REMARK)


@pytest.mark.parametrize("count", [4, 30])
def test_a_topic_without_measurements_is_refused_before_the_first_sweep(
    tmp_path: Path, count: int
) -> None:
    frames = streamed(with_imu(tmp_path / "bag", count, COVARIANCES[0]), imu_topic="")
    assert "driver.imu_topic" in texts(frames, stream.REFUSAL)
    assert stream.SWEEP not in frames


@pytest.mark.parametrize("value", [20_000.0, np.inf, -np.inf])
def test_a_stray_point_is_no_map(tmp_path: Path, value: float) -> None:
    """In a later file, where a refusal would come after the run's beginning, and in all files."""
    folder = tmp_path / "clouds"
    folder.mkdir()
    for number, scan in enumerate(made.scans(40)):
        scan.xyz[5] = value if number == 30 or not np.isfinite(value) else 1.0
        EXACT["pcd-binary"](folder / f"{number:06d}", scan)
    frames = streamed(folder)
    assert len(frames[stream.SWEEP]) == 40
    assert stream.REFUSAL not in frames


def test_a_map_among_the_clouds_is_refused(tmp_path: Path) -> None:
    scans = made.scans(20)
    scans[15] = replace(scans[15], xyz=scans[15].xyz + np.float32(450_000))
    frames = streamed(written(tmp_path / "clouds", scans))
    assert "00001.500000000.pcd: half of its points" in texts(frames, stream.REFUSAL)


def lz4_chunk(folder: Path) -> Path:
    bag = variants.write(folder / "drive.bag", made.scans(20), PLAIN, CONTAINERS[2])
    data = bytearray(bag.read_bytes())
    data[9000:9064] = bytes(each ^ 0xFF for each in data[9000:9064])
    bag.write_bytes(data)
    return bag


def sqlite_pages(folder: Path) -> Path:
    bag = variants.write(folder / "bag", made.scans(20), PLAIN)
    (file,) = bag.glob("*.db3")
    data = bytearray(file.read_bytes())
    data[4096 * 2 : 4096 * 6] = bytes(each ^ 0xFF for each in data[4096 * 2 : 4096 * 6])
    file.write_bytes(data)
    return bag


def magic_alone(folder: Path) -> Path:
    (folder / "drive.mcap").write_bytes(b"\x89MCAP0\r\n")
    return folder / "drive.mcap"


def metadata_of_another_coding(folder: Path) -> Path:
    (folder / "metadata.yaml").write_bytes(b"rosbag2_bagfile_information: \xff\xfe")
    return folder


@pytest.mark.parametrize(
    "damaged", [lz4_chunk, sqlite_pages, magic_alone, metadata_of_another_coding]
)
def test_a_damaged_bag_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damaged: Callable[[Path], Path]
) -> None:
    bag = damaged(tmp_path)
    assert cli.main(["recording", str(bag)]) == 3
    said = capsys.readouterr().err.strip()
    assert "cannot be read: " in said
    assert "\n" not in said
    with pytest.raises(sources.SourceError, match="cannot be read: "):
        sources.from_bag(bag, [])
    assert "cannot be read: " in texts(streamed(bag), stream.REFUSAL)
