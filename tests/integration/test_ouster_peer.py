"""Ouster's packets against the manufacturer's own SDK (PyPI's ouster-sdk), point by point on
captures of five sensors and profiles."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests import ouster_peer
from tests.acceptance.point_files import DECODED_POINT

ROOT = Path(__file__).resolve().parents[2]
CAPTURES = (
    "OS-0-32-U1_v2.2.0_1024x10",  # two returns, 19 bits
    "OS-1-128_v2.3.0_1024x10_lb_n3",  # one return, 15 bits; three frames
    "OS-1-128_767798045_1024x10_20230712_120049",  # two returns, functional safety; 128 columns
    "OS-2-128-U1_v2.3.0_1024x10",  # one return, 19 bits
    "windowed_frame1",  # azimuth window
)
#: all profiles but FIVE_WORD_PIXEL, for which the SDK's frames have no ranges
PROFILES = (
    *("LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"),
    *("RNG19_RFL8_SIG16_NIR16_ZONE16", "RNG19_RFL8_SIG16_ZONE16_DUAL"),
    *("RNG19_RFL8_SIG16_NIR16_RGB16", "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL"),
    *("RNG15_RFL8_NIR8", "RNG15_RFL8_WIN8", "RNG15_RFL8_NIR8_ZONE16", "RNG15_RFL8_NIR8_DUAL"),
    "FUSA_RNG15_RFL8_NIR8_DUAL",
)
#: Our points have single precision: at 260 m neighbouring numbers are 0.03 mm apart.
TOLERANCE_M = 1e-4
#: azimuth at which frames begin
SEAM_DEG = 180


def decoded(tool: Path, tmp_path: Path, *arguments: object) -> tuple[np.ndarray, dict[str, float]]:
    out = tmp_path / "points.bin"
    command = [str(a) for a in (tool, *arguments, "--seam", SEAM_DEG, "--out", out)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert not done.stderr
    return np.fromfile(out, DECODED_POINT), json.loads(done.stdout)


def compare(own: np.ndarray, peer: dict[str, np.ndarray], most_m: float = TOLERANCE_M) -> None:
    assert len(own) == len(peer["ring"]) > 9000
    for field in ("time_ns", "ring", "column", "intensity", "return_type"):
        assert np.array_equal(own[field], peer[field]), field
    assert np.abs(own["xyz"] - peer["xyz"]).max() < most_m


@pytest.mark.parametrize("name", CAPTURES)
def test_point_by_point(decode: Path, shared: Path, tmp_path: Path, name: str) -> None:
    capture = shared / "data" / "ouster" / f"{name}.pcap"
    recording = ouster_peer.recorded(capture)
    bare = tmp_path / "bare.bin"
    bare.write_bytes(recording.payloads.tobytes())
    described = ("--metadata", ouster_peer.metadata_of(capture))
    # The packets as bare payloads, whose times come from the sensor alone.
    own, summary = decoded(decode, tmp_path, "--bin", bare, *described)
    assert summary["packets_decoded"] == len(recording.packets)
    assert summary["packets_lost"] == summary["blocks_bad"] == 0
    compare(own, ouster_peer.points(recording))
    # The capture itself gives the same points, at the capture's times.
    captured, _ = decoded(decode, tmp_path, "--pcap", capture)
    assert np.array_equal(captured["xyz"], own["xyz"])
    later = captured["time_ns"] - own["time_ns"]
    assert np.array_equal(later, np.full(len(own), later[0]))


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("sensor", ["OS-0-32-U1_v2.2.0_1024x10", "OS-2-128-U1_v2.3.0_1024x10"])
def test_every_profile_as_the_sdk_writes_it(
    decode: Path, shared: Path, tmp_path: Path, sensor: str, profile: str
) -> None:
    described = shared / "data" / "ouster" / f"{sensor}.json"
    recording = ouster_peer.written(described, profile, seed=3)
    bare, metadata = tmp_path / "bare.bin", tmp_path / "os.json"
    bare.write_bytes(recording.payloads.tobytes())
    metadata.write_text(recording.info.to_json_string())
    limits = ("--metadata", metadata)
    own, summary = decoded(decode, tmp_path, "--bin", bare, *limits)
    assert summary["packets_decoded"] == len(recording.packets)
    compare(own, ouster_peer.points(recording), most_m=2e-7 * own["xyz"].max() + TOLERANCE_M)


def test_every_frame_is_a_sweep(decode: Path, shared: Path, tmp_path: Path) -> None:
    """A frame begins behind the seam at the rear, whatever part of the revolution the azimuth
    window covers."""
    for name, times in (("OS-1-128_v2.3.0_1024x10_lb_n3", 4), ("windowed_frame1", 12)):
        capture = shared / "data" / "ouster" / f"{name}.pcap"
        recording = ouster_peer.recorded(capture)
        bare = tmp_path / "bare.bin"
        bare.write_bytes(ouster_peer.repeated(recording, times).tobytes())
        described = ("--metadata", ouster_peer.metadata_of(capture))
        own, summary = decoded(decode, tmp_path, "--bin", bare, *described)
        assert summary["sweeps"] == 12
        assert summary["complete"] == 10  # the first and the last are partial
        assert summary["packets_lost"] == 0
        assert own["column"].max() < recording.info.format.columns_per_frame


def test_a_lost_packet_is_counted(decode: Path, shared: Path, tmp_path: Path) -> None:
    for name, times in (("OS-1-128_v2.3.0_1024x10_lb_n3", 1), ("windowed_frame1", 3)):
        capture = shared / "data" / "ouster" / f"{name}.pcap"
        packets = ouster_peer.repeated(ouster_peer.recorded(capture), times)
        bare = tmp_path / "bare.bin"
        bare.write_bytes(np.delete(packets, [5, 6, 30], axis=0).tobytes())
        described = ("--metadata", ouster_peer.metadata_of(capture))
        _, summary = decoded(decode, tmp_path, "--bin", bare, *described)
        assert summary["packets_lost"] == 3


@pytest.mark.parametrize("name", CAPTURES)
def test_imu_readings(decode: Path, shared: Path, tmp_path: Path, name: str) -> None:
    """IMU readings agree with the SDK's (m/s², rad/s); their times are on the points' clock."""
    capture = shared / "data" / "ouster" / f"{name}.pcap"
    recording = ouster_peer.recorded(capture)
    table = tmp_path / "imu.csv"
    own, _ = decoded(decode, tmp_path, "--pcap", capture, "--imu-out", table)
    readings = np.loadtxt(table, delimiter=",", skiprows=1, ndmin=2)
    # Readings before the first data packet are dropped: their time is not known yet.
    theirs = recording.imu[-len(readings) :]
    assert len(readings) >= len(recording.imu) - 2
    middle_ns = [(p.accel_ts() + p.gyro_ts()) // 2 for p in theirs]
    stamps = [int(line.split(",")[0]) for line in table.read_text().splitlines()[1:]]
    first_ns = int(ouster_peer.points(recording)["time_ns"][0])
    offset_ns = int(own["time_ns"][0]) - first_ns
    assert stamps == [ns % ouster_peer.HOUR_NS + offset_ns for ns in middle_ns]
    gyro = np.concatenate([p.gyro() for p in theirs])
    accel = np.concatenate([p.accel() for p in theirs])
    assert np.allclose(readings[:, 1:4], gyro, rtol=1e-5, atol=1e-7)
    assert np.allclose(readings[:, 4:7], accel, rtol=1e-5, atol=1e-6)


def test_what_lacks_is_said(decode: Path, shared: Path, tmp_path: Path) -> None:
    capture = tmp_path / "drive.pcap"
    original = shared / "data" / "ouster" / "OS-1-128_v2.3.0_1024x10_lb_n3.pcap"
    capture.symlink_to(original)
    command = [str(decode), "--pcap", str(capture)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "driver.metadata" in done.stderr
    assert "drive.json" in done.stderr
    assert json.loads(done.stdout)["packets_unknown_model"] == 192
    other = shared / "data" / "ouster" / "OS-2-128-U1_v2.3.0_1024x10.json"
    done = subprocess.run(
        [*command, "--metadata", str(other)], capture_output=True, text=True, check=True
    )
    assert "8448 bytes come, the metadata say RNG19_RFL8_SIG16_NIR16" in done.stderr
    wrong = tmp_path / "wrong.json"
    wrong.write_text("{}")
    done = subprocess.run(
        [*command, "--metadata", str(wrong)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 3
    assert "wrong.json" in done.stderr
