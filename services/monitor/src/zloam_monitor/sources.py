"""What is replayed: from the command line to the driver's settings, truth and configuration."""

from __future__ import annotations

import subprocess
import tarfile
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from zloam_monitor import claims, places
from zloam_monitor.processes import describe_code

ROBOTS = places.robots()
#: in place of a file of inertial readings: the simulator's own
SIMULATED_IMU = "simulated"
#: first bytes of recordings that are no captures
BAGS = (
    (b"#ROSBAG V", "a ROS 1 bag"),
    (b"SQLite format 3", "a ROS 2 bag (SQLite)"),
    (b"\x89MCAP", "a ROS 2 bag (MCAP)"),
)


class SourceError(RuntimeError):
    """The source can't be used; the text says why and what would do."""


@dataclass(frozen=True)
class Source:
    """One recording."""

    title: str
    kind: str  # pcap, bin, kitti, scans
    path: Path
    #: configuration when none was named
    config: Path
    truth: list[Path] = field(default_factory=list)
    #: sweeps in it, where that is known beforehand
    sweeps: int | None = None
    settings: list[str] = field(default_factory=list)
    #: further files that it is read from
    readings: list[Path] = field(default_factory=list)

    @property
    def files(self) -> list[Path]:
        """What is read."""
        return [self.path, self.config, *self.truth, *self.readings]

    def driver_settings(self, rate: str) -> list[str]:
        """As --set of the driver."""
        return [
            f"driver.source={self.kind}",
            f"driver.path={self.path.resolve()}",
            f"driver.rate={rate}",
            *self.settings,
        ]


def _existing(path: Path, what: str) -> Path:
    if not path.exists():
        raise SourceError(f"{what} {path} does not exist")
    return path


def _bag(path: Path) -> str | None:
    """What kind of ROS recording it is, if any."""
    if (path / "metadata.yaml").is_file():
        return "a ROS 2 bag"
    if not path.is_file():
        return None
    with path.open("rb") as file:
        begin = file.read(16)
    return next((kind for magic, kind in BAGS if begin.startswith(magic)), None)


def _refuse_bag(path: Path) -> None:
    if kind := _bag(path):
        raise SourceError(
            f"{path} is {kind}; what is replayed are the sensor's packets. Where it has them "
            "(velodyne_packets), `pip install rosbags` and services/monitor/examples/"
            f"rosbag_to_pcap.py {path} drive.pcap make a capture of them; clouds alone can't be "
            "used"
        )


def from_pcap(path: Path) -> Source:
    """A pcap or pcapng capture; a file that can't be read is the driver's to refuse."""
    _refuse_bag(path)
    return Source(path.name, "pcap", path, ROBOTS / "vlp16-outdoor.yaml")


def from_bin(path: Path) -> Source:
    """Bare 1206-byte payloads end to end."""
    _refuse_bag(path)
    return Source(path.name, "bin", path, ROBOTS / "vlp16-outdoor.yaml")


def from_kitti(folder: Path, unpack_to: Path) -> Source:
    """A KITTI drive: velodyne/*.bin, or velodyne.tar.xz, which is unpacked once."""
    _existing(folder, "the folder")
    scans = folder / "velodyne" if (folder / "velodyne").is_dir() else folder
    archive = folder / "velodyne.tar.xz"
    if scans == folder and archive.is_file():
        scans = _unpacked(archive, unpack_to / folder.name)
    count = len(list(scans.glob("*.bin")))
    if count == 0:
        raise SourceError(f"{folder}: neither *.bin, velodyne/*.bin nor velodyne.tar.xz is in it")
    truth = sorted(folder.glob("reference_*.txt")) + sorted(folder.glob("poses.txt"))
    return Source(folder.name, "kitti", scans, ROBOTS / "hdl64e.yaml", truth, count)


def _unpacked(archive: Path, target: Path) -> Path:
    done = target / "velodyne"
    if not done.is_dir():
        target.mkdir(parents=True, exist_ok=True)
        with tarfile.open(archive) as tar:
            tar.extractall(target, filter="data")
    return done


def from_scans(folder: Path) -> Source:
    """Scans with a time for each point (16-byte records), stamps.txt, perhaps gt_dense.tum."""
    _existing(folder, "the folder")
    count = len(list((folder / "scans").glob("*.bin")))
    if count == 0 or not (folder / "stamps.txt").is_file():
        raise SourceError(f"{folder}: scans/*.bin and stamps.txt are needed")
    truth = [p for p in [folder / "gt_dense.tum"] if p.is_file()]
    return Source(folder.name, "scans", folder, ROBOTS / "vlp16-outdoor.yaml", truth, count)


def with_imu(source: Source, readings: Path) -> Source:
    """The same with inertial readings; a file that can't be read is the driver's to refuse."""
    settings = ["driver.imu=file", f"driver.imu_path={readings.resolve()}"]
    return replace(source, settings=[*source.settings, *settings], readings=[readings])


def simulated(
    simulator: Path,
    out: Path,
    world: str,
    seed: int,
    extra: Iterable[str],
    imu: bool = False,
    inputs: Iterable[Path] = (),
) -> Source:
    """A capture made by the simulator, its truth, and its inertial readings where wanted."""
    made = ("capture.pcap", "simulated_truth.tum", "imu.csv")
    claim = claims.claim(out, made[: 3 if imu else 2], inputs)
    capture, truth, readings = (out / name for name in made)
    command = [
        str(simulator),
        "--world",
        world,
        "--seed",
        str(seed),
        "--out",
        str(capture),
        "--truth",
        str(truth),
        *(["--imu", str(readings)] if imu else []),
        *extra,
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    claim.record()
    if done.returncode != 0:
        raise SourceError(
            f"zloam-simulator ended with {describe_code(done.returncode)}:\n{done.stderr}"
        )
    title = f"{world}, seed {seed}, simulated"
    source = Source(title, "pcap", capture, ROBOTS / "vlp16-outdoor.yaml", [truth])
    return with_imu(source, readings) if imu else source
