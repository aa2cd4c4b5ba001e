"""A Hesai capture through the real processes. The simulator's VLP-16 has the beams of a
PandarXT-16; its firings are written as packets of that sensor here, by the tables of the manual and
independently of the decoder."""

from __future__ import annotations

import datetime
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dpkt
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.integration.conftest import Capture, monitor, simulate

DATA_BYTES = 1206
SEQUENCE_US = 55.296
BLOCKS, LASERS = 8, 16
#: VLP-16: elevation of each laser; lasers from the uppermost down; time of each firing after the
#: beginning of its sequence
ELEVATION_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15])
LASER_OF_CHANNEL = np.argsort(-ELEVATION_DEG)
VLP_FIRING_US = 2.304 * LASER_OF_CHANNEL
#: PandarXT-16: time of each channel's firing after the first one
XT_FIRING_US = 2 * 1.512 * np.arange(LASERS)
RATE_DEG_PER_US = 360.0 * 10.0 / 1e6
HESAI_EPOCH = 1900


def firings(pcap: Path) -> Iterator[tuple[float, float, NDArray[Any]]]:
    """For each firing sequence: Unix time (s), azimuth (degrees), and by channel the distances (2
    mm) and reflectivities."""
    with pcap.open("rb") as file:
        for sent_s, frame in dpkt.pcap.Reader(file):
            data = bytes(dpkt.ethernet.Ethernet(frame).data.data.data)
            if len(data) != DATA_BYTES:
                continue
            of_hour_s = struct.unpack_from("<I", data, 1200)[0] * 1e-6
            hour_s = float(sent_s) // 3600 * 3600
            for block in range(12):
                azimuth = struct.unpack_from("<H", data, 100 * block + 2)[0] / 100
                returns = np.frombuffer(
                    data, np.dtype([("raw", "<u2"), ("reflectivity", "u1")]), 32, 100 * block + 4
                )
                for half in range(2):
                    number = 2 * block + half
                    yield (
                        hour_s + of_hour_s + number * SEQUENCE_US * 1e-6,
                        azimuth + half * SEQUENCE_US * RATE_DEG_PER_US,
                        returns[16 * half : 16 * half + 16][LASER_OF_CHANNEL],
                    )


def packet(group: list[tuple[float, float, NDArray[Any]]], number: int) -> bytes:
    """A PandarXT-16 data packet with eight firings."""
    body = b"".join(
        struct.pack("<H", round(100 * azimuth) % 36000)
        + b"".join(
            # from units of 2 mm to units of 4 mm
            struct.pack("<HBx", (int(cell["raw"]) + 1) // 2, cell["reflectivity"])
            for cell in returns
        )
        for _, azimuth, returns in group
    )
    # The packet's stamp is the instant of the firing command of the last block, which precedes its
    # first firing by 6 us.
    stamp_s = group[-1][0] - 6.0e-6
    at = datetime.datetime.fromtimestamp(stamp_s, datetime.UTC)
    date = bytes((at.year - HESAI_EPOCH, at.month, at.day, at.hour, at.minute, at.second))
    header = bytes((0xEE, 0xFF, 6, 1, 0, 0, LASERS, BLOCKS, 0, 4, 1, 1))
    tail = bytes(10) + struct.pack("<BH", 0x37, 600) + date + struct.pack("<IB", at.microsecond, 66)
    return header + body + tail + struct.pack("<I", number)


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A simulated drive at constant motor speed, since angles are computed from times here."""
    folder = tmp_path_factory.mktemp("hesai")
    options = ("--world", "city", "--seed", "3", "--duration", "6", "--speed-deviation", "0")
    made = simulate(build, folder, *options)
    with (folder / "hesai.pcap").open("wb") as file:
        writer = dpkt.pcap.Writer(file, nano=True)
        group: list[tuple[float, float, NDArray[Any]]] = []
        number = 0
        for firing in firings(made.pcap):
            group.append(firing)
            if len(group) < BLOCKS:
                continue
            udp = dpkt.udp.UDP(sport=10000, dport=2368, data=packet(group, number))
            udp.ulen = len(udp)
            ip = dpkt.ip.IP(
                src=bytes((192, 168, 1, 201)), dst=b"\xff" * 4, p=dpkt.ip.IP_PROTO_UDP, data=udp
            )
            ip.len = len(ip)
            writer.writepkt(bytes(dpkt.ethernet.Ethernet(data=ip)), group[-1][0] + 1e-4)
            group, number = [], number + 1
    # Azimuth offset of each channel: the lasers fired in the VLP-16's order, but the decoder
    # corrects for the PandarXT's firing times, at the rotation rate that blocks 50 us apart imply.
    decoder_rate = RATE_DEG_PER_US * SEQUENCE_US / 50.0
    offsets = RATE_DEG_PER_US * VLP_FIRING_US - decoder_rate * XT_FIRING_US
    rows = [f"{i + 1},{15 - 2 * i},{offset:.4f}" for i, offset in enumerate(offsets)]
    (folder / "angles.csv").write_text("\n".join(("Laser id,Elevation,Azimuth", *rows)) + "\n")
    return made


def ate_m(build: Path, out: Path, pcap: Path, truth: Path, *settings: str) -> tuple[float, Any]:
    arguments = [word for setting in settings for word in ("--set", setting)]
    done = monitor(
        "demo", "--preset-dir", build, "--pcap", pcap, "--truth", truth, "--out", out, *arguments
    )
    assert done.code == 0, done.said
    report = json.loads((out / "report.json").read_text())
    return report["ate_rmse_m"]["pose"], report


@pytest.mark.slow
def test_the_trajectory_is_as_good_as_the_other_sensors(
    build: Path, drive: Capture, tmp_path: Path
) -> None:
    velodyne, _ = ate_m(build, tmp_path / "velodyne", drive.pcap, drive.truth_lidar)
    folder = drive.pcap.parent
    hesai, report = ate_m(
        build, tmp_path / "hesai", folder / "hesai.pcap", drive.truth_lidar,
        f"driver.metadata={folder / 'angles.csv'}",
    )  # fmt: skip
    # The tolerance: distances are rounded to 4 mm, and all lasers are taken to fire from one point.
    assert hesai < 1.5 * velodyne + 0.005, (hesai, velodyne)
    assert report["sweeps"]["driver"]["lost"] == 0
    assert 60 <= report["identities"]["poses"] <= 62
