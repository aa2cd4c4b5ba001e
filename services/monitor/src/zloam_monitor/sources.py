"""Turns the command line of a replay into driver settings, truth and configuration."""

from __future__ import annotations

import hashlib
import lzma
import subprocess
import tarfile
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from zloam_monitor import files, places, recordings, robot_file
from zloam_monitor.failures import FileTrouble, Misuse
from zloam_monitor.processes import StageDied
from zloam_monitor.recordings import bags, folders, mounting, robot_log, stream
from zloam_monitor.recordings.sweeps import Timing

ROBOTS = places.robots()
#: Configuration of a bag if the user names none.
BAG_CONFIG = ROBOTS / "vlp16-outdoor.yaml"
#: A robot's own recording has an IMU if its driver took one, or one of so many first sweeps has
#: readings: sweeps may come from a program of the user.
IMU_JUDGED_SWEEPS = 20
#: Speed on the simulated path: at most 0.5 m/s, as suits a scanner with one revolution a second.
HOKUYO_SPEED_FACTOR = 0.35
#: Given instead of a file with IMU readings: use those of the simulator.
SIMULATED_IMU = "simulated"
#: End of a simulated recording's title.
SIMULATED = ", simulated"


class SourceError(FileTrouble):
    """The source cannot be used; the text says why, and what would help."""


@dataclass(frozen=True)
class Source:
    """One recording, and how to replay it."""

    title: str
    kind: str  # Value of driver.source: pcap, bin, kitti, scans, recording, scip_log.
    path: Path
    #: Configuration if the user names none.
    config: Path
    truth: list[Path] = field(default_factory=list)
    #: Number of sweeps, if it is known beforehand.
    sweeps: int | None = None
    settings: list[str] = field(default_factory=list)
    #: Further files that the driver reads.
    readings: list[Path] = field(default_factory=list)
    #: Recorded changes, SWEEP:KEY=VALUE.
    changes: list[str] = field(default_factory=list)
    #: Command that makes the recording, and the files that it makes; empty if it is there.
    simulation: list[str] = field(default_factory=list)
    made: list[Path] = field(default_factory=list)

    @property
    def files(self) -> list[Path]:
        """All files that must be there, and that the replay reads."""
        return self.there([self.path, self.config, *self.truth, *self.readings])

    def there(self, paths: Iterable[Path]) -> list[Path]:
        """Those of these files that make() does not make."""
        return [path for path in paths if path not in self.made]

    def make(self) -> None:
        """Makes a simulated recording."""
        if not self.simulation:
            return
        print(f"simulating {self.title.removesuffix(SIMULATED)}", flush=True)
        done = subprocess.run(
            self.simulation, capture_output=True, text=True, errors="backslashreplace", check=False
        )
        if done.returncode != 0:
            raise StageDied("zloam-simulator", done.returncode, done.stderr)

    def driver_settings(self, rate: str) -> list[str]:
        """The driver's options --set."""
        return [
            f"driver.source={self.kind}",
            f"driver.path={self.path.resolve()}",
            f"driver.rate={rate}",
            *self.settings,
        ]


def _existing(path: Path, what: str) -> Path:
    if not path.exists():
        raise SourceError(f"{path}: does not exist; {what} is expected there")
    return path


def _name(path: Path) -> str:
    """The name for titles and texts, also of the current folder."""
    return path.resolve().name if path.is_dir() else path.name


def _refuse_bag(path: Path) -> None:
    if bags.is_recording(path):
        raise SourceError(f"{path}: is a bag, no capture; BAG={path}, or --bag {path}, replays it")


def from_bag(path: Path, settings: Iterable[str], config: Path | None = None) -> Source:
    """A bag or MCAP file; prints its contents and how it is read, or refuses it.

    config: the robot's file if the user named one; its mounting applies.
    """
    _existing(path, "a recording")
    if not folders.is_recording(path):
        if reason := bags.without_metadata(path):
            raise SourceError(f"{path}: {reason}")
        raise SourceError(
            f"{path}: is no bag of ROS 1 or 2, no MCAP file and no folder of PCD, PLY, LAS or LAZ "
            "files"
        )
    settings = list(settings)
    values = robot_file.driver_values(config or BAG_CONFIG, settings)
    try:
        for line in stream.described(path, *asked(values)):
            print(f"{_name(path)}: {line}", flush=True)
    except recordings.Refused as refused:
        raise SourceError(f"{path}: {refused}") from refused
    words = [f"driver.reader={places.command()}"]
    if robot_log.is_one(path):
        return _from_robot_log(path, words, config is not None)
    given = config is not None or any(each.startswith("mounting.") for each in settings)
    words += _mounting(path, values, given)
    return Source(_name(path), "recording", path, BAG_CONFIG, settings=words)


def _from_robot_log(path: Path, words: list[str], own_config: bool) -> Source:
    """A robot's recording, with its recorded configuration unless the user names a file."""
    log = robot_log.RobotLog(path)
    first = list(islice(log.sweeps(), IMU_JUDGED_SWEEPS))
    if not first:
        raise SourceError(f"{path}: there is no sweep in it (lidar/<sensor>/sweep)")
    if log.takes_imu() or any(len(robot_log.imu_of(sweep.payload)) for sweep in first):
        # The recorded stamps are without the delay that the robot's file may name.
        words += ["driver.imu=sensor", "driver.imu_delay_ms=0"]
    changes = []
    if not own_config:
        words += log.settings()
        changes = log.changes()
    if log.unread:
        said = ", ".join(sorted(log.unread))
        print(f"{path.name}: messages of {said} can't be read and are left out", flush=True)
    further = log.parts[1:]
    return Source(
        path.name, "recording", path, BAG_CONFIG, settings=words, readings=further, changes=changes
    )


def _mounting(path: Path, values: dict[str, str], given: bool) -> list[str]:
    """Mounting by the recording's static transforms, unless the user has given one."""
    if not bags.is_recording(path):
        return []
    with_imu = values.get("driver.imu") == "sensor" and not given
    try:
        with bags.opened(path) as bag:
            topic = bag.choose(asked(values)[0])
            imu = bag.choose_imu(values.get("driver.imu_topic", "")) if with_imu else None
            words, said = mounting.described(bag, topic, imu)
    except (recordings.Refused, recordings.CutOff) as refused:
        if given:  # Then the recording's own is not needed.
            return []
        raise SourceError(f"{path}: {refused}") from refused
    if said:
        stands = "; the mounting that you give stands" if given and words else ""
        print(f"{_name(path)}: {said}{stands}", flush=True)
    return [] if given else words


def _number(values: dict[str, str], name: str, default: float) -> float:
    text = values.get(name, str(default))
    try:
        return float(text)
    except ValueError:
        raise Misuse(f"driver.{name}: '{text}': a number is expected") from None


def asked(values: dict[str, str]) -> tuple[str, Timing]:
    """Topic and timing from the driver's keys."""
    of = {key.removeprefix("driver."): value for key, value in values.items()}
    timing = Timing(
        model=of.get("time_model", "none"),
        period_s=_number(of, "scan_period_s", 0.1),
        seam_deg=_number(of, "scan_seam_deg", 180.0),
        field=of.get("time_field", ""),
    )
    return of.get("topic", ""), timing


def from_pcap(path: Path) -> Source:
    """A pcap or pcapng capture; an unreadable file is refused by the driver."""
    _refuse_bag(path)
    return Source(path.name, "pcap", path, ROBOTS / "vlp16-outdoor.yaml")


def from_bin(path: Path) -> Source:
    """Bare payloads of 1206 bytes, one after another."""
    _refuse_bag(path)
    return Source(path.name, "bin", path, ROBOTS / "vlp16-outdoor.yaml")


def from_kitti(folder: Path, unpack_to: Path) -> Source:
    """A KITTI drive: velodyne/*.bin, or velodyne.tar.xz, which is unpacked once."""
    _existing(folder, "a folder of scans")
    scans = folder / "velodyne" if (folder / "velodyne").is_dir() else folder
    archive = folder / "velodyne.tar.xz"
    if scans == folder and archive.is_file():
        scans = _unpacked(archive, unpack_to) / "velodyne"
    count = len(list(scans.glob("*.bin")))
    if count == 0:
        raise SourceError(
            f"{folder}: *.bin, velodyne/*.bin or velodyne.tar.xz with velodyne/*.bin is expected "
            "in it"
        )
    truth = sorted(folder.glob("reference_*.txt")) + sorted(folder.glob("poses.txt"))
    return Source(_name(folder), "kitti", scans, ROBOTS / "hdl64e.yaml", truth, count)


def _unpacked(archive: Path, unpack_to: Path) -> Path:
    """The folder with the contents of this very archive, which appears completely or not at all."""
    path, status = archive.resolve(), archive.stat()
    identity = f"{path} {status.st_size} {status.st_mtime_ns}"
    known = hashlib.sha256(identity.encode()).hexdigest()[:12]
    target = unpack_to / f"{path.parent.name}-{known}"
    if target.is_dir():
        return target
    unpack_to.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(".part", f"{target.name}-", unpack_to) as scratch:
        _unpack(archive, part := Path(scratch) / "whole")
        try:
            part.rename(target)
        except OSError:
            if not target.is_dir():  # Otherwise another program has unpacked it meanwhile.
                raise
    return target


def _unpack(archive: Path, to: Path) -> None:
    try:
        with (
            files.named(to),
            lzma.open(archive) as data,
            tarfile.open(fileobj=data, mode="r:") as tar,
        ):
            tar.extractall(to, filter="data")
            # The check sums stand behind the end of the tar, where tarfile does not read.
            while data.read(1 << 20):
                pass
    except (tarfile.TarError, lzma.LZMAError, EOFError) as error:
        raise SourceError(f"{archive}: is cut off or damaged ({error}): fetch it again") from error


def from_scans(folder: Path) -> Source:
    """Scans with a time for each point (16-byte records), stamps.txt, perhaps gt_dense.tum."""
    _existing(folder, "a folder of scans")
    if folders.clouds_in(folder):
        raise SourceError(
            f"{folder}: has PCD, PLY or LAS files; BAG={folder}, or --bag {folder}, replays them"
        )
    count = len(list((folder / "scans").glob("*.bin")))
    if count == 0 or not (folder / "stamps.txt").is_file():
        raise SourceError(f"{folder}: scans/*.bin and stamps.txt are needed")
    truth = [p for p in [folder / "gt_dense.tum"] if p.is_file()]
    return Source(_name(folder), "scans", folder, ROBOTS / "vlp16-outdoor.yaml", truth, count)


def from_session(path: Path) -> Source:
    """Replies of a Hokuyo scanner as received, and the angles of its motor in the .csv beside."""
    _existing(path, "a session")
    # If the angles are missing, the driver refuses the session.
    angles = [path.with_suffix(".csv")] if path.with_suffix(".csv").is_file() else []
    return Source(path.name, "scip_log", path, ROBOTS / "hokuyo.yaml", readings=angles)


def with_imu(source: Source, readings: Path) -> Source:
    """The source with IMU readings from a file; an unreadable file is refused by the driver."""
    settings = ["driver.imu=file", f"driver.imu_path={readings.resolve()}"]
    return replace(
        source,
        settings=[*source.settings, *settings],
        readings=[*source.readings, readings],
    )


def simulated(
    simulator: Path,
    out: Path,
    world: str,
    seed: int,
    extra: Iterable[str],
    imu: bool = False,
    hokuyo: bool = False,
) -> Source:
    """A capture that the simulator makes, its truth, and its IMU readings if wanted.

    hokuyo: a session of a scanner on a motor, with the motor's angles, instead of the capture.
    """
    capture, angles = out / ("session.logr" if hokuyo else "capture.pcap"), out / "session.csv"
    truth, readings = out / "simulated_truth.tum", out / "imu.csv"
    wanted = ["--out", str(capture)]
    if hokuyo:
        wanted = ["--hokuyo", "--session", str(capture), "--angles", str(angles)]
        wanted += ["--speed-factor", str(HOKUYO_SPEED_FACTOR)]
    command = [
        str(simulator),
        "--world",
        world,
        "--seed",
        str(seed),
        *wanted,
        "--truth",
        str(truth),
        *(["--imu", str(readings)] if imu else []),
        *extra,
    ]
    kind, config = ("scip_log", "hokuyo") if hokuyo else ("pcap", "vlp16-outdoor")
    source = Source(
        f"{world}, seed {seed}{SIMULATED}",
        kind,
        capture,
        ROBOTS / f"{config}.yaml",
        [truth],
        readings=[angles] if hokuyo else [],
        simulation=command,
        made=[capture, truth, *([angles] if hokuyo else []), *([readings] if imu else [])],
    )
    return with_imu(source, readings) if imu else source
