"""The decoder against an independent one (velodyne-decoder), point by point on real recordings."""

from __future__ import annotations

import json
import subprocess
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.acceptance.point_files import DECODED_POINT

ROOT = Path(__file__).resolve().parents[2]
PACKET_BYTES = 1206
#: return types of the other decoder (1 strongest, 2 last, 3 both) -> ours
RETURN_TYPES = {1: 0, 2: 1, 3: 2}


def decoded(tool: Path, tmp_path: Path, *arguments: object) -> tuple[np.ndarray, dict[str, float]]:
    """Points and summary of zloam-decode."""
    out = tmp_path / "points.bin"
    command = [str(a) for a in (tool, *arguments, "--out", out)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return np.fromfile(out, DECODED_POINT), json.loads(done.stdout)


def pcap_payloads(path: Path) -> bytes:
    """Payloads of an Ethernet capture without VLAN tags, read independently of our reader."""
    data, at, payloads = path.read_bytes(), 24, []
    while at + 16 <= len(data):
        size = int.from_bytes(data[at + 8 : at + 12], "little")
        if size == 42 + PACKET_BYTES:
            payloads.append(data[at + 16 + 42 : at + 16 + size])
        at += 16 + size
    return b"".join(payloads)


def peer_points(raw: bytes, model: str) -> dict[str, np.ndarray]:
    """All points of the other decoder, times in ns of the sensor's hour."""
    vd = pytest.importorskip("velodyne_decoder")
    config = vd.Config(
        model=getattr(vd.Model, model), min_range=0, max_range=1000, timestamp_first_packet=True
    )
    stream = vd.StreamDecoder(config)
    scans = []
    for i in range(len(raw) // PACKET_BYTES):
        packet = list(raw[i * PACKET_BYTES : (i + 1) * PACKET_BYTES])
        scans.append(stream.decode(1e6 + i * 1e-3, packet))
    scans.append(stream.finish())
    found = [s for s in scans if s is not None]
    table = np.concatenate([points for _, points in found])
    start_us = np.concatenate(
        [np.full(len(points), round(stamp.device * 1e6) % 3_600_000_000) for stamp, points in found]
    )
    names = ("x", "y", "z", "intensity", "time", "column", "ring", "return_type")
    columns = {name: table[:, i] for i, name in enumerate(names)}
    columns["time_ns"] = start_us * 1e3 + columns["time"].astype(float) * 1e9
    return columns


def bytes_set(raw: bytes, offset: int, value: int) -> bytes:
    """The same packets with this byte replaced in each."""
    changed = bytearray(raw)
    changed[offset::PACKET_BYTES] = bytes([value]) * (len(raw) // PACKET_BYTES)
    return bytes(changed)


def compare(own: np.ndarray, peer: dict[str, np.ndarray], raw: bytes) -> None:
    """Checks that the points agree: number, ring, return type, intensity, time to 1 us, position to
    2 mm plus the azimuth's rounding."""
    assert len(own) == len(peer["x"])
    start_ns = int.from_bytes(raw[1200:1204], "little") * 1e3
    own_ns, peer_ns = own["time_ns"] - start_ns, peer["time_ns"] - start_ns
    peer_type = np.vectorize(RETURN_TYPES.get)(peer["return_type"].astype(int))
    if raw[1204] == 0x39:
        # The other decoder gives one block after the other, so all last returns come first. Points
        # of the same instant and ring are distinguished by the return type.
        order = np.lexsort((own["return_type"], own["ring"], np.round(own_ns / 1000)))
        own, own_ns = own[order], own_ns[order]
        order = np.lexsort((peer_type, peer["ring"], np.round(peer_ns / 1000)))
        peer = {name: column[order] for name, column in peer.items()}
        peer_ns, peer_type = peer_ns[order], peer_type[order]
    assert np.array_equal(own["ring"], peer["ring"].astype(int))
    assert np.array_equal(own["return_type"], peer_type)
    assert np.array_equal(own["intensity"], peer["intensity"])
    expect_times(own_ns, peer_ns, raw, start_ns)
    ours = own["xyz"].astype(float)
    theirs = np.stack([peer[a] for a in "xyz"], axis=1).astype(float)
    distance = np.linalg.norm(ours - theirs, axis=1)
    # The other decoder rounds the azimuth to 0.01 degrees.
    allowed = 0.002 + 8.73e-5 * np.linalg.norm(theirs, axis=1)
    beyond = distance > allowed
    # A restricted field of view leaves a gap in the azimuths, and in a packet that contains the gap
    # the other decoder's azimuth rate is wrong.
    assert not beyond[~in_packets_with_gap(peer_ns, raw, start_ns)].any()


def packets_with_gap(raw: bytes) -> np.ndarray:
    """Numbers of the packets within which the azimuth jumps by more than 10 degrees."""
    blocks = np.frombuffer(raw, np.uint8).reshape(-1, PACKET_BYTES)[:, :1200].reshape(-1, 12, 100)
    azimuth = blocks[:, :, 2].astype(int) + 256 * blocks[:, :, 3].astype(int)
    return np.nonzero(((np.diff(azimuth, axis=1) % 36000) > 1000).any(axis=1))[0]


def stamps_ns(raw: bytes, start_ns: float) -> np.ndarray:
    """Stamps of all packets relative to the first one."""
    tails = np.frombuffer(raw, np.uint8).reshape(-1, PACKET_BYTES)[:, 1200:1204]
    return np.ascontiguousarray(tails).view("<u4")[:, 0] * 1e3 - start_ns


def in_packets_with_gap(times_ns: np.ndarray, raw: bytes, start_ns: float) -> np.ndarray:
    """Mask of the points whose packet contains the gap of a restricted field of view."""
    packet = np.searchsorted(stamps_ns(raw, start_ns), times_ns + 500, side="right") - 1
    return np.isin(packet, packets_with_gap(raw))


def expect_times(own_ns: np.ndarray, peer_ns: np.ndarray, raw: bytes, start_ns: float) -> None:
    """Times agree to 1 us, except behind the gap of a restricted field of view: the other decoder
    ignores the time in which the sensor rotated through the gap, though the stamp of the next
    packet proves it. That time is known to a firing or two."""
    difference = np.abs(own_ns - peer_ns)
    in_gap = in_packets_with_gap(peer_ns, raw, start_ns)
    after_gap = in_packets_with_gap(peer_ns - 0.7e6, raw, start_ns) & ~in_gap
    assert difference[~in_gap & ~after_gap].max() < 1000
    assert not after_gap.any() or difference[after_gap].max() < 100_000
    late = in_gap & (difference >= 1000)
    stamps = stamps_ns(raw, start_ns)
    following = stamps[np.minimum(np.searchsorted(stamps, own_ns[late]), len(stamps) - 1)]
    assert ((following - own_ns[late]) < 1_000_000).all()


@pytest.mark.parametrize(
    ("file", "model", "expected"),
    [
        ("vlp16_single/packets.bin", "VLP16", 203_034),
        ("vlp16_dual/packets.bin", "VLP16", 59_414),
        ("vlp32c/packets.bin", "VLP32C", None),
    ],
)
def test_bare_packets(
    decode: Path, shared: Path, tmp_path: Path, file: str, model: str, expected: Any
) -> None:
    raw = (shared / "data" / file).read_bytes()
    own, summary = decoded(decode, tmp_path, "--bin", shared / "data" / file)
    assert summary["packets_decoded"] == len(raw) // PACKET_BYTES
    if expected is not None:
        assert len(own) == expected
    compare(own, peer_points(raw, model), raw)


#: VLS-128: a packet has three sequences of twenty slots; its first firing precedes the stamp. The
#: other decoder takes one firmware's slot length in the first packet and another firmware's in all
#: later ones.
VLS128_SLOTS, VLS128_FIRST_NS = 20, -7000.0
VLS128_PEER_SLOT_NS = (2890.0, 8000.0 / 3)


def by_ring_and_time(ring: np.ndarray, time_ns: np.ndarray, xyz: list[np.ndarray]) -> np.ndarray:
    """x, y, z and time, in an order that is the same for both decoders."""
    order = np.lexsort((time_ns, ring))
    return np.stack([*xyz, time_ns], axis=1).astype(float)[order]


def azimuth_deg(points: np.ndarray) -> np.ndarray:
    """Azimuth, clockwise from the front."""
    return np.degrees(np.arctan2(-points[:, 1], points[:, 0]))


def test_vls128(decode: Path, shared: Path, tmp_path: Path) -> None:
    """Asserts the two known differences of the other decoder. It takes published slot lengths,
    where the recording's stamps show another one. In the first packet it gives all points of a
    sequence the azimuth at the sequence's beginning."""
    file = shared / "data" / "vls128" / "packets.bin"
    raw = file.read_bytes()
    own, _ = decoded(decode, tmp_path, "--bin", file)
    peer = peer_points(raw, "VLS128")
    assert len(own) == len(peer["x"]) == 765_932
    start_ns = int.from_bytes(raw[1200:1204], "little") * 1e3
    ours = by_ring_and_time(own["ring"], own["time_ns"] - start_ns, list(own["xyz"].T))
    theirs = by_ring_and_time(peer["ring"], peer["time_ns"] - start_ns, [peer[a] for a in "xyz"])
    assert np.array_equal(np.sort(own["ring"]), np.sort(peer["ring"].astype(int)))

    stamps = stamps_ns(raw, start_ns)
    slot_ns = np.diff(stamps).mean() / (3 * VLS128_SLOTS)
    # The first firing of a packet precedes its stamp by 7 us.
    packet = np.searchsorted(stamps + VLS128_FIRST_NS + 250, theirs[:, 3], side="right") - 1
    packet = np.maximum(packet, 0)
    first = packet == 0
    peer_slot_ns = np.where(first, *VLS128_PEER_SLOT_NS)
    peer_first_ns = VLS128_FIRST_NS * peer_slot_ns / VLS128_PEER_SLOT_NS[0]
    peer_slots = (theirs[:, 3] - stamps[packet] - peer_first_ns) / peer_slot_ns
    slot = np.round(peer_slots)
    assert np.abs(peer_slots - slot).max() < 0.02
    assert np.abs(ours[:, 3] - stamps[packet] - VLS128_FIRST_NS - slot * slot_ns).max() < 1000

    distance = np.linalg.norm(ours[:, :3] - theirs[:, :3], axis=1)
    allowed = 0.002 + 8.73e-5 * np.linalg.norm(theirs[:, :3], axis=1)
    assert (distance[~first] <= allowed[~first]).all()
    # The blocks' azimuths advance by 0.2 degrees from one sequence to the next.
    turned_deg = 0.2 * (slot[first] % VLS128_SLOTS) / VLS128_SLOTS
    ahead_deg = azimuth_deg(ours[first]) - azimuth_deg(theirs[first])
    assert np.abs((ahead_deg + 180) % 360 - 180 - turned_deg).max() < 0.0055


@pytest.mark.parametrize(
    ("file", "own_model", "peer_model", "product"),
    [
        # A VLP-16's timing with an HDL-32E's product byte, which the other decoder refuses.
        ("vlp16_mislabelled/capture.pcap", "vlp16", "VLP16", 0x22),
        ("hdl32e_gnss/capture.pcap", "hdl32e", "HDL32E", 0x21),
    ],
)
def test_captures(
    decode: Path,
    shared: Path,
    tmp_path: Path,
    file: str,
    own_model: str,
    peer_model: str,
    product: Any,
) -> None:
    capture = shared / "data" / file
    raw = bytes_set(pcap_payloads(capture), 1205, product)
    _, summary = decoded(decode, tmp_path, "--pcap", capture, "--model", own_model)
    assert summary["packets_decoded"] == len(raw) // PACKET_BYTES
    # The same packets as bare payloads, whose times come from the sensor alone.
    bare = tmp_path / "bare.bin"
    bare.write_bytes(raw)
    own, _ = decoded(decode, tmp_path, "--bin", bare, "--model", own_model)
    compare(own, peer_points(raw, peer_model), raw)


def test_a_mislabelled_capture_is_named(decode: Path, shared: Path, tmp_path: Path) -> None:
    capture = shared / "data" / "vlp16_mislabelled" / "capture.pcap"
    command = [str(decode), "--pcap", str(capture), "--model", "vlp16"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "HDL-32E" in done.stderr
    summary = json.loads(done.stdout)
    assert summary["packets_lost"] == 0
    assert summary["complete"] == summary["sweeps"] - 2  # the first and the last are partial


def test_rings_of_a_real_drive(decode: Path, shared: Path, tmp_path: Path) -> None:
    """KITTI's files have no rings; they are found from the order of the points."""
    with tarfile.open(shared / "data" / "hdl64e_drive" / "velodyne.tar.xz") as tar:
        names = sorted(n for n in tar.getnames() if n.endswith(".bin"))[:10]
        tar.extractall(tmp_path, members=[tar.getmember(n) for n in names], filter="data")
    own, summary = decoded(decode, tmp_path, "--kitti", tmp_path)
    assert summary["sweeps"] == len(names)
    for sweep in np.unique(own["sweep"]):
        scan = own[own["sweep"] == sweep]
        assert np.array_equal(np.unique(scan["ring"]), np.arange(64))
        x, y, z = scan["xyz"].T
        elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
        mean = np.array([np.median(elevation[scan["ring"] == r]) for r in range(64)])
        assert (np.diff(mean) > 0).all()
        assert (np.diff(scan["time_ns"]) >= 0).all()
        assert scan["time_ns"][-1] - scan["time_ns"][0] < 100_000_000
        # The sensor rotates clockwise from the rear, so the left side comes before the right one.
        early = scan["time_ns"] < scan["time_ns"][0] + 45_000_000
        assert (y[early] > 0).mean() > 0.95


def hdl64e_calibration(seed: int) -> str:
    """A calibration file in which each laser has values of its own, as in a real unit's."""
    random = np.random.default_rng(seed)
    lines = ["num_lasers: 64", "distance_resolution: 0.002", "lasers:"]
    for laser in range(64):
        far = random.uniform(0.9, 1.5)
        values = {
            "laser_id": laser,
            "rot_correction": random.uniform(-0.15, 0.15),
            "vert_correction": 0.035 - 0.0073 * laser + random.uniform(-0.001, 0.001),
            "dist_correction": far,
            "dist_correction_x": far + random.uniform(-0.03, 0.03),
            "dist_correction_y": far + random.uniform(-0.03, 0.03),
            "vert_offset_correction": random.uniform(0.17, 0.22),
            "horiz_offset_correction": 0.026 * (-1) ** laser,
            "focal_distance": random.uniform(8.0, 25.0),
            "focal_slope": random.uniform(0.5, 2.0),
            "min_intensity": 0,
            "max_intensity": 255,
            "two_pt_correction_available": "true",
        }
        lines.append("- {" + ", ".join(f"{k}: {v}" for k, v in values.items()) + "}")
    return "\n".join(lines) + "\n"


def hdl64e_packets(seed: int, dual: bool, count: int = 400) -> bytes:
    """Random returns of a rotating sensor; `dual`: two returns per firing."""
    random = np.random.default_rng(seed)
    blocks = 4 if dual else 2
    out = bytearray()
    for packet in range(count):
        for block in range(12):
            group = packet * (12 // blocks) + block // blocks
            out += (0xDDFF if block % 2 else 0xEEFF).to_bytes(2, "little")
            out += (group * 18 % 36000).to_bytes(2, "little")
            for _ in range(32):
                raw = int(random.integers(400, 60_000)) if random.random() < 0.8 else 0
                out += raw.to_bytes(2, "little") + bytes([int(random.integers(0, 256))])
        stamp = 1_000_000 + round(packet * (172.8 if dual else 288.0))
        out += stamp.to_bytes(4, "little") + b"H\x0c"
    return bytes(out)


@pytest.mark.parametrize(
    ("ours", "theirs", "dual"),
    [("HDL-64E S2", "HDL64E_S2", False), ("HDL-64E S3", "HDL64E_S3", True)],
)
def test_an_hdl64e_with_its_calibration(
    decode: Path, tmp_path: Path, ours: str, theirs: str, dual: bool
) -> None:
    """The other decoder's stamps refer to another event, so times agree up to a constant. For the
    height it uses the mean of the corrections of x and y, where the manual prescribes that of y."""
    vd = pytest.importorskip("velodyne_decoder")
    text, raw = hdl64e_calibration(5), hdl64e_packets(6, dual)
    (tmp_path / "unit.yaml").write_text(text)
    (tmp_path / "packets.bin").write_bytes(raw)
    points, _ = decoded(
        decode, tmp_path, "--bin", tmp_path / "packets.bin", "--model", ours,
        "--metadata", tmp_path / "unit.yaml",
    )  # fmt: skip
    config = vd.Config(
        model=getattr(vd.Model, theirs), calibration=vd.Calibration.from_string(text),
        min_range=0, max_range=1000, timestamp_first_packet=True,
    )  # fmt: skip
    stream = vd.StreamDecoder(config)
    size, scans = PACKET_BYTES, []
    for at in range(0, len(raw), size):
        scans.append(stream.decode(1e6 + at * 1e-6, list(raw[at : at + size])))
    scans.append(stream.finish())
    peer = np.concatenate([table for _, table in (s for s in scans if s is not None)])
    assert len(peer) == len(points) > 100_000
    # Order: by laser, then time, then (for two returns of a firing) distance.
    xyz = points["xyz"].astype(float)
    away = np.linalg.norm(xyz, axis=1)
    order = np.lexsort((away, np.round(points["time_ns"] / 1000), points["ring"]))
    mine, xyz = points[order], xyz[order]
    start = np.concatenate([np.full(len(s[1]), s[0].device) for s in scans if s is not None])
    time_s = peer[:, 4].astype(float) + start
    away = np.linalg.norm(peer[:, :3], axis=1)
    order = np.lexsort((away, np.round(time_s * 1e6), peer[:, 6]))
    peer, time_s, away = peer[order], time_s[order], away[order]
    assert (mine["ring"] == peer[:, 6]).all()
    assert (np.abs(xyz[:, :2] - peer[:, :2]).max(axis=1) < 9e-5 * away + 5e-4).all()
    # The heights differ by half the difference of the corrections of x and y, at most along the
    # steepest laser; far away, the two corrections are equal.
    above = np.abs(xyz[:, 2] - peer[:, 2])
    assert above.max() < 0.5 * 0.06 * np.sin(0.46)
    assert above[away > 30.0].max() < 1e-4
    # Two returns of a firing at nearly the same distance may be swapped. Two at exactly the same
    # distance are one return, for which we give the intensity of the last one.
    near = np.abs(np.diff(away)) < 0.002
    alone = ~(np.append(near, False) | np.insert(near, 0, False))
    alone &= mine["return_type"] != 2
    assert alone.mean() > 0.99
    assert np.abs(mine["intensity"] - peer[:, 3])[alone].max() < 0.01
    assert np.ptp(mine["time_ns"] * 1e-9 - time_s) < 3e-6
