"""The example that publishes the angles of a scanner's motor."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fake_session import needs_schemas
from zloam_monitor import messages
from zloam_monitor.link import open_session
from zloam_monitor.processes import free_port

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "publish_angles.py"
HOUR_NS = 3600 * 10**9
#: first stamp of the readings
FIRST_NS = 1_700_000_000 * 10**9
#: stamps of readings that are sent until the link is up; they are before all others
EARLIER_NS = 10**9
#: Limit of the time of a test that fails.
PATIENCE_S = 60.0


class Motor:
    """The example as a process, and the stamps that arrive from it, message by message."""

    def __init__(self) -> None:
        needs_schemas()
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.session = open_session([], endpoint)
        self.arrived: list[list[int]] = []
        self.linked = False
        self._subscriber = self.session.declare_subscriber("loam/r/lidar/l/angle", self._take)
        self.process = subprocess.Popen(
            [sys.executable, str(EXAMPLE), endpoint, "r", "l"],
            stdin=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(messages.schemas_path())},
        )

    def _take(self, sample: Any) -> None:
        angles = messages.decode("MotorAngles", bytes(sample.payload))
        stamps = [angles.Readings(i).StampNs() for i in range(angles.ReadingsLength())]
        if stamps[0] >= FIRST_NS - HOUR_NS:
            self.arrived.append(stamps)
        self.linked = True

    def tell(self, *stamps_ns: int) -> None:
        assert self.process.stdin is not None
        self.process.stdin.writelines(f"{stamp_ns},0.5\n" for stamp_ns in stamps_ns)
        self.process.stdin.flush()

    def until_linked(self) -> None:
        stamp_ns = EARLIER_NS

        def told() -> bool:
            nonlocal stamp_ns
            self.tell(stamp_ns, stamp_ns + 25_000_000)
            stamp_ns += 50_000_000
            return self.linked

        until(told)

    def end(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def until(is_so: Callable[[], bool]) -> None:
    ends = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < ends
        time.sleep(0.02)


@pytest.fixture
def motor() -> Iterator[Motor]:
    made = Motor()
    try:
        made.until_linked()
        yield made
    finally:
        made.end()
        made.session.close()


def test_readings_go_on_when_the_clock_is_set_back(motor: Motor) -> None:
    before = [FIRST_NS + 5_000_000 * i for i in range(7)]
    after = [stamp_ns - HOUR_NS for stamp_ns in before]
    motor.tell(*before, *after)
    until(lambda: after[0] in [stamp_ns for batch in motor.arrived for stamp_ns in batch])
    assert all(batch == sorted(batch) for batch in motor.arrived)


def test_all_readings_of_a_recorded_table_are_published(motor: Motor) -> None:
    stamps = [FIRST_NS + 5_000_000 * i for i in range(13)]
    assert motor.process.stdin is not None
    motor.process.stdin.write("t_ns,angle_rad\n")
    motor.tell(*stamps)
    motor.end()
    assert motor.process.returncode == 0
    until(lambda: sum(map(len, motor.arrived)) >= len(stamps))
    assert [stamp_ns for batch in motor.arrived for stamp_ns in batch] == stamps
