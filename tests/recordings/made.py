"""Clouds of a made-up sensor, and what the reader writes to the driver."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.recordings.variants import PERIOD_NS, Scan
from zloam_monitor.recordings import stream
from zloam_monitor.recordings.sweeps import Timing

BEGIN_NS = 1_700_000_000 * 10**9
ELEVATIONS_DEG = np.array([-15.0, -5.0, 0.0, 5.0, 10.0, 15.0])
POINTS = 1200
AUTO = Timing()


def scans(count: int) -> list[Scan]:
    """Revolutions of six lasers among things 10 to 15 m away."""
    random = np.random.default_rng(5)
    ring = (np.arange(POINTS) % len(ELEVATIONS_DEG)).astype(np.uint16)
    azimuth = np.linspace(-np.pi, np.pi, POINTS, endpoint=False)
    elevation = np.radians(ELEVATIONS_DEG[ring])
    time_ns = (np.arange(POINTS) * PERIOD_NS) // POINTS
    found = []
    for number in range(count):
        range_m = 10.0 + 5.0 * random.random(POINTS)
        flat = np.cos(elevation) * range_m
        xyz = np.stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) * range_m], axis=-1
        ).astype(np.float32)
        intensity = np.ones(POINTS, np.float32)
        found.append(Scan(BEGIN_NS + number * PERIOD_NS, xyz, intensity, ring, time_ns))
    return found


def table(scan: Scan) -> NDArray[Any]:
    """The points as a file's: times in seconds since the stamp."""
    names = {"x": "f4", "y": "f4", "z": "f4", "intensity": "f4", "ring": "u2", "time": "f4"}
    points = np.zeros(len(scan.xyz), list(names.items()))
    for axis, name in enumerate("xyz"):
        points[name] = scan.xyz[:, axis]
    points["intensity"], points["ring"] = scan.intensity, scan.ring
    points["time"] = 1e-9 * scan.time_ns
    return points


def streamed(
    path: Path, timing: Timing = AUTO, imu_topic: str | None = None
) -> dict[int, list[bytes]]:
    """Kind of a frame -> the data of all frames of this kind; checks that the code fits them."""
    out = io.BytesIO()
    code = stream.write(path, "", timing, out, imu_topic)
    out.seek(0)
    found: dict[int, list[bytes]] = {}
    while head := out.read(stream.HEAD.size):
        _, kind, size = stream.HEAD.unpack(head)
        found.setdefault(kind, []).append(out.read(size))
    assert (code == 0) == (stream.END in found)
    assert (code == 1) == (stream.REFUSAL in found)
    return found


def texts(frames: dict[int, list[bytes]], kind: int) -> str:
    return "\n".join(text.decode() for text in frames.get(kind, []))
