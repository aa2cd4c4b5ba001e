"""Bags through the real processes: results as good as those of the capture from which they were
made."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import dpkt
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.integration.conftest import Capture, monitor
from tests.recordings import variants
from tests.recordings.variants import CONTAINERS, PLAIN, READABLE, Scan
from zloam_monitor import trajectory

DATA_BYTES = 1206


@dataclass(frozen=True)
class Drive:
    capture: Capture
    scans: list[Scan]
    #: output folder of a run on the capture itself
    direct: Path


@pytest.fixture(scope="module")
def drive(build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("direct")
    scans = variants.decoded(build, capture.pcap, folder)
    out = folder / "out"
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, "--out", out)
    assert done.code == 0, done.said
    return Drive(capture, scans, out / "trajectory.tum")


def packets_of(pcap: Path) -> list[tuple[int, bytes]]:
    found = []
    with pcap.open("rb") as file:
        for seconds, frame in dpkt.pcap.Reader(file):
            data = bytes(dpkt.ethernet.Ethernet(frame).data.data.data)
            if len(data) == DATA_BYTES:
                found.append((round(float(seconds) * 1e9), data))
    return found


def clouds(drive: Drive, path: Path) -> None:
    layout = READABLE["velodyne: time, float s to the last"][0]
    variants.write(path, drive.scans, layout, CONTAINERS[7])


def packets(drive: Drive, path: Path) -> None:
    with variants.Recorder(CONTAINERS[3], path) as bag:
        sent = packets_of(drive.capture.pcap)
        for begin in range(0, len(sent), 76):
            bag.put_packets("/velodyne_packets", sent[begin : begin + 76])
        # The clouds that a driver made of the packets are in the same bag.
        for scan in drive.scans:
            bag.put_cloud("/velodyne_points", scan, PLAIN)


def nebula(drive: Drive, path: Path) -> None:
    with variants.Recorder(CONTAINERS[6], path) as bag:
        sent = packets_of(drive.capture.pcap)
        for begin in range(0, len(sent), 76):
            bag.put_nebula("/velodyne_packets", sent[begin : begin + 76])


@pytest.mark.parametrize(("make", "within_m"), [(clouds, 1e-3), (packets, 1e-5), (nebula, 1e-5)])
def test_the_trajectory_is_that_of_the_capture(
    build: Path,
    drive: Drive,
    tmp_path: Path,
    make: Callable[[Drive, Path], None],
    within_m: float,
) -> None:
    make(drive, tmp_path / "bag")
    out = tmp_path / "out"
    done = monitor("demo", "--preset-dir", build, "--bag", tmp_path / "bag", "--out", out)
    assert done.code == 0, done.said
    found, direct = trajectory.read(out / "trajectory.tum"), trajectory.read(drive.direct)
    assert len(found) == len(direct)
    off = found.transforms[:, :3, 3] - direct.transforms[:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < within_m


def test_a_bag_without_rings_is_as_good(build: Path, drive: Drive, tmp_path: Path) -> None:
    """The same drive with the sensor on its side, so that no rings can be found."""
    turned = [
        Scan(s.stamp_ns, s.xyz[:, [2, 0, 1]], s.intensity, s.ring, s.time_ns) for s in drive.scans
    ]
    path = variants.write(tmp_path / "bag", turned, PLAIN)
    mounting = ("--set", "mounting.rpy_deg=[0, -90, -90]")
    out = tmp_path / "out"
    done = monitor("demo", "--preset-dir", build, "--bag", path, "--out", out, *mounting)
    assert done.code == 0, done.said
    found, direct = trajectory.read(out / "trajectory.tum"), trajectory.read(drive.direct)
    assert len(found) == len(direct)
    off = found.transforms[:, :3, 3] - direct.transforms[:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < 0.05


@dataclass(frozen=True)
class Inertial:
    """A drive with an IMU: as capture and table, and as a bag."""

    pcap: Path
    csv: Path
    bag: Path
    readings: NDArray[np.float64]


@pytest.fixture(scope="module")
def inertial(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Inertial:
    folder = tmp_path_factory.mktemp("inertial")
    pcap, csv, bag = folder / "capture.pcap", folder / "imu.csv", folder / "bag"
    words = ("--world", "city", "--seed", "3", "--duration", "12", "--quiet")
    files = ("--out", pcap, "--imu", csv)
    subprocess.run([build / "bin/zloam-simulator", *words, *files], check=True)
    scans = variants.decoded(build, pcap, folder)
    readings = np.loadtxt(csv, delimiter=",", skiprows=1)
    stamps_ns = np.loadtxt(csv, delimiter=",", skiprows=1, usecols=0, dtype=np.int64)
    with variants.Recorder(CONTAINERS[6], bag) as recorder:
        # in the order of recording: a cloud comes after its revolution
        ends_ns = [scan.stamp_ns + variants.PERIOD_NS for scan in scans]
        puts = [(int(t), 0, i) for i, t in enumerate(stamps_ns)]
        puts += [(t, 1, i) for i, t in enumerate(ends_ns)]
        for stamp_ns, kind, i in sorted(puts):
            if kind:
                recorder.put_cloud("/points", scans[i], PLAIN)
            else:
                recorder.put_imu("/imu/data", stamp_ns, readings[i, 1:4], readings[i, 4:7])
    return Inertial(pcap, csv, bag, readings)


@pytest.mark.slow
def test_inertial_readings_of_a_bag_are_those_of_a_table(
    build: Path, inertial: Inertial, tmp_path: Path
) -> None:
    runs = {
        "bag": ("--bag", inertial.bag, "--set", "driver.imu=sensor"),
        "table": ("--pcap", inertial.pcap, "--imu", inertial.csv),
        "without": ("--bag", inertial.bag),
    }
    places = {}
    for name, words in runs.items():
        done = monitor("demo", "--preset-dir", build, *words, "--out", tmp_path / name)
        assert done.code == 0, done.said
        path = trajectory.read(tmp_path / name / "trajectory.tum")
        places[name] = path.transforms[:, :3, 3]
    off_m = {
        name: np.linalg.norm(places["bag"] - places[name], axis=1).max()
        for name in ("table", "without")
    }
    assert off_m["table"] < 1e-3
    assert off_m["without"] > off_m["table"]


def test_readings_that_are_not_there_are_refused(
    build: Path, drive: Drive, inertial: Inertial, tmp_path: Path
) -> None:
    bare = variants.write(tmp_path / "bag", drive.scans[:12], PLAIN)
    for bag, more, words in (
        (bare, (), "no topic of inertial readings"),
        (inertial.bag, ("--set", "driver.imu_topic=/nowhere"), "there is /imu/data"),
    ):
        settings = ("--set", "driver.imu=sensor", *more)
        done = monitor(
            "demo", "--preset-dir", build, "--bag", bag, *settings, "--out", tmp_path / "o"
        )
        assert done.code != 0
        assert words in done.said


def test_a_bag_as_a_capture_is_answered_by_what_to_do(
    build: Path, drive: Drive, tmp_path: Path
) -> None:
    path = variants.write(tmp_path / "bag", drive.scans[:2], PLAIN)
    done = monitor("demo", "--preset-dir", build, "--pcap", path, "--out", tmp_path / "out")
    assert (done.code, f"--bag {path}" in done.said) == (3, True), done.said


def test_what_is_refused_is_refused_before_anything_runs(
    build: Path, drive: Drive, tmp_path: Path
) -> None:
    layout = variants.REFUSED["no time"][0]
    path = variants.write(tmp_path / "bag", drive.scans[:4], layout)
    done = monitor("demo", "--preset-dir", build, "--bag", path, "--out", tmp_path / "out")
    assert done.code == 3
    assert "driver.time_model" in done.said
    assert not (tmp_path / "out" / "logs").exists()


def test_of_a_damaged_bag_what_is_whole_is_used_and_said(
    build: Path, drive: Drive, tmp_path: Path
) -> None:
    """A chunk of the bag is corrupt: the messages before it are used."""
    path = variants.write(tmp_path / "bag.bag", drive.scans[:30], PLAIN, CONTAINERS[1])
    whole = path.read_bytes()
    at = int(0.6 * len(whole))
    path.write_bytes(whole[:at] + bytes(4096) + whole[at + 4096 :])
    out = tmp_path / "out"
    done = monitor("demo", "--preset-dir", build, "--bag", path, "--out", out)
    assert done.code == 0, done.said
    assert "what is whole is used" in done.said
    poses = json.loads((out / "report.json").read_text())["identities"]["poses"]
    assert 10 <= poses < 30


def test_a_reader_that_is_not_there(build: Path, drive: Drive, tmp_path: Path) -> None:
    path = variants.write(tmp_path / "bag", drive.scans[:4], PLAIN)
    words = ("--bag", path, "--set", "driver.reader=/nowhere/zloam", "--out", tmp_path / "out")
    done = monitor("demo", "--preset-dir", build, *words)
    assert (done.code, "driver.reader" in done.said) == (3, True), done.said
