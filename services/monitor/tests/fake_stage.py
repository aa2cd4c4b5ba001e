"""A stand-in for one stage: uses the public keys, but computes nothing.

fake_stage.py STAGE --config FILE --set KEY=VALUE ...; environment variables FAKE_<WHAT>=STAGE
change its behaviour.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray

from zloam_monitor import clouds, compose, trajectory
from zloam_monitor.keys import Keys
from zloam_monitor.messages import MAP_POINT, STAMPED_POSE
from zloam_monitor.stages import PORT_ORDER

RUN = 77
SWEEPS = 40
START_NS = 1_700_000_000_000_000_000


UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def loop() -> NDArray[np.float64]:
    """The robot's path: positions of base_link, m."""
    angle = np.linspace(0, 2 * np.pi, SWEEPS)
    return np.c_[55 * np.cos(angle), 40 * np.sin(angle), 0.1 * np.sin(angle)]


def wall() -> NDArray[Any]:
    """Points of a map for queries."""
    points = np.zeros(2000, MAP_POINT)
    points["x"] = np.linspace(-60, 60, 2000)
    points["y"], points["z"] = 45.0, np.arange(2000) % 7
    return points


def wants(what: str, stage: str) -> bool:
    return os.environ.get(f"FAKE_{what}") == stage


def open_session(stage: str, base_port: int) -> zenoh.Session:
    mine = PORT_ORDER.index(stage)
    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{base_port + mine}"]')
    named = [a.partition("=")[2] for a in sys.argv if a.startswith("zenoh.connect=")]
    if named:
        config.insert_json5("connect/endpoints", named[-1])
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


#: As in a stage's replay: on a busy machine, a message that isn't waited for would be dropped.
BLOCK = zenoh.CongestionControl.BLOCK


class Fake:
    def __init__(self, stage: str, base_port: int) -> None:
        self.stage, self.keys = stage, Keys("robot")
        self.session = open_session(stage, base_port)
        self.sent = 0
        # The driver waits a second for its subscribers; the other stages wait for its sweeps, and
        # one that is alone for a reader of its poses.
        self.may_send = 0
        self.poses = self.session.declare_publisher(self.keys.pose)
        self.first_ns = time.time_ns() + 1_000_000_000
        self.listener = self.session.declare_subscriber(self.keys.sweep, self.heard)
        self.positions, self.points = loop(), wall()
        below = self.keys.below
        self.alive = self.session.liveliness().declare_token(
            self.keys.below(f"service/{stage}/{stage}-1/alive")
        )
        self.answers = [
            self.answer(below(f"service/{stage}/{stage}-1/status"), self.status),
            self.answer(below(f"service/{stage}/{stage}-1/config"), self.config),
        ]
        if stage == "mapping":
            self.answers.append(self.answer(below("map/tile/plane/0/0/0"), self.tile))
        if stage == "integration":
            self.answers.append(self.answer(self.keys.path_map, self.path))
        if stage == "odometry":
            self.answers.append(self.answer(self.keys.path_odometry, self.path))

    def heard(self, sample: zenoh.Sample) -> None:
        self.may_send = max(self.may_send, int(sample.payload.to_string()))

    def answer(self, key: str, build: Callable[[], bytes]) -> Any:
        return self.session.declare_queryable(key, lambda query: query.reply(key, build()))

    def header(self, n: int) -> compose.HeaderValues:
        now = time.time_ns()
        return compose.HeaderValues(
            RUN,
            n,
            n,
            stamp_ns=START_NS + n * 100_000_000,
            frame="map",
            end_of_run=n == SWEEPS - 1,
            trace=((self.stage, now - 3_000_000, now - 2_000_000, now),),
        )

    def config(self) -> bytes:
        return compose.config(
            self.stage, {"mounting.xyz_m": [0, 0, 1.5], "mounting.rpy_deg": [0, 0, 0]}
        )

    def tile(self) -> bytes:
        return compose.tile(self.header(0), "plane", (0, 0, 0), self.points)

    def path(self) -> bytes:
        rows = np.zeros(self.sent, STAMPED_POSE)
        rows["sweep"] = np.arange(self.sent)
        rows["instant_ns"] = START_NS + np.arange(1, self.sent + 1) * 100_000_000
        for axis, name in enumerate("xyz"):
            rows["pose"]["translation"][name] = self.positions[: self.sent, axis]
        rows["pose"]["rotation"]["w"] = 1.0
        return compose.path(self.header(0), rows)

    def status(self) -> bytes:
        key = self.keys.main_input(self.stage)
        processed = self.sent + (1 if wants("UNBALANCED", self.stage) else 0)
        inputs = [compose.Counts(key, self.sent, processed)] if key else []
        out = {self.keys.main_output(self.stage): self.sent}
        last = self.sent - 1 if self.sent else None
        reason = "no packets on UDP 2368 for 3 s" if wants("QUIET", self.stage) else ""
        return compose.status(
            self.stage,
            time.time_ns(),
            RUN,
            last,
            inputs,
            out,
            self.sent == SWEEPS,
            health=2 if reason else 1,
            reason=reason,
        )

    def begins(self) -> bool:
        """Whether it sends from now on, without hearing of sweeps."""
        if wants("ALONE", self.stage):
            # The stub says that it is a bool.
            return bool(self.poses.matching_status.matching)  # type: ignore[attr-defined]
        return self.stage == "driver" and time.time_ns() > self.first_ns

    def turn(self) -> None:
        n = self.sent
        if self.begins():
            self.may_send = SWEEPS
        if n < min(SWEEPS, self.may_send) and not os.environ.get("FAKE_QUIET"):
            self.sent += 1
            instant = START_NS + (n + 1) * 100_000_000
            keys = {
                "integration": self.keys.pose,
                "odometry": self.keys.odometry,
                "mapping": self.keys.map_odometry,
            }
            if self.stage in keys:
                table = "Odometry" if self.stage == "odometry" else "MapPose"
                message = compose.pose(table, self.header(n), instant, self.positions[n], UPRIGHT)
                self.session.put(keys[self.stage], message, congestion_control=BLOCK)
        if self.stage == "driver" and self.sent:
            # The last one again and again, for a stage whose link comes late.
            self.session.put(self.keys.sweep, str(self.sent), congestion_control=BLOCK)
        self.session.put(
            self.keys.below(f"service/{self.stage}/{self.stage}-1/status"), self.status()
        )


def main() -> int:
    stage = sys.argv[1]
    if "--check-config" in sys.argv:  # What it refuses (FAKE_REFUSES), it refuses when it starts.
        print("{}")
        return 0
    if wants("REFUSES", stage):
        print("robot.yaml:3: driver.speed: unknown key", file=sys.stderr)
        return 2
    base_port = next(int(a.split("=")[1]) for a in sys.argv if a.startswith("zenoh.base_port="))
    fake, ended = Fake(stage, base_port), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    while not ended.wait(0.03):
        fake.turn()
        if wants("DIES", stage) and fake.sent == 10:
            print("something broke", file=sys.stderr, flush=True)
            os._exit(1)
    # Like a real stage, it processes what it has received before it ends: the sinks may have ended
    # the run while this stage is a step behind.
    for _ in range(min(SWEEPS, fake.may_send) - fake.sent):
        fake.turn()
    fake.session.close()  # type: ignore[no-untyped-call]
    named = [a.partition("=")[2] for a in sys.argv if a.startswith("mapping.map_path=")]
    if stage == "mapping" and not wants("FULL_DISK", stage):
        clouds.write_pcd(Path(named[-1]), fake.points, np.ones(len(fake.points), np.uint8))
    folders = [a.partition("=")[2] for a in sys.argv if a.startswith("integration.output_dir=")]
    if stage == "integration" and folders and fake.sent and not wants("FULL_DISK", stage):
        transforms = np.tile(np.eye(4), (fake.sent, 1, 1))
        transforms[:, :3, 3] = fake.positions[: fake.sent]
        stamps = START_NS + (np.arange(fake.sent) + 1) * 100_000_000
        poses = trajectory.Trajectory(transforms, stamps, np.arange(fake.sent))
        trajectory.write_tum(Path(folders[-1]) / "trajectory.tum", poses)
        trajectory.write_kitti(Path(folders[-1]) / "trajectory.kitti", poses)
    return 7 if wants("ENDS_BADLY", stage) else 0


if __name__ == "__main__":
    sys.exit(main())
