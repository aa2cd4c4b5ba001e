"""IMU readings of a robot's own recording reach the driver with their sweep."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fake_session import needs_schemas
from zloam_monitor import compose, messages
from zloam_monitor.mcap_file import McapFile
from zloam_monitor.recorded_keys import schema_of
from zloam_monitor.recordings import robot_log, stream
from zloam_monitor.recordings.sweeps import Timing

ABOUT = {"robot": "r", "sensor": "lidar", "recording": "a", "version": "0.1.0", "part": "1"}


def frames(path: Path) -> Iterator[tuple[str, int]]:
    """("sweep", its number) or ("reading", its stamp) in the order in which the driver reads."""
    out = io.BytesIO()
    assert stream.write(path, "", Timing(), out, "") == 0
    out.seek(0)
    while head := out.read(stream.HEAD.size):
        _, kind, size = stream.HEAD.unpack(head)
        data = out.read(size)
        if kind == stream.MESSAGE:
            yield "sweep", messages.decode("Sweep", data).Header().Sweep()
        elif kind == stream.READING:
            yield "reading", stream.READING_DATA.unpack(data)[0]


def written(
    path: Path, monkeypatch: pytest.MonkeyPatch, stamps_ns: list[list[int]]
) -> list[tuple[str, int]]:
    """Frames of a recording whose sweeps have readings with these stamps."""
    needs_schemas()
    file = McapFile(path, ABOUT)
    for number in range(len(stamps_ns)):
        sweep = compose.sweep(compose.HeaderValues(1, number, number), np.zeros(1, messages.POINT))
        file.put("loam/r/lidar/lidar/sweep", schema_of(sweep[4:8]), number, 0, sweep)
    file.close()

    def imu_of(payload: bytes) -> NDArray[Any]:
        readings = stamps_ns[messages.decode("Sweep", payload).Header().Sweep()]
        samples = np.zeros(len(readings), messages.IMU_SAMPLE)
        samples["stamp_ns"] = readings
        return samples

    monkeypatch.setattr(robot_log, "imu_of", imu_of)
    return list(frames(path))


def test_a_sweep_gets_no_readings_that_came_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The driver reads one sweep ahead. Live, a sweep does not wait for the readings within the
    margin behind it, which the next one contains."""
    found = written(tmp_path / "run.mcap", monkeypatch, [[5, 6], [6, 7, 8], [8, 9]])
    assert found == [
        *[("sweep", 0), ("reading", 5), ("reading", 6)],
        *[("sweep", 1), ("reading", 7), ("reading", 8)],
        *[("sweep", 2), ("reading", 9)],
    ]


def test_readings_before_a_clock_that_begins_at_0_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The margin before the first sweep of a capture without receive times."""
    found = written(tmp_path / "run.mcap", monkeypatch, [[-10, 0, 10]])
    assert [stamp for kind, stamp in found if kind == "reading"] == [-10, 0, 10]
