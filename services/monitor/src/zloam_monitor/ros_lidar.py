"""Makes a PointCloud2 topic of a ROS 2 system (rmw_zenoh) the robot's lidar, without ROS.

The fields are interpreted as in recordings (recordings/); sweeps are published like those of any
other source (docs/your-own-sensor.md). ROS's names of keys and tokens: services/ros/graph.hpp.
"""

from __future__ import annotations

import contextlib
import queue
import re
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from zloam_monitor import messages
from zloam_monitor.keys import Keys
from zloam_monitor.link import open_session
from zloam_monitor.recordings.sweeps import Sweep, Sweeper, Timing

CLOUD = "sensor_msgs/msg/PointCloud2"
DDS_CLOUD = "sensor_msgs::msg::dds_::PointCloud2_"
DISTROS = ("humble", "jazzy", "kilted", "rolling")
#: ROS 2's default quality of service for sensors in a token: best effort, the last five.
QOS = "2::,5:,:,:,,"
TOKENS = "@ros2_lv"
#: Limit on waiting clouds; beyond it the oldest are dropped.
NEWEST = 4
#: Number of sweeps that can be queried again: those of two seconds.
KEPT = 20
SILENCE_S = 5.0
SAY_EVERY_S = 10.0
LOOK_S = 0.2


@dataclass(frozen=True)
class Options:
    """Source and destination."""

    topic: str
    #: Endpoints of the ROS nodes' router; `connect`: of the robot's stages.
    ros: list[str]
    connect: list[str]
    keys: Keys
    timing: Timing
    domain: int = 0
    distro: str = "jazzy"


def _types() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


class Topic:
    """A subscription that ROS nodes list; buffers the newest clouds."""

    def __init__(self, session: Any, options: Options) -> None:
        self._session, self._options = session, options
        self._clouds: queue.Queue[bytes] = queue.Queue(NEWEST)
        self._types = _types()
        self.dropped, self.unread = 0, 0
        # Any type hash, as each message describes its own fields.
        key = f"{options.domain}{options.topic}/{DDS_CLOUD}/*"
        self._subscriber = session.declare_subscriber(key, self._take)
        node = f"{TOKENS}/{options.domain}/{session.info.zid()}/0"
        known = "TypeHashNotSupported" if options.distro == "humble" else None
        kind = known or self._types.hash_rihs01(CLOUD)
        name = options.topic.replace("/", "%")
        declare = session.liveliness().declare_token
        self._tokens = (
            declare(f"{node}/0/NN/%/%/zenoh_loam_lidar"),
            declare(f"{node}/1/MS/%/%/zenoh_loam_lidar/{name}/{DDS_CLOUD}/{kind}/{QOS}"),
        )

    def _take(self, sample: Any) -> None:
        if self._clouds.full():
            self.dropped += self.forget(1)
        self._clouds.put(sample.payload.to_bytes())

    def forget(self, count: int = NEWEST) -> int:
        """Drops up to `count` of the oldest waiting clouds; returns the number dropped."""
        forgotten = 0
        with contextlib.suppress(queue.Empty):
            while forgotten < count:
                self._clouds.get_nowait()
                forgotten += 1
        return forgotten

    def clouds(self) -> Iterator[Any]:
        """Clouds without end; unreadable ones are counted. Prints a message if none come."""
        heard, quiet = time.monotonic(), False
        while True:
            try:
                payload = self._clouds.get(timeout=LOOK_S)
            except queue.Empty:
                if not quiet and time.monotonic() - heard > SILENCE_S:
                    quiet = True
                    print(self._silence(), flush=True)
                continue
            heard, quiet = time.monotonic(), False
            try:
                yield self._types.deserialize_cdr(payload, CLOUD)
            except Exception:  # The library has no common error type.
                self.unread += 1

    def _silence(self) -> str:
        pattern = f"{TOKENS}/{self._options.domain}/*/*/*/MP/**"
        tokens = [str(r.ok.key_expr) for r in self._session.liveliness().get(pattern) if r.ok]
        there = sorted({t.split("/")[9].replace("%", "/") for t in tokens if DDS_CLOUD in t})
        return (
            f"no cloud on {self._options.topic} for {SILENCE_S:.0f} s; domain "
            f"{self._options.domain} through {', '.join(self._options.ros)} has "
            + (f"clouds on {', '.join(there)}" if there else f"no topic of {CLOUD}")
        )


def message(keys: Keys, run: int, number: int, sweep: Sweep) -> bytes:
    """A Sweep message (schemas/sweep.fbs)."""
    import flatbuffers

    header_of, sweep_of = messages.module("Header"), messages.module("Sweep")
    b = flatbuffers.Builder(sweep.points.nbytes + 1024)
    names = [b.CreateString(text) for text in (keys.robot, keys.sensor, "lidar", "ros-lidar")]
    b.StartVector(sweep.points.itemsize, len(sweep.points), 4)
    b.head -= sweep.points.nbytes
    b.Bytes[b.head : b.head + sweep.points.nbytes] = sweep.points.tobytes()
    points_at = b.EndVector()
    header_of.Start(b)
    header_of.AddRobot(b, names[0])
    header_of.AddSensor(b, names[1])
    header_of.AddFrame(b, names[2])
    header_of.AddInstance(b, names[3])
    header_of.AddRun(b, run)
    header_of.AddSweep(b, number)
    header_of.AddSeq(b, number)
    header_of.AddStampNs(b, sweep.stamp_ns)
    header = header_of.End(b)
    sweep_of.Start(b)
    sweep_of.AddHeader(b, header)
    sweep_of.AddPoints(b, points_at)
    sweep_of.AddRings(b, sweep.rings)
    sweep_of.AddPeriodNs(b, sweep.period_ns)
    sweep_of.AddDeskewed(b, sweep.deskewed)
    sweep_of.AddComplete(b, True)
    b.Finish(sweep_of.End(b), file_identifier=messages.KINDS["Sweep"].identifier)
    return bytes(b.Output())


class Kept:
    """The last sweeps, for stages that query one by its number (docs/protocol.md, section 3): the
    first messages over a link that has just come up may be lost."""

    def __init__(self, session: Any, key: str, encoding: str) -> None:
        self._key, self._encoding = key, encoding
        self._messages: deque[tuple[int, int, bytes]] = deque(maxlen=KEPT)
        self._queryable = session.declare_queryable(key, self._answer, complete=True)

    def add(self, run: int, number: int, payload: bytes) -> None:
        self._messages.append((run, number, payload))

    def _answer(self, query: Any) -> None:
        asked = asked_for(str(query.parameters))
        if asked is None:
            return
        run, first, last = asked
        for of_run, number, payload in tuple(self._messages):
            if of_run == run and first <= number <= last:
                query.reply(self._key, payload, encoding=self._encoding)


def asked_for(parameters: str) -> tuple[int, int, int] | None:
    """Run, first and last sweep of `run=R;sweep=A..B`, both included; None: another query."""
    match = re.fullmatch(r"run=(\d+);sweep=(\d+)\.\.(\d+)", parameters)
    return (int(match[1]), int(match[2]), int(match[3])) if match else None


def run(options: Options) -> int:
    """Publishes sweeps until interrupted; raises Refused if the clouds cannot be interpreted."""
    with open_session(options.ros) as ros, open_session(options.connect) as robot:
        topic = Topic(ros, options)
        encoding = messages.encoding("Sweep")
        publisher = robot.declare_publisher(options.keys.sweep, encoding=encoding)
        lidar = Lidar(options, topic, publisher, Kept(robot, options.keys.sweep, encoding))
        try:
            lidar.publish()
        finally:
            lidar.say()
    return 0


class Lidar:
    """Publishes a topic's clouds as sweeps."""

    def __init__(self, options: Options, topic: Topic, publisher: Any, kept: Kept) -> None:
        self._options, self._topic, self._publisher = options, topic, publisher
        self._kept = kept
        self._sweeper = Sweeper(options.timing)
        self._run, self._count, self._untaken = time.time_ns(), 0, 0

    def publish(self) -> None:
        """Publishes without end. Clouds that came while their interpretation was inferred are
        dropped as old; sweeps before the first subscriber are not numbered, so that a run begins
        with sweep 0."""
        sweeps = self._sweeper.sweeps(self._topic.clouds(), live=True)
        next(sweeps)
        print(f"{self._options.topic}: {'; '.join(self._sweeper.said)}", flush=True)
        self._topic.dropped = 0
        self._topic.forget()
        said = 0.0
        for sweep in sweeps:
            if self._count or self._publisher.matching_status.matching:
                keys, number = self._options.keys, self._count
                made = message(keys, self._run, number, sweep)
                self._kept.add(self._run, number, made)
                self._publisher.put(made)
                self._count += 1
            else:
                self._untaken += 1
            if time.monotonic() - said > SAY_EVERY_S:
                said = time.monotonic()
                self.say()

    def say(self) -> None:
        """Prints the number of sweeps, and what was left out."""
        topic, line = self._topic, f"{self._count} sweeps"
        if self._untaken:
            line += f", {self._untaken} before a registration took them"
        if topic.dropped:
            line += f", {topic.dropped} clouds dropped, which came too fast for this machine"
        if topic.unread:
            line += f", {topic.unread} messages that are no {CLOUD}"
        for remark in self._sweeper.remarks():
            line += f", {remark}"
        if not self._publisher.matching_status.matching:
            line += f"; no registration of robot {self._options.keys.robot} is there"
        print(line, flush=True)
