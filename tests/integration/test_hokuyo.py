"""A Hokuyo scanner on a motor: real sessions, a simulated drive as replay, and live over TCP and
over a serial line with the faults that may occur there."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.hokuyo import peer, simulated
from tests.hokuyo.device import Device, SerialDevice, TcpDevice
from tests.hokuyo.simulated import Session
from tests.integration.conftest import PATIENCE_S, ROOT, digests, kill, monitor, until
from tests.integration.replay_run import replayed
from zloam_monitor import evaluation, sources, trajectory
from zloam_monitor.chain import Chain
from zloam_monitor.records import HEALTH
from zloam_monitor.robot_file import names
from zloam_monitor.trajectory import from_records

ROBOT = ROOT / "deploy" / "robots" / "hokuyo.yaml"
SESSIONS = ("utm_30lx", "uxm_30lx_e", "urg_04lx")
POINT = np.dtype([("xyz", "<f4", 3), ("intensity", "<f4"), ("rest", "V16")])
#: length of the simulated drive; the platform stands for its first two seconds
SECONDS = 40
#: part of the same drive that is sent live
LIVE_SECONDS = 12.0
FILES = ("trajectory.tum", "odometry.tum", "map.pcd")


@pytest.mark.parametrize("name", SESSIONS)
def test_a_real_session_byte_by_byte(decode: Path, shared: Path, tmp_path: Path, name: str) -> None:
    session = shared / "data" / "hokuyo" / f"{name}.logr"
    out = tmp_path / "points"
    command = [str(decode), "--session", str(session), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    replies = peer.replies(session)
    assert all(peer.is_whole(reply) for reply in replies)
    assert told["replies_received"] == len(replies)
    assert sum(told[f"replies_{what}"] for what in told_bad()) == 0
    scans = peer.scans(session)
    assert told["scans_read"] == len(scans) >= 1
    points = np.fromfile(out, POINT)
    values = dict(
        line.split(b";")[0].split(b":", 1)
        for reply in replies
        if reply[0] == b"PP"
        for line in reply[2:]
    )
    expected = [expected_points(scan, values) for scan in scans]
    np.testing.assert_allclose(points["xyz"], np.concatenate([e[0] for e in expected]), atol=1e-5)
    np.testing.assert_array_equal(
        points["intensity"], np.concatenate([e[1] for e in expected]).astype(np.float32)
    )


def test_a_decoded_session_has_its_mount(decode: Path, shared: Path, tmp_path: Path) -> None:
    session, mount = shared / "data" / "hokuyo" / "urg_04lx.logr", tmp_path / "mount.yaml"
    mount.write_text("scanner: {rpy_deg: [90, 0, 0], xyz_m: [1, 2, 3]}\n")
    xyz_m = []
    for more in ([], ["--metadata", str(mount)]):
        out = tmp_path / "points"
        command = [str(decode), "--session", str(session), "--out", str(out), *more]
        subprocess.run(command, capture_output=True, check=True)
        xyz_m.append(np.fromfile(out, POINT)["xyz"])
    # Rolled by 90 degrees: y is z, z is -y.
    turned = np.stack([xyz_m[0][:, 0], -xyz_m[0][:, 2], xyz_m[0][:, 1]], axis=1)
    np.testing.assert_allclose(xyz_m[1], turned + np.array([1.0, 2.0, 3.0]), atol=1e-5)


def test_points_that_can_not_be_written_are_no_success(decode: Path, shared: Path) -> None:
    session = shared / "data" / "hokuyo" / "urg_04lx.logr"
    command = [str(decode), "--session", str(session), "--out", "/dev/full"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert "/dev/full" in done.stderr
    assert not done.stdout


def test_points_that_can_not_be_made_leave_those_before(
    decode: Path, shared: Path, tmp_path: Path
) -> None:
    session, out = shared / "data" / "hokuyo" / "urg_04lx.logr", tmp_path / "points"
    out.write_bytes(b"earlier")
    (tmp_path / "points.part").symlink_to("/dev/full")
    for source in (session, tmp_path / "no_such.logr"):
        command = [str(decode), "--session", str(source), "--out", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 3
        assert out.read_bytes() == b"earlier"
        assert list(tmp_path.iterdir()) == [out]


def test_a_summary_that_can_not_be_written_is_no_success(decode: Path, shared: Path) -> None:
    command = [str(decode), "--session", str(shared / "data" / "hokuyo" / "urg_04lx.logr")]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 3
    assert "standard output" in done.stderr


def told_bad() -> tuple[str, ...]:
    return ("too_long", "bad_status", "bad_checksum", "bad_characters", "bad_length", "unexpected")


def expected_points(scan: peer.Scan, of: dict[bytes, bytes]) -> tuple[np.ndarray, np.ndarray]:
    steps = scan.first_step + np.arange(len(scan.ranges_mm))
    azimuth = 2 * np.pi * (steps - int(of[b"AFRT"])) / int(of[b"ARES"])
    seen = (scan.ranges_mm >= int(of[b"DMIN"])) & (scan.ranges_mm <= int(of[b"DMAX"]))
    flat = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(steps))], axis=1)
    return (1e-3 * scan.ranges_mm[:, None] * flat)[seen], scan.intensities[seen]


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Session:
    where = ["--world", "indoor", "--seed", 4, "--speed-factor", 0.35, "--duration", SECONDS]
    return simulated.session(build, tmp_path_factory.mktemp("hokuyo") / "drive", *where)


def replay(build: Path, drive: Session, out: Path, *more: object) -> None:
    done = monitor(*("demo", "--preset-dir", build, "--session", drive.log, "--out", out, *more))
    assert done.code == 0, done.said


#: limit of the error of an undisturbed live run
AS_UNDISTURBED_M = 0.15


def error_m(drive: Session, out: Path) -> float:
    truth, found = trajectory.read(drive.truth), trajectory.read(out / "trajectory.tum")
    return evaluation.evaluate(found, truth).ate_rmse_m


@pytest.mark.parametrize(("with_imu", "most_m"), [(True, 0.05), (False, 0.15)])
def test_a_replayed_drive(
    build: Path, drive: Session, tmp_path: Path, with_imu: bool, most_m: float
) -> None:
    replay(build, drive, tmp_path, *(["--imu", drive.imu] if with_imu else []))
    report = json.loads((tmp_path / "report.json").read_text())
    assert error_m(drive, tmp_path) <= most_m
    poses = (tmp_path / "trajectory.tum").read_text().splitlines()
    # ten poses a second, though the scanner covers its whole view only once a second
    assert len(poses) >= 10 * SECONDS - 1
    assert report["health"]["counts"] == {"ok": report["health"]["poses"]}


def test_the_same_bytes_twice(build: Path, drive: Session, tmp_path: Path) -> None:
    for out in ("a", "b"):
        replay(build, drive, tmp_path / out, "--imu", drive.imu)
    assert digests(tmp_path / "a", FILES) == digests(tmp_path / "b", FILES)


@pytest.mark.slow
def test_a_replay_with_a_killed_odometry_has_the_same_bytes(
    build: Path, drive: Session, tmp_path: Path
) -> None:
    source = sources.with_imu(sources.from_session(drive.log), drive.imu)
    for out, stage in (("undisturbed", None), ("killed", "odometry")):
        replayed(build, ROBOT, source, tmp_path / out, stage)
    assert digests(tmp_path / "killed", FILES) == digests(tmp_path / "undisturbed", FILES)
    assert "a new odom frame" not in (tmp_path / "killed" / "odometry-again.log").read_text()


def test_a_session_without_angles_is_refused(build: Path, drive: Session, tmp_path: Path) -> None:
    alone = tmp_path / "alone.logr"
    shutil.copy(drive.log, alone)
    done = monitor("demo", "--preset-dir", build, "--session", alone, "--out", tmp_path / "out")
    assert done.code != 0
    assert "angles are missing" in done.said
    assert "one plane" in done.said


def test_a_motor_that_tells_nothing_is_described(
    build: Path, drive: Session, tmp_path: Path
) -> None:
    alone, mount = tmp_path / "alone.logr", tmp_path / "mount.yaml"
    shutil.copy(drive.log, alone)
    first_ns = np.loadtxt(drive.angles, delimiter=",", skiprows=1, max_rows=1)[0]
    # the motion profile of the simulator's motor
    profile = {
        "from_s": 1e-9 * float(first_ns),
        "speed_deg_s": 180,
        "amplitude_deg": 90,
        "reversal_s": 0.06,
    }
    mount.write_text(yaml.safe_dump({"motor": {"profile": profile}}))
    out = tmp_path / "out"
    done = monitor(
        *("demo", "--preset-dir", build, "--session", alone, "--imu", drive.imu, "--out", out),
        *("--set", f"driver.metadata={mount}"),
    )
    assert done.code == 0, done.said
    assert error_m(drive, out) <= 0.05


@pytest.mark.parametrize(
    ("motor", "key"), [("{delay_s: 1}", "motor.delay_s"), ("{? [a, b] : 1}", "motor.[a, b]")]
)
def test_a_mount_with_a_wrong_key_is_refused(
    build: Path, drive: Session, tmp_path: Path, motor: str, key: str
) -> None:
    mount = tmp_path / "mount.yaml"
    mount.write_text(f"scanner: {{rpy_deg: [0, 0, 0]}}\nmotor: {motor}\n")
    command = [str(build / "bin" / "zloam-driver"), "--config", str(ROBOT)]
    settings = ("driver.source=scip_log", f"driver.path={drive.log}")
    for setting in (*settings, f"driver.metadata={mount}"):
        command += ["--set", setting]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert str(mount) in done.stderr
    assert f"{mount}: {key} " in done.stderr


class Live:
    """The chain on a simulated device, with its motor's angles."""

    def __init__(self, build: Path, device: Device, drive: Session, out: Path) -> None:
        self.device, self.drive, self.build = device, drive, build
        settings = [f"driver.path={device.name}", f"integration.output_dir={out}"]
        robot = names(ROBOT, [])
        self.chain = Chain(build, ROBOT, robot.robot, settings, out, robot.sensor)
        self._motor: subprocess.Popen[str] | None = None
        self._feeder = threading.Thread(target=self._feed)
        self._stop = threading.Event()
        #: commands that the device received until all scans were sent
        self.asked: list[bytes] = []

    def __enter__(self) -> Live:
        try:
            self._start()
        except BaseException:
            self._end()  # What was not entered is not left either.
            raise
        return self

    def _start(self) -> None:
        self.chain.__enter__()
        self.chain.wait_linked()
        example = ROOT / "services" / "monitor" / "examples" / "publish_angles.py"
        endpoint = f"tcp/127.0.0.1:{self.chain.base_port}"
        self._motor = subprocess.Popen(
            [sys.executable, example, endpoint, "robot", "lidar"],
            stdin=subprocess.PIPE,
            text=True,
            env={"PYTHONPATH": str(self.build / "generated" / "python")},
        )
        self._until_angles_come()
        self.device.begin()
        self.device.until_begun()
        self._feeder.start()

    def _until_angles_come(self) -> None:
        """Publishes angles until the driver receives them, since the motor's program is linked only
        some time after its start. The stamps lie 60 s before all scan lines and so affect none of
        them."""
        first_rad = float(np.loadtxt(self.drive.angles, delimiter=",", skiprows=1, max_rows=1)[1])
        stamp_ns = time.time_ns() - int(60e9)
        ends = time.monotonic() + PATIENCE_S
        while self.chain.link.stage("driver").figures.get("angles_received", 0) == 0:
            assert time.monotonic() < ends
            self.chain.link.poll(0.1)
            stamp_ns += int(25e6)
            self._tell(stamp_ns, first_rad)

    def _tell(self, stamp_ns: int, angle_rad: float) -> None:
        assert self._motor is not None
        assert self._motor.stdin is not None
        self._motor.stdin.write(f"{stamp_ns},{angle_rad}\n")
        self._motor.stdin.flush()

    def _feed(self) -> None:
        """Publishes the angles at their pace, stamped by this host's clock like the device's
        lines."""
        rows = np.loadtxt(self.drive.angles, delimiter=",", skiprows=1)
        at_s = 1e-9 * rows[:, 0] - self.device.first_s
        shift_ns = self.host_ns(0.0)
        for since_s, (_, angle) in zip(at_s, rows, strict=True):
            while time.monotonic() < self.device.began + since_s:
                if self._stop.is_set():
                    return
                time.sleep(0.01)
            self._tell(shift_ns + int(1e9 * since_s), angle)

    def until_sent(self) -> None:
        until(self.chain, lambda: self.device.finished)
        # After this, the driver hears a device that has nothing more to send.
        self.asked = list(self.device.commands)
        ends = time.monotonic() + 2.0
        while time.monotonic() < ends:
            self.chain.link.poll(0.1)

    def until_all_have_poses(self) -> None:
        """Waits for the poses of the driver's sweeps, which come late on a busy machine. Its last
        lines may be less than a slice, which gives no pose."""
        link = self.chain.link
        until(self.chain, lambda: max(link.poses) >= link.stage("driver").last_sweep - 1)

    def host_ns(self, since_s: float) -> int:
        """The instant on this host's clock so long after the session's first line."""
        return time.time_ns() - int(1e9 * (time.monotonic() - self.device.began - since_s))

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._feeder.join()
        self._end()

    def _end(self) -> None:
        if self._motor is not None:
            assert self._motor.stdin is not None
            self._motor.stdin.close()
            self._motor.wait()
        self.chain.close()
        self.device.close()

    def error_m(self) -> float:
        """ATE of the poses with health `ok` against the truth, shifted to this host's clock."""
        truth = trajectory.read(self.drive.truth)
        poses = [p for p in self.chain.link.poses.values() if p.health == HEALTH.index("ok")]
        shift_ns = self.host_ns(0.0) - int(1e9 * self.device.first_s)
        rows = {
            i: (p.instant_ns - shift_ns, p.translation, p.quaternion) for i, p in enumerate(poses)
        }
        return evaluation.evaluate(from_records(rows), truth).ate_rmse_m


def test_live_with_a_killed_odometry(build: Path, drive: Session, tmp_path: Path) -> None:
    with Live(build, TcpDevice(drive.log, 1.5 * LIVE_SECONDS), drive, tmp_path) as live:
        link = live.chain.link
        until(live.chain, lambda: len(link.poses) >= 50)
        last = max(link.poses)
        kill(live.chain, "odometry")
        live.chain.start("odometry", "odometry-again")
        live.until_sent()
        live.until_all_have_poses()
        ended = max(p.sweep for p in link.poses.values())
        after = {p.sweep: HEALTH[p.health] for p in link.poses.values() if last < p.sweep < ended}
        assert len(after) > 60
        assert set(after.values()) == {"ok"}, after
        assert live.error_m() <= AS_UNDISTURBED_M


@pytest.mark.parametrize("kind", [TcpDevice, SerialDevice])
def test_live(
    build: Path, drive: Session, tmp_path: Path, kind: type[TcpDevice] | type[SerialDevice]
) -> None:
    with Live(build, kind(drive.log, LIVE_SECONDS), drive, tmp_path) as live:
        live.until_sent()
        until(live.chain, lambda: len(live.chain.link.poses) >= 9 * LIVE_SECONDS)
        assert live.error_m() <= AS_UNDISTURBED_M
        assert live.asked[0] == b"QT"
        assert live.asked.count(b"TM1") == 10


def test_live_with_damaged_scans_only_is_degraded(
    build: Path, drive: Session, tmp_path: Path
) -> None:
    device = TcpDevice(drive.log, LIVE_SECONDS)
    device.spoil = lambda number, data: data[: len(data) // 2] + b"~" + data[len(data) // 2 + 1 :]
    with Live(build, device, drive, tmp_path) as live:
        live.until_sent()
        until(live.chain, lambda: "no sweep" in live.chain.link.stage("driver").reason)
        status = live.chain.link.stage("driver")
        assert status.figures["replies_bad_checksum"] > 100
        assert status.health == "degraded"
        assert "but no sweep for 3 s" in status.reason


def test_live_with_a_lost_connection_and_damaged_scans(
    build: Path, drive: Session, tmp_path: Path
) -> None:
    device = TcpDevice(drive.log, LIVE_SECONDS)
    lost = int(len(device.scans) * 0.6)
    device.cut = lambda number: number == lost

    def spoilt(number: int, data: bytes) -> bytes:
        middle = len(data) // 2
        return data[:middle] + b"~" + data[middle + 1 :] if number % 50 == 20 else data

    device.spoil = spoilt
    with Live(build, device, drive, tmp_path) as live:
        live.until_sent()
        live.until_all_have_poses()
        figures = live.chain.link.stage("driver").figures
        assert figures["reconnects"] >= 1
        assert figures["replies_bad_checksum"] >= 5
        assert figures["scans_lost"] >= 5
        # Poses go on after the loss, which was 4.8 s before the last scan.
        newest_ns = max(p.instant_ns for p in live.chain.link.poses.values())
        assert newest_ns > live.host_ns(device.scans[lost][0] + 2.0)
        assert live.asked.count(b"QT") == 2
