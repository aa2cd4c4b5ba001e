"""An odometry stage as a third party would write it: KISS-ICP behind the keys of
services/README.md.

usage: python -m tests.integration.kiss_odometry LISTEN CONNECT[,CONNECT...] ROBOT SENSOR
Assumes that the lidar is base_link. Ends on SIGTERM.
"""

from __future__ import annotations

import hashlib
import queue
import signal
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import flatbuffers
import numpy as np
from kiss_icp.config.parser import load_config
from kiss_icp.kiss_icp import KissICP
from numpy.typing import NDArray
from scipy.linalg import expm, logm

from zloam_monitor import messages, se3
from zloam_monitor.keys import Keys
from zloam_monitor.link import open_session
from zloam_monitor.messages import module

Make = Callable[[], bytes]
INSTANCE = "kiss"
KEPT, ASK_AFTER_SECONDS, DROPPED = 64, 0.2, 6


def finish(b: Any, table: str, **fields: Any) -> int:
    """Builds a table from the given fields; a tuple (struct, numbers) becomes a struct within the
    table."""
    code = module(table)
    code.Start(b)
    for name, value in fields.items():
        if isinstance(value, tuple):
            value = getattr(module(value[0]), "Create" + value[0])(b, *map(float, value[1]))
        getattr(code, "Add" + name)(b, value)
    return code.End(b)


def message(b: Any, table: str, **fields: Any) -> bytes:
    b.Finish(finish(b, table, **fields), messages.KINDS[table].identifier)
    return bytes(b.Output())


def header(b: Any, cause: Any, frame: str, seq: int) -> int:
    """The header of the message that caused this one, with this publisher's number, name and trace
    point."""
    texts = {"Robot": cause.Robot(), "Sensor": cause.Sensor(), "Frame": frame, "Instance": INSTANCE}
    texts = {name: b.CreateString(value) for name, value in texts.items()}
    points = [cause.Trace(i) for i in range(cause.TraceLength())]
    steps = [(p.Stage(), p.Host(), p.Instance(), p.ReceivedNs(), p.StartedNs(), p.PublishedNs())
             for p in points]  # fmt: skip
    now = time.time_ns()
    steps.append(("odometry", "python", INSTANCE, now, now, now))
    trace = []
    for stage, host, instance, *at in steps:
        named = [b.CreateString(v) for v in (stage, host, instance)]
        pairs = zip(("Stage", "Host", "Instance"), named, strict=True)
        times = zip(("ReceivedNs", "StartedNs", "PublishedNs"), at, strict=True)
        trace.append(finish(b, "TracePoint", **dict(pairs), **dict(times)))
    b.StartVector(4, len(trace), 4)
    for offset in reversed(trace):
        b.PrependUOffsetTRelative(offset)
    same = ("Run", "Sweep", "StampNs", "EndOfRun", "LastPacketNs", "Replay")
    kept = {name: getattr(cause, name)() for name in same}
    return finish(b, "Header", **texts, **kept, Seq=seq, Trace=b.EndVector())


class Output:
    """Publisher of one key: numbers its messages, keeps the newest ones and answers queries for
    them."""

    def __init__(self, session: Any, key: str, table: str) -> None:
        self.table, self.key, self.seq = table, key, 0
        self.kept: OrderedDict[int, bytes] = OrderedDict()
        self.publisher = session.declare_publisher(key, encoding=messages.encoding(table))
        self.queryable = session.declare_queryable(key, self.answer)

    def publish(self, sweep: int, data: bytes) -> None:
        self.kept[sweep], self.seq = data, self.seq + 1
        while len(self.kept) > KEPT:
            self.kept.popitem(last=False)
        self.publisher.put(data)

    def again(self, sweep: int) -> None:
        if sweep in self.kept:
            self.publisher.put(self.kept[sweep])

    def answer(self, query: Any) -> None:
        first, _, last = str(query.parameters["sweep"]).partition("..")
        for sweep, data in list(self.kept.items()):
            if int(first) <= sweep <= int(last or first):
                query.reply(self.key, data, encoding=messages.encoding(self.table))


class Odometry:
    def __init__(self, session: Any, keys: Keys) -> None:
        config = load_config(None)
        config.data.deskew, config.data.min_range = False, 0.5
        self.kiss, self.twist, self.instant = KissICP(config), np.zeros(6), 0
        self.pose = Output(session, keys.odometry, "Odometry")
        self.clouds = Output(session, keys.odometry_features, "OdometryFeatures")
        self.session, self.key = session, keys.features
        self.next = 0
        self.waiting: dict[int, Any] = {}
        self.come: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.prev = 0
        self.subscriber = session.declare_subscriber(self.key, self.come.put)

    def turn(self) -> None:
        """Processes the messages that have arrived, in order of their sweeps; queries missing
        ones."""
        try:
            sample = self.come.get(timeout=ASK_AFTER_SECONDS)
        except queue.Empty:
            if self.waiting:
                gap = f"sweep={self.next}..{min(self.waiting) - 1}"
                run = next(iter(self.waiting.values())).Header().Run()
                self.session.get(f"{self.key}?run={run};{gap}", lambda r: self.come.put(r.ok))
            return
        if sample is None:
            return
        features = messages.decode("Features", sample.payload.to_bytes())
        sweep = features.Header().Sweep()
        if sweep < self.next:
            self.pose.again(sweep)
            self.clouds.again(sweep)
            return
        self.waiting[sweep] = features
        while self.next in self.waiting:
            features = self.waiting.pop(self.next)
            self.next += 1
            if features.Health() != DROPPED:
                self.process(features)

    def process(self, features: Any) -> None:
        cause = features.Header()
        instant = cause.StampNs() + features.PeriodNs()
        edges, planes = (self.at_end(features, f) for f in ("LessSharp", "LessFlat"))
        cloud = np.concatenate([edges, planes])
        xyz = np.stack([cloud[a] for a in "xyz"], 1).astype(np.float64)
        before = self.kiss.last_pose
        self.kiss.register_frame(xyz, np.empty(0))
        if self.instant > 0:
            step = logm(se3.inverse(before) @ self.kiss.last_pose).real
            per_s = step / ((instant - self.instant) * 1e-9)
            turn = [per_s[2, 1], per_s[0, 2], per_s[1, 0]]
            self.twist = np.concatenate([per_s[:3, 3], turn])
        self.instant = instant
        solved = {
            "InstantNs": instant,
            "PoseOdomBase": ("Pose", self.numbers()),
            "Twist": ("Twist", self.twist),
            "PrevSweep": self.prev,
            "Health": features.Health(),
        }
        b = flatbuffers.Builder(1 << 12)
        top = header(b, cause, "odom", self.pose.seq)
        covariance = b.CreateNumpyVector((np.eye(6) * 1e-4).ravel())
        data = message(b, "Odometry", Header=top, Covariance=covariance, **solved)
        self.pose.publish(cause.Sweep(), data)
        b = flatbuffers.Builder(1 << 16)
        more = {
            "Header": header(b, cause, "base_link", self.clouds.seq),
            "Covariance": b.CreateNumpyVector((np.eye(6) * 1e-4).ravel()),
            "Edges": messages.put_struct_vector(b, edges),
            "Planes": messages.put_struct_vector(b, planes),
            "PeriodNs": features.PeriodNs(),
            "PoseBaseLidar": ("Pose", (0, 0, 0, 0, 0, 0, 1)),
            "RangeNoiseM": features.RangeNoiseM(),
        }
        self.clouds.publish(cause.Sweep(), message(b, "OdometryFeatures", **more, **solved))
        self.prev = cause.Sweep()

    def numbers(self) -> tuple[float, ...]:
        pose = self.kiss.last_pose
        return *pose[:3, 3], *se3.quaternions(pose[None])[0]

    def at_end(self, features: Any, field: str) -> NDArray[Any]:
        """Moves the points to the end of the sweep by the last twist; 32 time steps per sweep."""
        points = messages.struct_vector(features, field, messages.POINT).copy()
        period = features.PeriodNs()
        v, w = self.twist[:3], self.twist[3:]
        turn = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        rate = np.vstack([np.column_stack([turn, v]), np.zeros(4)])
        part = np.minimum(points["time_ns"] * 32.0 / period, 31).astype(int)
        for i in np.unique(part):
            move, chosen = expm(rate * ((i + 0.5) / 32 - 1) * period * 1e-9), part == i
            xyz = np.stack([points[a][chosen] for a in "xyz"], 1)
            for axis, values in zip("xyz", (xyz @ move[:3, :3].T + move[:3, 3]).T, strict=True):
                points[axis][chosen] = values
        return points


def status() -> bytes:
    b = flatbuffers.Builder(256)
    names = {n: b.CreateString(v) for n, v in (("Stage", "odometry"), ("Instance", INSTANCE))}
    return message(b, "Status", **names, Health=1, StampNs=time.time_ns())


def config() -> bytes:
    b = flatbuffers.Builder(256)
    texts = {"Stage": "odometry", "Instance": INSTANCE, "ValuesJson": "{}"}
    texts["ResultHash"] = hashlib.sha256(b"kiss-icp").hexdigest()
    return message(b, "EffectiveConfig", **{n: b.CreateString(v) for n, v in texts.items()})


def main() -> int:
    listen, connect, robot, sensor = sys.argv[1:5]
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    session, keys = open_session(connect.split(","), listen), Keys(robot, sensor)
    odometry = Odometry(session, keys)
    own = keys.below(f"service/odometry/{INSTANCE}/")
    kept: list[Any] = []
    for key, make, table in (("status", status, "Status"), ("config", config, "EffectiveConfig")):

        def answer(query: Any, key: str = key, make: Make = make, table: str = table) -> None:
            query.reply(own + key, make(), encoding=messages.encoding(table))

        kept.append(session.declare_queryable(own + key, answer))
    kept.append(session.liveliness().declare_token(own + "alive"))
    said = 0.0
    while not ended.is_set():
        odometry.turn()
        if time.monotonic() - said > 1.0:
            session.put(own + "status", status(), encoding=messages.encoding("Status"))
            said = time.monotonic()
    session.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
