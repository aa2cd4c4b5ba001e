"""Compares the points of the chain's sweeps with those of PyPI's velodyne-decoder, point by
point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import velodyne_decoder
from numpy.typing import NDArray

from tests.acceptance.runs import ROOT, Setting, ended_well, own_outputs
from zloam_monitor import messages, sources
from zloam_monitor.chain import Chain
from zloam_monitor.robot_file import names
from zloam_monitor.sources import Source

#: byte of a data packet that names the product, and its value for the VLP-16
PRODUCT_BYTE, VLP16 = 1205, 0x22
PACKET_BYTES = 1206
#: Azimuths have units of 0.01 degrees; each of the two decoders may round by half a unit.
AZIMUTH_ROUNDING_RAD = np.radians(0.01)
LIMIT_M = 0.002


@dataclass(frozen=True)
class Sweeps:
    """The driver's output on a recording."""

    points: NDArray[Any]  # POINT, in the order of sweeps
    published: int
    received: int
    poses: int


def through_the_chain(setting: Setting, source: Source, name: str) -> Sweeps:
    """Replays a recording and receives the sweeps as any third party could."""
    config = ROOT / source.config
    robot = names(config, [])
    out = setting.out / "accept" / name
    settings = [*source.driver_settings("max"), *own_outputs(out)]
    chain = Chain(setting.build, config, robot.robot, settings, out / "logs", robot.sensor)
    kept: dict[int, NDArray[Any]] = {}

    def keep(sample: Any) -> None:
        sweep = messages.decode("Sweep", sample.payload.to_bytes())
        points = messages.struct_vector(sweep, "Points", messages.POINT).copy()
        kept.setdefault(int(sweep.Header().Sweep()), points)

    listener = chain.link.session.declare_subscriber(chain.link.keys.sweep, keep)
    with chain:
        chain.wait_ready()
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
        chain.link.query_statuses()
        ended_well(chain)
        driver = chain.link.stage("driver")
        poses = chain.link.trajectory()
        listener.undeclare()
    assert driver is not None
    published = driver.published[chain.link.keys.sweep]
    points = np.concatenate([kept[n] for n in sorted(kept)])
    return Sweeps(points, published, len(kept), len(poses))


def payloads_of_pcap(path: Path, product: int) -> Iterator[bytes]:
    """Data packets of a capture, with the product byte replaced in memory."""
    for _, payload in udp_payloads(path):
        if len(payload) == PACKET_BYTES:
            yield payload[:PRODUCT_BYTE] + bytes([product]) + payload[PRODUCT_BYTE + 1 :]


def udp_payloads(path: Path) -> Iterator[tuple[float, bytes]]:
    """(capture time in s, payload) of each UDP datagram of a classic pcap over Ethernet."""
    import dpkt

    with path.open("rb") as file:
        for stamp, frame in dpkt.pcap.Reader(file):
            packet = dpkt.ethernet.Ethernet(frame).data
            if isinstance(packet, dpkt.ip.IP) and isinstance(packet.data, dpkt.udp.UDP):
                yield float(stamp), bytes(packet.data.data)


def by_velodyne_decoder(payloads: Iterator[bytes]) -> NDArray[Any]:
    """All points that velodyne-decoder decodes from these packets."""
    config = velodyne_decoder.Config(
        model=velodyne_decoder.Model.VLP16, min_range=0, max_range=1000, cut_angle=None
    )
    decoder = velodyne_decoder.StreamDecoder(config)
    scans = []
    for n, payload in enumerate(payloads):
        found = decoder.decode(n * 1e-3, list(payload), as_pcl_structs=True)
        if found is not None:
            scans.append(np.array(found[1]))
    last = decoder.finish(as_pcl_structs=True)
    if last is not None:
        scans.append(np.array(last[1]))
    return np.concatenate(scans)


def stored(path: Path) -> NDArray[Any]:
    """velodyne-decoder's result, stored beside a recording."""
    with np.load(path, allow_pickle=False) as found:
        return np.concatenate([found[name] for name in sorted(found.files)])


def _xyz(points: NDArray[Any]) -> NDArray[np.float64]:
    return np.stack([points["x"], points["y"], points["z"]], axis=1).astype(np.float64)


def _distances(
    a: NDArray[np.float64], b: NDArray[np.float64], time_ns: NDArray[np.uint32]
) -> NDArray[np.float64]:
    """Distances of corresponding points of one ring; the returns of one firing, which have one
    time, are paired as they fit."""
    distance = np.linalg.norm(a - b, axis=1)
    pair = np.flatnonzero(time_ns[1:] == time_ns[:-1])
    distance[pair] = np.minimum(distance[pair], np.linalg.norm(a[pair] - b[pair + 1], axis=1))
    distance[pair + 1] = np.minimum(
        distance[pair + 1], np.linalg.norm(a[pair + 1] - b[pair], axis=1)
    )
    return distance


def worst_excess_m(ours: NDArray[Any], theirs: NDArray[Any]) -> tuple[float, float]:
    """(largest distance, largest distance minus the azimuth's rounding at that range).

    Both decoders keep the order of firings within a ring, so the i-th points of a ring correspond;
    only the two returns of one firing may be swapped. A point is never compared with that of
    another firing: one that is a firing late lies on the same smooth wall.
    """
    if len(ours) != len(theirs):
        raise RuntimeError(f"{len(ours)} points, the other decoder has {len(theirs)}")
    if not all(np.isfinite(_xyz(points)).all() for points in (ours, theirs)):
        raise RuntimeError("a coordinate is no number")
    worst, excess, compared = 0.0, -np.inf, 0
    for ring in range(16):
        of_ring = ours[ours["ring"] == ring]
        a, b = _xyz(of_ring), _xyz(theirs[theirs["ring"] == ring])
        if len(a) != len(b):
            raise RuntimeError(f"ring {ring}: {len(a)} points, the other decoder has {len(b)}")
        if len(a) == 0:
            continue
        distance = _distances(a, b, of_ring["time_ns"])
        worst = max(worst, float(distance.max()))
        over = distance - np.linalg.norm(a, axis=1) * AZIMUTH_ROUNDING_RAD
        excess = max(excess, float(over.max()))
        compared += len(a)
    if compared == 0 or compared < len(ours):
        raise RuntimeError(f"{compared} of {len(ours)} points are of the 16 rings")
    return worst, excess


def source_of(setting: Setting, name: str) -> tuple[Source, NDArray[Any]]:
    """A recording and its points by velodyne-decoder."""
    folder = setting.recording(f"data/{name}")
    if (folder / "packets.bin").exists():
        return sources.from_bin(folder / "packets.bin"), stored(folder / "velodyne_decoder.npz")
    capture = folder / "capture.pcap"
    return sources.from_pcap(capture), by_velodyne_decoder(payloads_of_pcap(capture, VLP16))
