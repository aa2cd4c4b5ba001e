"""The calibration of a scanner on its motor, from simulated sessions at rest."""

from __future__ import annotations

import re
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.hokuyo import simulated
from tests.hokuyo.simulated import Session
from tests.integration.conftest import ROOT, monitor
from zloam_monitor import evaluation, trajectory

ROBOT = ROOT / "deploy" / "robots" / "hokuyo.yaml"
#: length of the simulated drives
SECONDS = 40


def calibrated(
    build: Path, session: Path, *more: object
) -> tuple[int, dict[str, dict[str, Any]], str]:
    """Exit code, the calibration found, and the messages."""
    command = [str(build / "bin" / "zloam-calibrate"), str(session), *map(str, more)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, yaml.safe_load(done.stdout) or {}, done.stderr


@pytest.mark.parametrize(
    ("world", "seed"), [("indoor", 7), pytest.param("handheld", 3, marks=pytest.mark.slow)]
)
def test_calibration(build: Path, tmp_path: Path, world: str, seed: int) -> None:
    session = simulated.at_rest(build, tmp_path / "still", world, seed)
    code, found, said = calibrated(build, session.log)
    assert code == 0, said
    assert found["scanner"]["rpy_deg"][1:] == pytest.approx(simulated.MOUNT_DEG, abs=0.05)
    assert found["scanner"]["xyz_m"][1:] == pytest.approx(simulated.MOUNT_M, abs=0.005)
    # The robot file's offset takes off what the lines are received late.
    assert found["motor"]["delay_ms"] == pytest.approx(simulated.DELAY_MS, abs=1.0)


@pytest.mark.slow
def test_calibration_of_an_encoder_that_counts_backward(build: Path, tmp_path: Path) -> None:
    session = simulated.at_rest(build, tmp_path / "still", "indoor", 7)
    rows = np.loadtxt(session.angles, delimiter=",", skiprows=1)
    head = session.angles.read_text().splitlines()[0]
    lines = [f"{int(stamp_ns)},{-angle_rad:.9f}" for stamp_ns, angle_rad in rows]
    session.angles.write_text("\n".join([head, *lines]) + "\n")
    mount = tmp_path / "mount.yaml"
    mount.write_text("scanner: {to_deg: 120}\nmotor: {backward: true, turn_s: 1.5}\n")
    code, found, said = calibrated(build, session.log, "--mount", mount)
    assert code == 0, said
    assert found["scanner"]["rpy_deg"][1:] == pytest.approx(simulated.MOUNT_DEG, abs=0.05)
    assert found["scanner"]["xyz_m"][1:] == pytest.approx(simulated.MOUNT_M, abs=0.005)
    # What was known is in the result too.
    assert found["scanner"]["to_deg"] == 120
    assert found["motor"]["backward"] is True
    assert found["motor"]["turn_s"] == 1.5


@pytest.mark.slow
def test_a_calibration_without_a_mount_says_what_it_assumes(build: Path, tmp_path: Path) -> None:
    session = simulated.at_rest(build, tmp_path / "still", "indoor", 7)
    command = [str(build / "bin" / "zloam-calibrate"), str(session.log)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert yaml.safe_load(done.stdout)["motor"]["backward"] is False
    assert re.search(r"motor\.backward.*assumed", done.stdout), done.stdout


def test_a_calibration_assumes_the_offset_of_the_robots_file(build: Path) -> None:
    command = [str(build / "bin" / "zloam-calibrate"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    offset_us = yaml.safe_load(ROBOT.read_text())["driver"]["stamp_offset_us"]
    assert offset_us == -1e3 * simulated.RECEIVED_LATE_MS
    assert re.search(rf"--stamp-offset-us FLOAT\W*?{offset_us}\b", done.stdout), done.stdout


@pytest.mark.slow
def test_a_drive_with_its_own_calibration(build: Path, tmp_path: Path) -> None:
    still = simulated.at_rest(build, tmp_path / "still", "indoor", 7)
    command = [str(build / "bin" / "zloam-calibrate"), str(still.log)]
    mount = tmp_path / "mount.yaml"
    mount.write_bytes(subprocess.run(command, capture_output=True, check=True).stdout)
    where = ["--world", "indoor", "--seed", 4, "--speed-factor", 0.35, "--duration", SECONDS]
    drive = simulated.session(build, tmp_path / "drive", *where, *simulated.MOUNTED)
    out = tmp_path / "out"
    done = monitor(
        *("demo", "--preset-dir", build, "--session", drive.log, "--imu", drive.imu, "--out", out),
        *("--set", f"driver.metadata={mount}"),
    )
    assert done.code == 0, done.said
    found = trajectory.read(out / "trajectory.tum")
    ate_m = evaluation.evaluate(found, trajectory.read(drive.truth)).ate_rmse_m
    assert ate_m is not None
    assert ate_m <= 0.05


@pytest.fixture(scope="module")
def short(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Some seconds at rest: too few for a calibration."""
    where = ["--world", "indoor", "--seed", 7, "--still", "--duration", 5]
    return simulated.session(build, tmp_path_factory.mktemp("short") / "short", *where)


@pytest.mark.parametrize("later_s", [-3600, 3600])
def test_angles_of_another_time_are_named(
    build: Path, short: Session, tmp_path: Path, later_s: int
) -> None:
    other = tmp_path / "other.csv"
    head, *lines = short.angles.read_text().splitlines()
    rows = [line.split(",") for line in lines]
    moved = [f"{int(stamp_ns) + later_s * 10**9},{angle}" for stamp_ns, angle in rows]
    other.write_text("\n".join([head, *moved]) + "\n")
    code, found, said = calibrated(build, short.log, "--angles", other)
    assert code == 3, said
    assert not found
    assert "do not overlap in time" in said
    for path in (other, short.log):
        assert re.search(rf"{re.escape(str(path))} \(\d+\.\d+ to \d+\.\d+ s\)", said), said


def test_a_session_without_scans_is_named(build: Path, short: Session, tmp_path: Path) -> None:
    empty = tmp_path / "empty.logr"
    whole = short.log.read_bytes()
    # The reply to PP is the first record.
    empty.write_bytes(whole[: 12 + struct.unpack_from(">III", whole)[2]])
    assert b"\n99b\n" not in empty.read_bytes()
    code, _, said = calibrated(build, empty, "--angles", short.angles)
    assert code == 3, said
    assert f"{empty}: holds no usable scan" in said


def test_a_window_without_a_recorded_step_is_named(
    build: Path, short: Session, tmp_path: Path
) -> None:
    mount = tmp_path / "mount.yaml"
    mount.write_text("scanner: {from_deg: 136, to_deg: 170}\n")
    command = [str(build / "bin" / "zloam-calibrate"), str(short.log), "--mount", str(mount)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "no step of the recorded lines lies between scanner.from_deg" in done.stderr
    assert "# 0 % of the points" in done.stdout


@pytest.mark.parametrize(
    ("option", "value"),
    [("--seconds", "nan"), ("--seconds", "0"), ("--stamp-offset-us", "nan")],
)
def test_numbers_without_a_meaning_are_refused(
    build: Path, short: Session, option: str, value: str
) -> None:
    code, found, said = calibrated(build, short.log, option, value)
    assert code == 2, said
    assert not found
    assert option in said


def test_a_result_that_can_not_be_written_is_no_success(build: Path, short: Session) -> None:
    command = [str(build / "bin" / "zloam-calibrate"), str(short.log), "--seconds", "1"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert "can't be written" in done.stderr


def test_missing_files_of_a_calibration_are_named(
    build: Path, short: Session, tmp_path: Path
) -> None:
    missing, alone = tmp_path / "missing.logr", tmp_path / "alone.logr"
    code, _, said = calibrated(build, missing)
    assert code == 3, said
    assert f"{missing}: No such file" in said
    alone.write_bytes(short.log.read_bytes())
    code, _, said = calibrated(build, alone)
    assert code == 3, said
    assert "--angles" in said
    # A calibration refuses the profile that replaces angles in a drive.
    assert "motor.profile" not in said


def test_what_a_calibration_leaves_out_is_told(build: Path, short: Session, tmp_path: Path) -> None:
    cut, angles = tmp_path / "cut.logr", tmp_path / "cut.csv"
    whole = short.log.read_bytes()
    cut.write_bytes(whole[: len(whole) // 4])
    rows = short.angles.read_text().splitlines()
    angles.write_text("\n".join([*rows, rows[1], rows[2]]) + "\n")
    code, _, said = calibrated(build, cut)
    assert code in (0, 1), said
    assert f"{cut}: ends within a record" in said
    assert re.search(rf"{re.escape(str(angles))}: readings .* left out: 2\n", said), said


@pytest.mark.slow
def test_a_platform_that_moves_is_not_calibrated(build: Path, tmp_path: Path) -> None:
    where = ["--world", "indoor", "--seed", 4, "--speed-factor", 0.35, "--duration", SECONDS]
    drive = simulated.session(build, tmp_path / "drive", *where)
    command = [str(build / "bin" / "zloam-calibrate"), str(drive.log)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "move" in done.stderr
    # The file tells it as well.
    assert done.stdout.startswith("# NOT CALIBRATED: ")
    assert done.stdout.splitlines()[0].removeprefix("# NOT CALIBRATED: ") in done.stderr
