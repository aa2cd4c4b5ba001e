"""Garbage on every data key is counted by reason, never crashes a stage, and poses keep coming."""

from __future__ import annotations

import random
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import zenoh

from tests.integration.conftest import CAPTURE_SECONDS, Capture
from zloam_monitor import messages, sources
from zloam_monitor.chain import Chain
from zloam_monitor.keys import Keys
from zloam_monitor.link import open_session
from zloam_monitor.processes import endpoints
from zloam_monitor.records import StatusRecord
from zloam_monitor.robot_file import names

#: messages of each kind, on each key
ROUNDS = 40


def bad_payloads(table: str, rng: random.Random) -> list[tuple[Any, str]]:
    """Bytes that are no message of this kind, each invalid in another way, with the encoding they
    are sent with."""
    identifier = messages.KINDS[table].identifier
    noise = rng.randbytes(rng.randrange(9, 4000))
    return [
        (b"", messages.encoding(table)),
        (b"\x00", messages.encoding(table)),
        (noise, messages.encoding(table)),
        # valid identifier, followed by noise
        (noise[:4] + identifier + noise, messages.encoding(table)),
        (b"\x08\x00\x00\x00" + identifier + noise, messages.encoding(table)),
        # unknown kind of message; no encoding
        (b"\x08\x00\x00\x00ZLXX" + noise, messages.encoding(table)),
        (noise, "text/plain"),
    ]


def assert_counted_everywhere(keys: Keys, statuses: dict[str, StatusRecord]) -> None:
    """Checks each input of each stage: integration's corrections, too, not only the sweeps."""
    stages = ("registration", "odometry", "mapping", "integration")
    accounts = {(s, account.key): account for s in stages for account in statuses[s].inputs}
    expected = {(s, keys.main_input(s)) for s in stages} | {("integration", keys.map_correction)}
    assert accounts.keys() >= expected
    for where, account in accounts.items():
        assert account.balanced(), where
        assert account.dropped.get("garbage", 0) > 0, where
        assert account.lost == 0, where


def test_garbage_on_every_key(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    source = sources.from_pcap(capture.pcap)
    robot = names(robot_file, [])
    chain = Chain(
        build,
        robot_file,
        robot.robot,
        source.driver_settings("realtime"),
        tmp_path / "logs",
        robot.sensor,
    )
    keys = chain.link.keys
    inputs = {
        keys.sweep: "Sweep",
        keys.features: "Features",
        keys.odometry: "Odometry",
        keys.odometry_features: "OdometryFeatures",
        keys.map_correction: "MapCorrection",
        keys.ack("mapping"): "FlowAck",
        keys.ack("integration"): "FlowAck",
        keys.below("odometry/progress"): "Progress",
    }
    genuine: dict[str, bytes] = {}

    def hear(sample: zenoh.Sample) -> None:
        genuine.setdefault(str(sample.key_expr), sample.payload.to_bytes())

    def flood(session: Any) -> None:
        rng = random.Random(5)
        for _ in range(ROUNDS):
            for key, table in inputs.items():
                bad = bad_payloads(table, rng)
                if key in genuine:  # a genuine message, truncated
                    whole = genuine[key]
                    bad.append((whole[: rng.randrange(8, len(whole))], messages.encoding(table)))
                for payload, encoding in bad:
                    session.put(key, payload, encoding=encoding)

    with chain:
        session = open_session(endpoints(chain.base_port))
        listeners = [
            session.declare_subscriber(key, hear, allowed_origin=zenoh.Locality.REMOTE)
            for key in (keys.sweep, keys.features, keys.odometry, keys.odometry_features)
        ]
        chain.wait_ready()
        with ThreadPoolExecutor() as pool:
            flooding = pool.submit(flood, session)
            while not chain.finished():
                chain.link.poll(0.2)
                chain.check()
            flooding.result()
        chain.link.query_statuses()
        poses = chain.link.trajectory()
        listeners.clear()
        session.close()
        codes = chain.stop()
        statuses = chain.statuses()
    assert len(genuine) == 4, "no message of the stages was there to be cut short"
    assert set(codes.values()) == {0}
    assert len(poses) >= CAPTURE_SECONDS * 10
    assert_counted_everywhere(keys, statuses)
