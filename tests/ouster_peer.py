"""Ouster captures as read by the manufacturer's own SDK; for tests and benchmarks."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

#: endings of the metadata file beside a capture
ENDINGS = (".json", "_0.json")
HOUR_NS = 3_600_000_000_000


def sdk() -> Any:
    """The SDK; skips the test if it is not installed (deploy/build/venv.sh --tests)."""
    pytest.importorskip("ouster.sdk.pcap", reason="PyPI's ouster-sdk is not installed")
    from ouster.sdk import core

    return core


def metadata_of(capture: Path) -> Path:
    """The metadata file of the capture's sensor."""
    named = (capture.with_name(capture.stem + ending) for ending in ENDINGS)
    return next(path for path in named if path.is_file())


@dataclass(frozen=True)
class Recorded:
    """A capture's packets in the SDK's types."""

    info: Any
    layout: Any
    packets: list[Any]
    imu: list[Any]

    @property
    def payloads(self) -> np.ndarray:
        """Data packets, one per row."""
        return np.stack([np.frombuffer(bytes(p.buf), np.uint8) for p in self.packets])

    @property
    def pixels_per_packet(self) -> int:
        """Pixels in a packet, with or without returns."""
        return int(self.layout.columns_per_packet * self.layout.pixels_per_column)


def recorded(capture: Path) -> Recorded:
    """The packets of a capture."""
    core = sdk()
    from ouster.sdk import pcap

    source = pcap.PcapPacketSource(str(capture))
    info = source.sensor_info[0]
    all_packets = [packet for _, packet in source]
    return Recorded(
        info,
        core.PacketFormat(info),
        [p for p in all_packets if isinstance(p, core.LidarPacket)],
        [p for p in all_packets if isinstance(p, core.ImuPacket)],
    )


def frames(recording: Recorded) -> list[Any]:
    """The capture's frames, whole or partial."""
    core = sdk()
    batcher, frame, done = core.FrameBatcher(recording.info), core.LidarFrame(recording.info), []
    numbers = [recording.layout.frame_id(packet.buf) for packet in recording.packets]
    for i, packet in enumerate(recording.packets):
        if i > 0 and numbers[i] != numbers[i - 1]:
            done.append(frame)
            batcher, frame = core.FrameBatcher(recording.info), core.LidarFrame(recording.info)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            batcher.batch(packet, frame)
    return [*done, frame]


def points(recording: Recorded) -> dict[str, np.ndarray]:
    """All returns, ordered by time, then from the top row down, then as in the pixel."""
    lut = sdk().XYZLut(recording.info, False)
    parts = [_points_of(frame, recording, lut) for frame in frames(recording)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _points_of(frame: Any, recording: Recorded, lut: Any) -> dict[str, np.ndarray]:
    dual = "RANGE2" in frame.fields
    names = ["RANGE", "RANGE2"] if dual else ["RANGE"]
    ranges = np.stack([frame.field(name) for name in names])  # return, row, column
    reflectivities = np.stack([frame.field(n.replace("RANGE", "REFLECTIVITY")) for n in names])
    xyz = np.stack([lut(frame.field(name)).reshape(*ranges.shape[1:], 3) for name in names])
    valid = (frame.status & 1).astype(bool)
    returned = (ranges > 0) & valid
    if dual:  # two equal ranges are one return
        returned[1] &= ranges[1] != ranges[0]
    # column, row, return
    order = np.argwhere(returned.transpose(2, 1, 0))
    column, row, which = order.T
    altitude = np.asarray(recording.info.beam_altitude_angles)
    ring = np.argsort(np.argsort(altitude, kind="stable"), kind="stable")
    return {
        "xyz": xyz[which, row, column],
        "range_mm": ranges[which, row, column].astype(np.int64),
        "intensity": reflectivities[which, row, column].astype(float),
        "time_ns": frame.timestamp[column].astype(np.int64) % HOUR_NS,
        "ring": ring[row],
        "column": column,
        "return_type": _types(ranges, returned)[which, row, column],
    }


def _types(ranges: np.ndarray, returned: np.ndarray) -> np.ndarray:
    """Return types: 0 strongest, 1 last, 2 both, 3 second strongest. The pixel's first return is
    the strongest."""
    types = np.zeros(ranges.shape, int)
    if len(ranges) == 2:
        alone = ~returned[0] | ~returned[1]
        types[0] = np.where(alone | (ranges[0] > ranges[1]), 2, 0)
        types[1] = np.where(alone, 2, np.where(ranges[1] > ranges[0], 1, 3))
    return types


def repeated(recording: Recorded, times: int) -> np.ndarray:
    """The packets repeated `times` times as if the sensor had continued: times and frame numbers
    advance, everything else stays."""
    layout = recording.layout
    base = recording.payloads
    first, last = (layout.frame_id(recording.packets[i].buf) for i in (0, -1))
    turns = last - first + 1
    copies = []
    for number in range(times):
        copy = base.copy()
        for column in range(layout.columns_per_packet):
            at = layout.packet_header_size + column * layout.col_size
            _add(copy, at, "<u8", number * turns * int(1e9 / recording.info.format.fps))
        fusa = "FUSA" in str(recording.info.format.udp_profile_lidar)
        _add(copy, *((4, "<u4") if fusa else (2, "<u2")), number * turns)
        copies.append(copy)
    return np.concatenate(copies)


def _add(packets: np.ndarray, at: int, kind: str, value: int) -> None:
    size = np.dtype(kind).itemsize
    words = packets[:, at : at + size].copy().view(kind)
    packets[:, at : at + size] = (words + np.array(value, kind)).view(np.uint8)


def written(described: Path, profile: str, seed: int) -> Recorded:
    """A frame of random returns that the SDK itself encodes in a profile, and its metadata as given
    by the SDK."""
    core = sdk()
    info = core.SensorInfo(described.read_text())
    info.format.udp_profile_lidar = getattr(core.UDPProfileLidar, profile)
    if profile.startswith("FUSA"):
        info.format.header_type = core.HeaderType.FUSA
    info.init_id = 0  # the packets have no init_id either
    layout = core.PacketFormat(info)
    random = np.random.default_rng(seed)
    shape = (layout.pixels_per_column, layout.columns_per_packet)
    packets = []
    for first in range(0, info.format.columns_per_frame, layout.columns_per_packet):
        packet = core.LidarPacket(layout)
        packet.buf[:] = 0
        if layout.packet_header_size:
            packet.buf[0] = 1
        layout.set_frame_id(packet, 7)
        for column in range(layout.columns_per_packet):
            layout.set_col_measurement_id(packet, column, first + column)
            layout.set_col_timestamp(packet, column, 10**12 + (first + column) * 97_656)
            layout.set_col_status(packet, column, 0xFFFFFFFF if profile == "LEGACY" else 1)
        for name in (n for n in map(str, layout.fields) if not n.startswith("RAW")):
            _fill(layout, packet, name, random, shape)
        packets.append(packet)
    return Recorded(info, layout, packets, [])


def _fill(layout: Any, packet: Any, name: str, random: Any, shape: tuple[int, int]) -> None:
    """Fills a field with random bits; two fifths of the ranges are zero (no return)."""
    mask = layout.field_value_mask(name)
    kind = next(t for t in (np.uint8, np.uint16, np.uint32, np.uint64) if mask <= np.iinfo(t).max)
    values = random.integers(0, 2**32, shape, np.uint64).astype(kind) & kind(mask)
    if name.startswith("RANGE"):
        values[random.random(shape) < 0.4] = 0
        values = np.minimum(values, kind(1_000_000))  # the driver's limit
    if name in ("RANGE", "REFLECTIVITY", "RANGE2", "REFLECTIVITY2", "SIGNAL", "NEAR_IR", "FLAGS"):
        layout.set_field(packet, name, values)
