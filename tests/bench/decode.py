"""Packets to points: our decoder beside PyPI's velodyne-decoder, on the same packets, one thread
each.

CPU time on both sides. Bare payloads are in memory before either clock starts. Ours cuts them into
sweeps; velodyne-decoder gets ready packet objects of one revolution at a time, the fastest of its
interfaces (packet by packet, pieces of other sizes, and arrays instead of structs are slower). With
pcap both read the file, velodyne-decoder through dpkt as it does for its users.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import velodyne_decoder

from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, cost_of, json_of
from zloam_monitor.chain import binary

#: points per CPU second
Measure = Callable[[], float]

PACKET_BYTES = 1206
#: packets of a revolution at 600 rpm
PACKETS_PER_SCAN = 76
#: points to decode in one run, so that the program's start does not matter
ENOUGH_POINTS = 40_000_000
#: ratio that the product promises
LEAST_RATIO = 4.0
#: The decoders alternate; the best round of each counts, since other load only slows them down.
ROUNDS = 3


def _config() -> Any:
    return velodyne_decoder.Config(
        model=velodyne_decoder.Model.VLP16, min_range=0, max_range=1000, cut_angle=None
    )


def _ours_from_memory(setting: BenchSetting, path: Path) -> float:
    decoder = [binary(setting.build, "decode"), "--bin", path, "--in-memory", "--repeat"]
    once = json_of(cost_of([*decoder, 1]).said)["points"]
    many = json_of(cost_of([*decoder, max(2, ENOUGH_POINTS // once)]).said)
    return float(many["points"] / many["cpu_seconds"])


def _ours_from_pcap(setting: BenchSetting, path: Path) -> float:
    decoder = [binary(setting.build, "decode"), "--pcap", path, "--repeat"]
    once = json_of(cost_of([*decoder, 1]).said)["points"]
    many = cost_of([*decoder, max(2, ENOUGH_POINTS // once)])
    return float(json_of(many.said)["points"] / many.cpu_s)


def _peer_from_memory(path: Path) -> float:
    data = path.read_bytes()
    packets = [
        velodyne_decoder.VelodynePacket(i * 1.327e-3, data[at : at + PACKET_BYTES])
        for i, at in enumerate(range(0, len(data) - PACKET_BYTES + 1, PACKET_BYTES))
    ]
    scans = [
        velodyne_decoder.PacketVector(packets[at : at + PACKETS_PER_SCAN])
        for at in range(0, len(packets), PACKETS_PER_SCAN)
    ]
    decoder = velodyne_decoder.ScanDecoder(_config())
    points, began = 0, time.process_time()
    while points < ENOUGH_POINTS:
        for scan in scans:
            points += len(decoder.decode(scan, as_pcl_structs=True)[1])
    return points / (time.process_time() - began)


def _peer_from_pcap(path: Path) -> float:
    points, began = 0, time.process_time()
    for _, cloud in velodyne_decoder.read_pcap(path, _config(), as_pcl_structs=True):
        points += len(cloud)
    return points / (time.process_time() - began)


def _compared(measure_ours: Measure, measure_theirs: Measure) -> Outcome:
    rounds = [(measure_ours(), measure_theirs()) for _ in range(ROUNDS)]
    ours, theirs = (max(column) for column in zip(*rounds, strict=True))
    return Outcome(
        f"{ours * 1e-6:.1f} M points per CPU second, velodyne-decoder {theirs * 1e-6:.1f} M: "
        f"{ours / theirs:.2f} ×",
        {
            "points_per_cpu_s": ours,
            "velodyne_decoder": theirs,
            "ratio": ours / theirs,
            "rounds": rounds,
        },
        held=ours >= LEAST_RATIO * theirs,
    )


def _simulated(setting: BenchSetting) -> Outcome:
    setting.capture()
    path = setting.payloads()
    return _compared(lambda: _ours_from_memory(setting, path), lambda: _peer_from_memory(path))


def _recorded(setting: BenchSetting) -> Outcome:
    path = setting.recording("data/vlp16_single/packets.bin")
    return _compared(lambda: _ours_from_memory(setting, path), lambda: _peer_from_memory(path))


def _from_pcap(setting: BenchSetting) -> Outcome:
    path = setting.capture()
    return _compared(lambda: _ours_from_pcap(setting, path), lambda: _peer_from_pcap(path))


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    """Simulated and recorded packets, and a pcap."""
    limit = f"≥ {LEAST_RATIO:.0f} × velodyne-decoder"
    return [
        Benchmark(
            "decode-simulated",
            "packets of the simulated city to sweeps, without pcap",
            lambda: _simulated(setting),
            limit,
        ),
        Benchmark(
            "decode-recorded",
            "packets of a real VLP-16, without pcap",
            lambda: _recorded(setting),
            limit,
        ),
        Benchmark(
            "decode-pcap",
            "the simulated city's pcap file to sweeps",
            lambda: _from_pcap(setting),
            limit,
        ),
    ]
