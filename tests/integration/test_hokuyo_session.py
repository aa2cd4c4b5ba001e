"""A session recorded from a scanner by the example is one that the decoder reads."""

from __future__ import annotations

import json
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

from tests.hokuyo import peer
from tests.hokuyo.device import Device, SerialDevice, TcpDevice, answer, encoded, summed
from tests.integration.conftest import ROOT

EXAMPLE = ROOT / "services" / "monitor" / "examples" / "record_session.py"
PARAMETERS = (
    *("MODL:UTM-30LX-EW", "DMIN:23", "DMAX:60000", "ARES:1440"),
    *("AMIN:0", "AMAX:1080", "AFRT:540", "SCAN:2400"),
)
SCANS = 400


def scan(number: int) -> bytes:
    """All ranges 2 m, all intensities 100."""
    data = 1081 * (encoded(2000, 3) + encoded(100, 3))
    lines = [summed(encoded(1_000_000 + 25 * number, 4))]
    lines += [summed(data[at : at + 64]) for at in range(0, len(data), 64)]
    return answer(b"ME0000108001000", b"99", lines)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """What the simulated scanner sends."""
    told = [t.encode() + b";" + bytes([peer.checksum(t.encode())]) for t in PARAMETERS]
    path = tmp_path / "source.logr"
    with path.open("wb") as file:
        for number, data in enumerate([answer(b"PP", b"00", told), *map(scan, range(SCANS))]):
            milliseconds = 25 * number
            stamp = (1_700_000_000 + milliseconds // 1000, 1000 * (milliseconds % 1000))
            file.write(struct.pack(">III", *stamp, len(data)) + data)
    return path


@pytest.mark.parametrize("kind", [TcpDevice, SerialDevice])
def test_a_session_is_recorded(
    decode: Path, source: Path, tmp_path: Path, kind: type[TcpDevice] | type[SerialDevice]
) -> None:
    device, log = kind(source, 25e-3 * SCANS), tmp_path / "drive.logr"
    device.begin()
    command = [sys.executable, str(EXAMPLE), device.name, "2", str(log)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    device.close()
    assert done.returncode == 0, done.stderr
    told = subprocess.run(
        [str(decode), "--session", str(log)], capture_output=True, text=True, check=True
    )
    counts = json.loads(told.stdout)
    # Each scan that was received whole has its points.
    whole = sum(reply[0][:2] == b"ME" and len(reply) > 2 for reply in peer.replies(log)[:-1])
    assert counts["scans_read"] >= whole > 0
    assert counts["points"] == 1081 * counts["scans_read"]
    assert counts["scans_lost"] == 0


def record(device: Device, log: Path, seconds: str = "2") -> subprocess.CompletedProcess[str]:
    """Runs the example, and closes the device."""
    device.begin()
    command = [sys.executable, str(EXAMPLE), device.name, seconds, str(log)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    device.close()
    return done


def test_a_scanner_that_refuses_to_measure_leaves_no_session(tmp_path: Path, source: Path) -> None:
    device, log = TcpDevice(source, 1.0), tmp_path / "drive.logr"
    obey = device._answer

    def refuse(command: bytes) -> bytes:
        return answer(command, b"10") if command[:2] in (b"ME", b"MD") else obey(command)

    device._answer = refuse  # type: ignore[method-assign]
    done = record(device, log)
    assert done.returncode == 1
    assert "ME was answered with status 10, MD was answered with status 10" in done.stderr
    assert not log.exists()


def test_a_scanner_that_sends_no_scan_leaves_an_earlier_session(
    tmp_path: Path, source: Path
) -> None:
    device, log = TcpDevice(source, 1.0), tmp_path / "drive.logr"
    log.write_bytes(b"earlier")
    device.spoil = lambda number, data: b""
    done = record(device, log, "0.5")
    assert done.returncode == 1
    assert "no scan came" in done.stderr
    assert log.read_bytes() == b"earlier"


@pytest.mark.parametrize(("leaves", "code"), [(True, 0), (False, 1)])
def test_a_scanner_in_its_adjust_mode(
    tmp_path: Path, source: Path, leaves: bool, code: int
) -> None:
    device, log = TcpDevice(source, 5.0), tmp_path / "drive.logr"
    obey, adjusts = device._answer, True

    def adjust(command: bytes) -> bytes:
        nonlocal adjusts
        adjusts = adjusts and not (leaves and command == b"TM2")
        known = (b"QT", b"TM0", b"TM1", b"TM2")
        return answer(command, b"10") if adjusts and command not in known else obey(command)

    device._answer = adjust  # type: ignore[method-assign]
    done = record(device, log, "1")
    assert done.returncode == code, done.stderr
    assert log.exists() == leaves
    assert "Traceback" not in done.stderr
    if not leaves:
        assert "PP was answered with status 10" in done.stderr


def test_an_interrupt_ends_the_recording(tmp_path: Path, source: Path) -> None:
    device, log = TcpDevice(source, 25e-3 * SCANS), tmp_path / "drive.logr"
    device.begin()
    command = [sys.executable, str(EXAMPLE), device.name, "60", str(log)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as recorder:
        ends = time.monotonic() + 30.0
        # The first scan is whole when the bytes of two are there.
        while not (log.exists() and log.stat().st_size > 2 * len(scan(0))):
            if time.monotonic() > ends:
                recorder.kill()  # Otherwise its end would be waited for.
                pytest.fail(recorder.communicate()[1])
            time.sleep(0.1)
        recorder.send_signal(signal.SIGINT)
        _, said = recorder.communicate()
    while device.commands[-1] != b"QT" and time.monotonic() < ends:
        time.sleep(0.05)
    device.close()
    assert recorder.returncode == 0, said
    assert not said
    assert device.commands[-1] == b"QT"
    assert any(reply[0][:2] == b"ME" and len(reply) > 2 for reply in peer.replies(log))


def test_an_interrupt_before_the_first_scan_leaves_no_session(tmp_path: Path, source: Path) -> None:
    device, log = TcpDevice(source, 1.0), tmp_path / "drive.logr"
    device.spoil = lambda number, data: b""
    device.begin()
    command = [sys.executable, str(EXAMPLE), device.name, "60", str(log)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as recorder:
        ends = time.monotonic() + 30.0
        while not any(c.startswith(b"ME") for c in device.commands) and time.monotonic() < ends:
            time.sleep(0.05)
        recorder.send_signal(signal.SIGINT)
        _, said = recorder.communicate()
    device.close()
    assert recorder.returncode == 1
    assert "nothing is recorded" in said
    assert "Traceback" not in said
    assert not log.exists()


@pytest.mark.parametrize("seconds", ["nan", "0", "soon"])
def test_a_duration_that_is_none_is_refused(tmp_path: Path, source: Path, seconds: str) -> None:
    log = tmp_path / "drive.logr"
    done = record(TcpDevice(source, 1.0), log, seconds)
    assert done.returncode == 1
    assert seconds in done.stderr
    assert "Traceback" not in done.stderr
    assert not log.exists()


def test_a_device_that_is_not_there_is_named(tmp_path: Path) -> None:
    command = [sys.executable, str(EXAMPLE), "/dev/no-scanner", "2", str(tmp_path / "drive.logr")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "/dev/no-scanner" in done.stderr
    assert "Traceback" not in done.stderr


def test_nothing_of_an_earlier_programs_settings_is_left(source: Path, tmp_path: Path) -> None:
    device = SerialDevice(source, 25e-3 * SCANS)
    settings = termios.tcgetattr(device._slave)
    settings[0] |= termios.IXOFF | termios.IXANY | termios.INPCK
    settings[2] |= termios.CRTSCTS | termios.CSTOPB | termios.PARODD
    settings[2] &= ~termios.CLOCAL
    termios.tcsetattr(device._slave, termios.TCSANOW, settings)
    device.begin()
    command = [sys.executable, str(EXAMPLE), device.name, "0.5", str(tmp_path / "drive.logr")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    now = termios.tcgetattr(device._slave)
    device.close()
    assert done.returncode == 0, done.stderr
    assert not now[0] & (termios.IXOFF | termios.IXANY | termios.INPCK)
    assert not now[2] & (termios.CRTSCTS | termios.CSTOPB | termios.PARODD)
    assert now[2] & termios.CLOCAL


def test_a_scanner_that_does_not_answer_is_named(tmp_path: Path, source: Path) -> None:
    device = TcpDevice(source, 1.0)
    device._answer = lambda command: b""  # type: ignore[method-assign]
    command = [sys.executable, str(EXAMPLE), device.name, "2", str(tmp_path / "drive.logr")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    device.close()
    assert done.returncode == 1
    assert "no answer to QT" in done.stderr
