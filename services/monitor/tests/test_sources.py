"""The command line of a replay becomes settings of the driver."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import numpy as np
import pytest

from fake_session import needs_schemas
from zloam_monitor import cli, clouds, compose, sources
from zloam_monitor.failures import Misuse
from zloam_monitor.mcap_file import McapFile
from zloam_monitor.messages import MAP_POINT, POINT
from zloam_monitor.recorded_keys import schema_of


def test_readings_go_with_any_recording(tmp_path: Path) -> None:
    readings = tmp_path / "imu.csv"
    source = sources.with_imu(sources.from_pcap(Path("drive.pcap")), readings)
    settings = source.driver_settings("max")
    assert "driver.source=pcap" in settings
    assert "driver.imu=file" in settings
    assert f"driver.imu_path={readings}" in settings


def robot_log(path: Path, imu: str) -> Path:
    """A robot's own recording of one sweep without readings; imu: its driver's driver.imu."""
    needs_schemas()
    about = {"robot": "r", "sensor": "lidar", "recording": "a", "version": "0.1.0", "part": "1"}
    file = McapFile(path, about)
    config = compose.config("driver", {"driver.imu": imu})
    sweep = compose.sweep(compose.HeaderValues(1, 0, 0), np.zeros(1, POINT))
    for topic, payload in (("service/driver/a/config", config), ("lidar/lidar/sweep", sweep)):
        file.put(f"loam/r/{topic}", schema_of(payload[4:8]), 0, 0, payload)
    file.close()
    return path


@pytest.mark.parametrize(("imu", "taken"), [("zenoh", True), ("none", False)])
def test_an_imu_that_began_late_is_replayed(tmp_path: Path, imu: str, taken: bool) -> None:
    """Its first sweeps have no readings: the driver's configuration tells that it took some."""
    path = robot_log(tmp_path / "run.mcap", imu)
    assert ("driver.imu=sensor" in sources.from_bag(path, []).settings) == taken


def test_the_delay_of_recorded_readings_is_taken_off_once(tmp_path: Path) -> None:
    path = robot_log(tmp_path / "run.mcap", "zenoh")
    own = tmp_path / "robot.yaml"
    own.write_text("driver:\n  imu: zenoh\n  imu_delay_ms: 20\n")
    assert "driver.imu_delay_ms=0" in sources.from_bag(path, [], own).settings


def test_a_recording_has_no_simulated_readings(capsys: pytest.CaptureFixture[str]) -> None:
    code = cli.main(["demo", "--pcap", "drive.pcap", "--imu", sources.SIMULATED_IMU])
    assert code != 0
    assert sources.SIMULATED_IMU in capsys.readouterr().err


def test_a_setting_that_is_no_number_is_named() -> None:
    with pytest.raises(Misuse, match=r"driver\.scan_period_s: '10 Hz': a number"):
        sources.asked({"driver.scan_period_s": "10 Hz"})


def archived(folder: Path, scans: dict[str, bytes]) -> Path:
    """A KITTI drive as an archive beside nothing else."""
    folder.mkdir(parents=True)
    with tarfile.open(folder / "velodyne.tar.xz", "w:xz") as tar:
        for name, data in scans.items():
            member = tarfile.TarInfo(f"velodyne/{name}")
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    return folder


def contents(source: sources.Source) -> list[bytes]:
    return [path.read_bytes() for path in sorted(source.path.glob("*.bin"))]


def test_drives_of_one_name_are_unpacked_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = archived(tmp_path / "a" / "drive", {"0.bin": b"first"})
    second = archived(tmp_path / "b" / "drive", {"0.bin": b"second"})
    to = tmp_path / "unpacked"
    for folder, data in ((first, b"first"), (second, b"second"), (first, b"first")):
        assert contents(sources.from_kitti(folder, to)) == [data]
        monkeypatch.chdir(folder)
        here = sources.from_kitti(Path(), to)
        assert (here.title, contents(here)) == ("drive", [data])
    assert len(list(to.iterdir())) == 2  # Each was unpacked once.
    (second / "velodyne.tar.xz").unlink()
    second.rmdir()
    archived(second, {"0.bin": b"again", "1.bin": b"and more"})
    assert contents(sources.from_kitti(second, to)) == [b"again", b"and more"]


def test_an_archive_that_was_cut_off_leaves_nothing(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    folder = archived(tmp_path / "drive", {f"{n}.bin": random.bytes(40_000) for n in range(5)})
    archive, to = folder / "velodyne.tar.xz", tmp_path / "unpacked"
    whole = archive.read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 0xFF
    for data in (whole[: len(whole) // 2], whole[:-1], whole[:3], bytes(damaged)):
        archive.write_bytes(data)
        for _ in range(2):  # The second run finds nothing that the first one left.
            with pytest.raises(sources.SourceError, match=r"velodyne\.tar\.xz: is cut off or dam"):
                sources.from_kitti(folder, to)
            assert not list(to.iterdir())
    archive.write_bytes(whole)
    assert sources.from_kitti(folder, to).sweeps == 5


def test_an_archive_without_scans_is_refused_each_time(tmp_path: Path) -> None:
    folder = archived(tmp_path / "drive", {"readme.txt": b"nothing"})
    for _ in range(2):
        with pytest.raises(sources.SourceError, match=r"velodyne/\*\.bin is expected"):
            sources.from_kitti(folder, tmp_path / "unpacked")


def test_a_bag_is_read_as_the_robots_file_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Clouds without point times are refused unless driver.time_model says how the lidar turns."""
    folder, own = tmp_path / "clouds", tmp_path / "my.yaml"
    folder.mkdir()
    points = np.zeros(500, MAP_POINT)
    azimuth = np.linspace(-np.pi, np.pi, 500)
    points["x"], points["y"] = 10.0 * np.cos(azimuth), 10.0 * np.sin(azimuth)
    for number in range(3):
        clouds.write_pcd(folder / f"{number}.pcd", points, np.zeros(500, np.uint8))
    with pytest.raises(sources.SourceError, match=r"driver\.time_model=clockwise"):
        sources.from_bag(folder, [])
    own.write_text("driver:\n  time_model: counter_clockwise\n  scan_period_s: 0.25\n")
    sources.from_bag(folder, [], own)
    said = capsys.readouterr().out
    assert "driver.time_model=counter_clockwise" in said
    assert "a cloud every 0.25 s" in said
    sources.from_bag(folder, ["driver.scan_period_s=0.5"], own)
    assert "a cloud every 0.5 s" in capsys.readouterr().out
    own.write_text("driver:\n  topic: /points\n")
    with pytest.raises(sources.SourceError, match=r"driver\.topic=/points"):
        sources.from_bag(folder, [], own)
