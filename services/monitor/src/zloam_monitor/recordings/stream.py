"""Frames for the driver (services/driver/io/recording.hpp), and the command that writes them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from zloam_monitor.recordings import CutOff, Refused, bags, folders, robot_log
from zloam_monitor.recordings.bags import Bag, Topic
from zloam_monitor.recordings.fields import stamp_ns
from zloam_monitor.recordings.folders import Folder
from zloam_monitor.recordings.robot_log import RobotLog
from zloam_monitor.recordings.sweeps import JUDGED, Sweep, Sweeper, Timing

IDENTITY, SWEEP, REMARK, REFUSAL, END, PACKETS, READING, MESSAGE = range(1, 9)
HEAD = struct.Struct("<4sIQ")
SWEEP_HEAD = struct.Struct("<qIHBB")
PACKET_HEAD = struct.Struct("<qHHI")
READING_DATA = struct.Struct("<q6d")
#: First number of a covariance in sensor_msgs/Imu if the quantity is not measured.
UNMEASURED = -1.0


class Frames:
    """Writes frames to a pipe."""

    def __init__(self, out: BinaryIO) -> None:
        self._out = out

    def put(self, kind: int, *parts: bytes) -> None:
        self._out.write(HEAD.pack(b"ZLRC", kind, sum(map(len, parts))))
        for part in parts:
            self._out.write(part)

    def text(self, kind: int, text: str) -> None:
        self.put(kind, text.encode())
        self._out.flush()

    def sweep(self, sweep: Sweep) -> None:
        head = SWEEP_HEAD.pack(sweep.stamp_ns, sweep.period_ns, sweep.rings, sweep.deskewed, True)
        self.put(SWEEP, head, sweep.points.tobytes())

    def reading(self, message: Any) -> None:
        force, rate = message.linear_acceleration, message.angular_velocity
        data = READING_DATA.pack(
            stamp_ns(message.header.stamp), force.x, force.y, force.z, rate.x, rate.y, rate.z
        )
        self.put(READING, data)


class Readings:
    """Writes the IMU readings among messages to the frames. Those without an angular rate or an
    acceleration, which sensor_msgs/Imu marks by a covariance of -1, are left out and counted."""

    def __init__(self, frames: Frames, topic: str) -> None:
        self._frames, self._topic = frames, topic
        self._count, self._unmeasured = 0, 0

    def taken_from(self, messages: Iterator[Any]) -> Iterator[Any]:
        """The other messages. Raises Refused if no reading has a rate and an acceleration: by the
        first clouds, before a run begins, or else at the end."""
        others = 0
        for message in messages:
            if hasattr(message, "angular_velocity"):
                self._take(message)
                continue
            others += 1
            if others == JUDGED:
                self._judge()
            yield message
        self._judge()

    def _take(self, message: Any) -> None:
        covariances = message.angular_velocity_covariance, message.linear_acceleration_covariance
        if any(each[0] == UNMEASURED for each in covariances):
            self._unmeasured += 1
            return
        self._count += 1
        self._frames.reading(message)

    def _judge(self) -> None:
        if self._unmeasured and not self._count:
            raise Refused(
                f"{self._topic}: its readings have no angular rate or no acceleration (their "
                "covariance is -1); name another topic by driver.imu_topic, or set "
                "driver.imu=none"
            )

    def remarks(self) -> list[str]:
        """Texts about irregularities; complete after the last message."""
        if not self._unmeasured:
            return []
        return [
            f"{self._topic}: left out, as without an angular rate or an acceleration (covariance "
            f"-1): {self._unmeasured} readings"
        ]


def write(
    path: Path, topic: str, timing: Timing, out: BinaryIO, imu_topic: str | None = None
) -> int:
    """Writes the whole recording. Returns 1 if it is refused, which the frames state; else 0.

    imu_topic: topic of the IMU readings to include; "": the only one; None: no readings.
    """
    frames = Frames(out)
    try:
        if robot_log.is_one(path):
            _write_messages(RobotLog(path), frames, imu_topic is not None)
            return 0
        with folders.opened(path, timing.period_s) as bag:
            chosen = bag.choose(topic)
            imu = "" if imu_topic is None else bag.choose_imu(imu_topic)
            frames.text(IDENTITY, f"{chosen.content} {bags.identity(path)}")
            if chosen.content == "clouds":
                _write_sweeps(bag, chosen, timing, frames, imu)
            else:
                _write_packets(bag, chosen, frames, imu)
    except BrokenPipeError:
        return 1
    except (Refused, OSError) as error:
        frames.text(REFUSAL, str(error))
        return 1
    frames.text(END, "")
    return 0


def _write_messages(log: RobotLog, frames: Frames, with_imu: bool) -> None:
    """Writes sweeps as they were published; after each one the IMU readings that it contains. The
    driver publishes a sweep when it has read the next one: readings before that would be added to
    the sweep before, which did not have them."""
    frames.text(IDENTITY, f"messages {bags.identity(log.path)}")
    last_ns: int | None = None
    for sweep in log.sweeps():
        frames.put(MESSAGE, sweep.payload)
        readings = robot_log.imu_of(sweep.payload) if with_imu else []
        for reading in readings:
            if last_ns is None or reading["stamp_ns"] > last_ns:
                last_ns = int(reading["stamp_ns"])
                frames.put(READING, reading.tobytes())
    for remark in log.remarks:
        frames.text(REMARK, remark)
    frames.text(END, "")


def _write_sweeps(
    bag: Bag | Folder, topic: Topic, timing: Timing, frames: Frames, imu: str
) -> None:
    sweeper = Sweeper(timing)
    for sweep in sweeper.sweeps(_of_topic(bag, topic, frames, imu)):
        frames.sweep(sweep)
    for remark in (*sweeper.remarks(), *bag.remarks()):
        frames.text(REMARK, f"{topic.name}: {remark}")


def _of_topic(bag: Bag | Folder, topic: Topic, frames: Frames, imu: str) -> Iterator[Any]:
    """Messages of the topic; IMU readings between them are written to the frames at once."""
    readings = Readings(frames, imu)
    messages = readings.taken_from(bag.messages(topic, imu))
    yield from whole(messages, lambda text: frames.text(REMARK, f"{topic.name}: {text}"))
    for remark in readings.remarks():
        frames.text(REMARK, remark)


def whole(messages: Iterator[Any], remark: Callable[[str], None]) -> Iterator[Any]:
    """Those of the messages that are complete, if the recording is truncated."""
    count = 0
    try:
        for message in messages:
            count += 1
            yield message
    except CutOff as error:
        text = f"after {count} messages {error}"
        if not count:
            raise Refused(text) from error
        remark(f"{text}; what is whole is used")


def _write_packets(bag: Bag | Folder, topic: Topic, frames: Frames, imu: str) -> None:
    for packets in _of_topic(bag, topic, frames, imu):
        parts: list[bytes] = []
        for packet in packets:
            parts += [PACKET_HEAD.pack(packet.received_ns, len(packet.data), 0, 0), packet.data]
        frames.put(PACKETS, *parts)
    for remark in bag.remarks():
        frames.text(REMARK, f"{topic.name}: {remark}")


def described(path: Path, topic: str, timing: Timing) -> Iterator[str]:
    """Texts about the contents of a recording and how it would be read; raises Refused."""
    if robot_log.is_one(path):
        yield from _robot_log_described(RobotLog(path))
        return
    with folders.opened(path, timing.period_s) as bag:
        yield from (f"{t}" for t in bag.topics)
        chosen = bag.choose(topic)
        if isinstance(bag, Folder):
            yield bag.said
        yield f"replayed: {chosen.name}"
        if chosen.content == "clouds":
            sweeper, remarks = Sweeper(timing), list[str]()
            next(iter(sweeper.sweeps(whole(bag.messages(chosen), remarks.append))), None)
            yield from (*sweeper.said, *remarks)


def _robot_log_described(log: RobotLog) -> Iterator[str]:
    about, extent = log.about or {}, log.extent()
    parts = f" in {len(log.parts)} files" if len(log.parts) > 1 else ""
    yield (
        f"recorded by zloam {about.get('version', '')} of robot {about.get('robot', '')}: "
        f"{extent.messages} messages, {extent.seconds:.1f} s{parts}"
    )
    yield "replayed: its sweeps, with the configuration that was in force"
