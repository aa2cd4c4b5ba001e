"""Ouster's packets to points: our decoder beside the manufacturer's SDK (PyPI's ouster-sdk), on the
same packets, one thread each.

CPU time on both sides. The packets of 24 frames, made of a recording with continued times and frame
numbers, are in memory before either clock starts and are decoded repeatedly. Ours checks and orders
packets, decodes them to points with time, ring and return type, and cuts sweeps. The SDK batches
packets into frames and multiplies them by its table of directions in single precision, the fastest
of its ways; its points are x, y, z of all pixels, with returns or not.
"""

from __future__ import annotations

import time
from pathlib import Path

from tests import ouster_peer
from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, cost_of, json_of
from zloam_monitor.chain import binary

FRAMES = 24
#: pixels to decode in one run
ENOUGH_PIXELS = 60_000_000
#: ratio that the product promises
LEAST_RATIO = 2.0
ROUNDS = 3
RECORDINGS = {
    "single": "OS-1-128_v2.3.0_1024x10_lb_n3",
    "wide": "OS-2-128-U1_v2.3.0_1024x10",
    "dual": "OS-0-32-U1_v2.2.0_1024x10",
}


def _ours(setting: BenchSetting, packets: Path, metadata: Path, repeat: int) -> float:
    """CPU seconds per repetition."""
    decoder = [binary(setting.build, "decode"), "--bin", packets, "--metadata", metadata]
    said = json_of(cost_of([*decoder, "--in-memory", "--repeat", repeat]).said)
    return float(said["cpu_seconds"]) / repeat


def _theirs(recording: ouster_peer.Recorded, payloads: list[bytes], repeat: int) -> float:
    core = ouster_peer.sdk()
    packets = []
    for payload in payloads:
        packet = core.LidarPacket(recording.layout)
        packet.buf[:] = list(payload)
        packets.append(packet)
    lut = core.XYZLutFloat(recording.info, False)
    began = time.process_time()
    for _ in range(repeat):
        batcher, frame = core.FrameBatcher(recording.info), core.LidarFrame(recording.info)
        for packet in packets:
            if batcher.batch(packet, frame):
                lut(frame)
    return (time.process_time() - began) / repeat


def _compared(setting: BenchSetting, name: str) -> Outcome:
    capture = setting.recording(f"data/ouster/{name}.pcap")
    recording = ouster_peer.recorded(capture)
    frames = len(ouster_peer.frames(recording))
    stream = ouster_peer.repeated(recording, max(1, FRAMES // frames))
    setting.out.mkdir(parents=True, exist_ok=True)
    path = setting.out / "ouster.bin"
    path.write_bytes(stream.tobytes())
    payloads = [row.tobytes() for row in stream]
    pixels = len(payloads) * recording.pixels_per_packet
    repeat = max(2, ENOUGH_PIXELS // pixels)
    metadata = ouster_peer.metadata_of(capture)
    rounds = [
        (
            pixels / _ours(setting, path, metadata, repeat),
            pixels / _theirs(recording, payloads, max(2, repeat // 4)),
        )
        for _ in range(ROUNDS)
    ]
    ours, theirs = (max(column) for column in zip(*rounds, strict=True))
    return Outcome(
        f"{ours * 1e-6:.0f} M pixels per CPU second, ouster-sdk {theirs * 1e-6:.0f} M: "
        f"{ours / theirs:.2f} ×",
        {"pixels_per_cpu_s": ours, "ouster_sdk": theirs, "ratio": ours / theirs, "rounds": rounds},
        held=ours >= LEAST_RATIO * theirs,
    )


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    """Profiles with one and two returns, with narrow and wide pixels."""
    return [
        Benchmark(
            f"decode-ouster-{kind}",
            f"packets of {name}, without pcap",
            lambda name=name: _compared(setting, name),  # type: ignore[misc]
            f"≥ {LEAST_RATIO:.0f} × ouster-sdk",
        )
        for kind, name in RECORDINGS.items()
    ]
