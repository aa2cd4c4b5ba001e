"""The simulator's packets, decoded by PyPI's velodyne-decoder.

The reference is the simulator's own list of returns, which is written before the packets are
encoded.
"""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

vd = pytest.importorskip("velodyne_decoder")

ROOT = Path(__file__).resolve().parents[2]
RINGS = {
    laser: ring for ring, laser in enumerate([0, 2, 4, 6, 8, 10, 12, 14, 1, 3, 5, 7, 9, 11, 13, 15])
}


def program() -> Path:
    build = Path(os.environ.get("ZLOAM_BUILD", ROOT / "build" / "release"))
    path = build / "bin" / "zloam-simulator"
    if not path.exists():
        pytest.skip(f"{path} is not built")
    return path


def simulate(folder: Path, *options: str) -> tuple[Path, dict[str, np.ndarray]]:
    pcap, returns = folder / "capture.pcap", folder / "returns.csv"
    command = [program(), "--quiet", "--out", pcap, "--returns", returns, *options]
    subprocess.run([str(part) for part in command], check=True, timeout=300)
    # Present-day Unix times in ns need 61 bits, so each column keeps its own type.
    kinds = {"t_ns": "i8", "azimuth_deg": "f8", "range_m": "f8"}
    header = returns.open().readline().strip().split(",")
    table = np.loadtxt(
        returns, delimiter=",", skiprows=1, dtype=[(n, kinds.get(n, "i4")) for n in header]
    )
    return pcap, {name: table[name] for name in header}


def decode(pcap: Path) -> tuple[np.ndarray, np.ndarray]:
    """All points of the capture, and their absolute times in seconds."""
    config = vd.Config(model=vd.Model.VLP16, min_range=0.1, timestamp_first_packet=True)
    points, times = [], []
    for stamp, cloud in vd.read_pcap(str(pcap), config, as_pcl_structs=True):
        points.append(cloud.copy())
        times.append(stamp.device + cloud["time"].astype(np.float64))
    return np.concatenate(points), np.concatenate(times)


@pytest.mark.parametrize(
    ("world", "epoch"),
    [("city", "2024-01-01T00:00:10"), ("handheld", "2024-06-01T11:59:58")],
    ids=["city", "handheld over the full hour"],
)
def test_single_return(tmp_path: Path, world: str, epoch: str) -> None:
    pcap, expected = simulate(tmp_path, "--world", world, "--duration", "2.5", "--epoch", epoch)
    points, times = decode(pcap)
    assert len(points) == len(expected["t_ns"]) > 50_000
    order = np.argsort(times, kind="stable")
    points, times = points[order], times[order]
    want = np.argsort(expected["t_ns"], kind="stable")
    # Tolerance: stamps are whole microseconds, times within a scan float32, their sums doubles in
    # steps of 240 ns.
    assert np.abs(times - expected["t_ns"][want] * 1e-9).max() < 1.6e-6
    assert (points["ring"] == [RINGS[laser] for laser in expected["laser"][want]]).all()
    assert (points["intensity"] == expected["reflectivity"][want]).all()
    # That decoder adds the vertical offset of the laser; subtract it by its own formula.
    elevation = np.radians(-15.0 + 2.0 * points["ring"])
    z = points["z"] - 0.04191 * np.tan(-elevation)
    measured = np.sqrt(points["x"] ** 2 + points["y"] ** 2 + z**2)
    assert np.abs(measured - expected["range_m"][want]).max() < 3e-4
    azimuth = np.degrees(np.arctan2(-points["y"], points["x"]))
    off = (azimuth - expected["azimuth_deg"][want] + 180.0) % 360.0 - 180.0
    assert np.abs(off).max() < 0.02  # both sides round to 0.01 degrees


def test_dual_return(tmp_path: Path) -> None:
    pcap, expected = simulate(tmp_path, "--world", "city", "--mode", "dual", "--duration", "2.5")
    points, times = decode(pcap)
    firings: dict[tuple[int, int], list[float]] = {}
    for t, block, r in zip(expected["t_ns"], expected["block"], expected["range_m"], strict=True):
        firings.setdefault(t, [0.0, 0.0])[block % 2] = r
    # Two equal returns of a firing are emitted once, different ones both.
    want = sorted((t, r) for t, pair in firings.items() for r in set(pair) if r > 0.0)
    doubles = sum(
        1 for last, strongest in firings.values() if last and strongest and last != strongest
    )
    assert doubles > 100
    assert len(points) == len(want)
    assert np.abs(np.sort(times) - np.array([t for t, _ in want]) * 1e-9).max() < 1.6e-6


def test_position_packets(tmp_path: Path) -> None:
    pcap, _ = simulate(
        tmp_path, "--world", "tunnel", "--duration", "2", "--epoch", "2024-02-29T23:59:59"
    )
    raw = pcap.read_bytes()
    at, data, positions = 24, 0, []
    while at < len(raw):
        size = int.from_bytes(raw[at + 8 : at + 12], "little")
        payload = raw[at + 16 + 42 : at + 16 + size]
        data += len(payload) == 1206
        if len(payload) == 512:
            positions.append(vd.TelemetryPacket(list(payload)))
        at += 16 + size
    assert data == 1507
    assert len(positions) == data // 14
    last = positions[-1]
    assert last.pps_status.value == 2  # locked
    assert abs(last.usec_since_toh * 1e-6 - (-1.0 + len(positions) * 14 * 1327.104e-6)) < 2e-6
    sentence = last.nmea_sentence
    assert sentence.startswith("$GPRMC,000000,A,")
    assert ",010324," in sentence
