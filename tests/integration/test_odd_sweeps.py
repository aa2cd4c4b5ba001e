"""Empty, NaN, single-point, one-ring and all-equal clouds into every stage, between good ones.

Each stage runs alone; the test writes its input and expects one output per message.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

from zloam_monitor import compose, messages
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.messages import POINT
from zloam_monitor.processes import Process, Processes, endpoints, free_base_port
from zloam_monitor.records import Input

PERIOD_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000
GOOD_BEFORE = 3
#: On a busy machine a live output may be lost; as any reader would, the test queries it after this
#: time.
ASK_AFTER_SECONDS = 2.0


def room(columns: int = 900) -> NDArray[Any]:
    """A sweep in the middle of a room of 12 x 9 x 4 m: 16 rings, ray-cast on its walls."""
    azimuth = np.repeat(np.arange(columns) * 2 * np.pi / columns, 16)
    ring = np.tile(np.arange(16), columns)
    elevation = np.radians(ring * 2.0 - 15.0)
    direction = np.c_[
        np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(-azimuth), np.sin(elevation)
    ]
    with np.errstate(divide="ignore"):
        distance = np.min(np.array([6.0, 4.5, 2.0]) / np.abs(direction), axis=1)
    points = np.zeros(len(direction), POINT)
    xyz = direction * distance[:, None]
    points["x"], points["y"], points["z"] = xyz.T
    points["intensity"], points["ring"] = 50, ring
    points["time_ns"] = np.linspace(0, PERIOD_NS - 1, len(points)).astype(np.uint32)
    return points


def odd_clouds() -> dict[str, NDArray[Any]]:
    """Name -> cloud."""
    good = room()
    nan = good.copy()
    nan["x"] = np.nan
    equal = good.copy()
    equal[["x", "y", "z"]] = good[["x", "y", "z"]][100]
    return {
        "empty": good[:0],
        "nan": nan,
        "one point": good[:1],
        "one ring": good[good["ring"] == 7],
        "all equal": equal,
    }


def header(n: int, frame: str = "lidar") -> compose.HeaderValues:
    return compose.HeaderValues(
        run=START_NS, sweep=n, seq=n, stamp_ns=START_NS + n * PERIOD_NS, frame=frame
    )


def sweep_message(n: int, cloud: NDArray[Any]) -> bytes:
    return compose.sweep(header(n), cloud)


def features_message(n: int, cloud: NDArray[Any]) -> bytes:
    finite = cloud[np.isfinite(cloud["x"])]
    clouds = {
        "Sharp": finite[::50],
        "LessSharp": finite[::10],
        "Flat": finite[::20],
        "LessFlat": finite,
    }
    return compose.features(header(n), clouds)


def odometry_features_message(n: int, cloud: NDArray[Any]) -> bytes:
    finite = cloud[np.isfinite(cloud["x"])]
    instant = START_NS + (n + 1) * PERIOD_NS
    return compose.odometry_features(
        header(n, "base_link"), instant, (0, 0, 0), finite[::10], finite
    )


def odometry_message(n: int, cloud: NDArray[Any]) -> bytes:
    health = 0 if len(cloud) > 100 else 5
    instant = START_NS + (n + 1) * PERIOD_NS
    return compose.pose("Odometry", header(n, "odom"), instant, (0, 0, 0), (0, 0, 0, 1), health)


KEYS = Keys("robot")
STAGES = {
    "registration": ("Sweep", sweep_message),
    "odometry": ("Features", features_message),
    "mapping": ("OdometryFeatures", odometry_features_message),
    "integration": ("Odometry", odometry_message),
}


def settled(link: Link, stage: str, deadline: float) -> Input:
    """The input's counters once no message is being processed: outputs are published before
    that."""
    while True:
        link.query_statuses()
        account = link.stage(stage).input(KEYS.main_input(stage))
        if account.in_work == 0 or time.monotonic() > deadline:
            return account
        time.sleep(0.05)


def nothing_came_out(link: Link, stage: str, n: int) -> str:
    """Message of a failed wait; the status tells whether the input or its output was lost."""
    link.query_statuses()
    return f"nothing came out for message {n}; {link.stage(stage)}"


def wait_for_output(
    link: Link, process: Process, n: int, out: list[bytes], deadline: float
) -> None:
    """Waits for message n's output; queries it after a while as the next stage would."""
    key = KEYS.main_output(process.stage)
    ask_at = time.monotonic() + ASK_AFTER_SECONDS
    while len(out) <= n:
        assert process.code() is None, process.last_lines()
        assert time.monotonic() < deadline, nothing_came_out(link, process.stage, n)
        link.poll(0.02)
        if time.monotonic() > ask_at:
            answers = list(link.get(f"{key}?run={START_NS};sweep={n}..{n}"))
            out += answers if len(out) <= n else []
            ask_at = time.monotonic() + ASK_AFTER_SECONDS


@pytest.mark.parametrize("stage", STAGES)
def test_one_out_for_each_in(build: Path, tmp_path: Path, stage: str) -> None:
    table, message = STAGES[stage]
    base = free_base_port()
    config = tmp_path / "robot.yaml"
    config.write_text("robot: robot\n")
    processes = Processes()
    command = [
        str(build / "bin" / f"zloam-{stage}"),
        "--config",
        str(config),
        "--set",
        f"zenoh.base_port={base}",
    ]
    process = processes.start(stage, command, tmp_path / f"{stage}.log")
    session = open_session(endpoints(base))
    out: list[bytes] = []
    listener = session.declare_subscriber(
        KEYS.main_output(stage), lambda sample: out.append(sample.payload.to_bytes())
    )
    # Declared after the subscriber: once a status arrives, the stage knows of both.
    link = Link(session, KEYS)
    try:
        publisher = session.declare_publisher(
            KEYS.main_input(stage), congestion_control=zenoh.CongestionControl.BLOCK
        )
        deadline = time.monotonic() + 30
        while not publisher.matching_status.matching or link.stage(stage) is None:
            assert process.code() is None, process.last_lines()
            assert time.monotonic() < deadline, "no match"
            link.poll(0.05)
        good = room()
        clouds = [good] * GOOD_BEFORE
        for cloud in odd_clouds().values():
            clouds += [cloud, good]
        for n, cloud in enumerate(clouds):
            publisher.put(message(n, cloud), encoding=messages.encoding(table))
            wait_for_output(link, process, n, out, deadline)
        account = settled(link, stage, deadline)
        assert account.balanced()
        assert account.received == account.processed == len(clouds)
        assert not any(account.dropped.values())
    finally:
        listener.undeclare()
        link.close()
        session.close()
        codes = processes.stop()
    assert codes == {stage: 0}
    assert len(out) == len(clouds)
