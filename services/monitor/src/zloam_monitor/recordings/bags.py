"""Reads bags (ROS 1, ROS 2 with SQLite or MCAP) and MCAP files by the library rosbags."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zloam_monitor.recordings import CutOff, Refused, first_line, livox, parts
from zloam_monitor.recordings.fields import stamp_ns

CLOUD = "sensor_msgs/msg/PointCloud2"
IMU = "sensor_msgs/msg/Imu"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
TF_TOPIC = "/tf_static"
VELODYNE = "velodyne_msgs/msg/VelodyneScan"
NEBULA = "nebula_msgs/msg/NebulaPackets"
#: Messages with one packet, without a time stamp.
OUSTER = ("ouster_sensor_msgs/msg/PacketMsg", "ouster_ros/msg/PacketMsg")
#: Message types that the driver can use -> their content.
KINDS = {
    CLOUD: "clouds",
    **dict.fromkeys(livox.KINDS, "clouds"),
    **dict.fromkeys((VELODYNE, NEBULA, *OUSTER), "packets"),
}
#: Definitions of messages that ROS 2 bags do not describe themselves.
FOREIGN = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    VELODYNE: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
    "nebula_msgs/msg/NebulaPacket": "builtin_interfaces/Time stamp\nuint8[] data\n",
    NEBULA: "std_msgs/Header header\nnebula_msgs/NebulaPacket[] packets\n",
    **dict.fromkeys(OUSTER, "uint8[] buf\n"),
    **livox.TYPES,
}
#: First bytes of the recordings that can be read -> what helps if such a file was cut off.
MAGICS = {
    b"#ROSBAG V": "`rosbag reindex` writes its index; its name must end in .bag",
    b"SQLite format 3": "`sqlite3 FILE .recover` shows what is left of it",
    b"\x89MCAP": "`mcap recover FILE -o NEW` makes a whole file of what is left",
}
#: Files of bags with several files.
PARTS = ("*.db3", "*.mcap", "*.db3.zstd", "*.mcap.zstd")
#: Bytes at both ends of each file that its identity is computed from: a bag may have 100 GB.
IDENTIFYING_BYTES = 1 << 20


@dataclass(frozen=True)
class Packet:
    received_ns: int
    data: bytes


@dataclass(frozen=True)
class Topic:
    name: str
    #: A key of KINDS.
    kind: str
    messages: int

    @property
    def content(self) -> str:
        """Content of the messages: clouds or packets."""
        return KINDS.get(self.kind, "clouds")

    def __str__(self) -> str:
        return f"{self.name} ({self.kind.split('/')[-1]}, {self.messages} messages)"


def is_recording(path: Path) -> bool:
    return (path / "metadata.yaml").is_file() or _magic(path) is not None


def _magic(path: Path) -> bytes | None:
    """The key of MAGICS with which the file begins; None: it is no such file."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        begin = file.read(16)
    return next((magic for magic in MAGICS if begin.startswith(magic)), None)


def without_metadata(path: Path) -> str:
    """What helps if the folder is a bag whose recorder was ended before it wrote metadata.yaml;
    empty: it is none."""
    if not path.is_dir() or (path / "metadata.yaml").exists():
        return ""
    found = sorted(file for kind in PARTS for file in path.glob(kind))
    if not found:
        return ""
    return (
        "the folder has no metadata.yaml, which a recorder writes at its end: name a file in it, "
        f"such as {found[0].name}, or make one by `ros2 bag reindex`"
    )


def _refuse_unfinished(path: Path) -> None:
    """Refuses a bag whose last messages are not in its files yet: without SQLite's log the library
    would read those before, and perhaps halves of pages."""
    if reason := without_metadata(path):
        raise Refused(reason)
    for each in files_of(path):
        log = each.with_name(f"{each.name}-wal")
        if _magic(each) == b"SQLite format 3" and log.is_file() and log.stat().st_size:
            raise Refused(
                f"{log.name} has messages that are not in {each.name} yet: end the recorder, or if "
                f"it was killed, run: sqlite3 '{each}' 'PRAGMA wal_checkpoint'"
            )


def files_of(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]


def identity(path: Path) -> str:
    """SHA-256, in hexadecimal, of name, size and both ends of each file."""
    known = hashlib.sha256()
    for each in files_of(path):
        size = each.stat().st_size
        known.update(f"{each.name} {size}\n".encode())
        with each.open("rb") as file:
            known.update(file.read(IDENTIFYING_BYTES))
            file.seek(max(0, size - IDENTIFYING_BYTES))
            known.update(file.read(IDENTIFYING_BYTES))
    return known.hexdigest()


def _advice(path: Path, error: str) -> str:
    """What helps against an error of the library."""
    if "unable to open database file" in error and any(sign in error for sign in "?#%"):
        return "; the library can't open a path with ?, # or % in it: rename folder or file"
    advice = MAGICS.get(_magic(path) or b"")
    return f"; if it was cut off: {advice}" if advice else ""


class Bag:
    """A bag, which is open within the context of opened()."""

    def __init__(self, path: Path, reader: Any) -> None:
        self.path = path
        self._reader = reader
        #: Topic -> number of its messages that could not be read, and the first one's error.
        self._unread: dict[str, tuple[int, str]] = {}
        # A driver that was restarted has a connection for each of its starts.
        messages = Counter[tuple[str, str]]()
        for each in reader.connections:
            if each.msgtype in KINDS:
                messages[(each.topic, each.msgtype)] += each.msgcount
        self.topics = [Topic(*named, count) for named, count in sorted(messages.items())]

    def choose(self, name: str) -> Topic:
        """The topic of this name, or the only one; raises Refused otherwise."""
        meant = [t for t in self.topics if name in ("", t.name)]
        full = [t for t in meant if t.messages]
        # Packets are preferred to clouds, which a driver has computed from them.
        packets = [t for t in full if t.content == "packets"]
        if len(packets or full) == 1:
            return (packets or full)[0]
        if len(full) > 1:
            listed = ", ".join(map(str, full))
            # An Ouster's packets have two topics of one type: that of its IMU has fewer.
            fullest = max(packets or full, key=lambda t: t.messages)
            raise Refused(f"several topics: {listed}; say which by driver.topic={fullest.name}")
        listed = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in self._reader.connections}))
        named = f"no messages of a lidar on {name}" if name else "no messages of a lidar"
        raise Refused(f"{named} ({', '.join(KINDS)}) in it; it has {listed or 'no topic'}")

    def choose_imu(self, name: str) -> str:
        """The IMU topic of this name, or the only one; raises Refused otherwise."""
        counts = Counter[str]()
        for each in self._reader.connections:
            if each.msgtype == IMU:
                counts[str(each.topic)] += each.msgcount
        meant = [t for t, count in sorted(counts.items()) if count and name in ("", t)]
        if len(meant) == 1:
            return meant[0]
        if not meant:
            listed = ", ".join(f"{t} ({n} messages)" for t, n in sorted(counts.items())) or "none"
            asked = name or "of inertial readings"
            raise Refused(f"no topic {asked} ({IMU}) with messages; there is {listed}")
        raise Refused(
            f"several topics of inertial readings: {', '.join(meant)}; say which by "
            f"driver.imu_topic={meant[0]}"
        )

    def remarks(self) -> list[str]:
        """Texts about irregularities; complete after the last message."""
        return [
            f"left out, as unreadable: {count} message{'s' if count > 1 else ''} of {topic}; {why}"
            for topic, (count, why) in sorted(self._unread.items())
        ]

    def _read(self, wanted: list[Any]) -> Iterator[tuple[Any, int, Any]]:
        """Connection, time of recording in ns and message; unreadable messages are left out and
        reported by remarks(). Raises CutOff."""
        entries = iter(self._reader.messages(connections=wanted))
        while True:
            try:
                entry = next(entries, None)
            except Refused:
                raise
            except Exception as error:  # The library has error types of its own for each format.
                raise CutOff(f"it cannot be read: {first_line(error)}") from error
            if entry is None:
                return
            connection, recorded_ns, raw = entry
            try:
                message = self._reader.deserialize(raw, connection.msgtype)
            except Exception as error:  # As above.
                before, why = self._unread.get(connection.topic, (0, first_line(error)))
                self._unread[connection.topic] = before + 1, why
                continue
            yield connection, recorded_ns, message

    def static_transforms(self) -> Iterator[Any]:
        """All messages with static transforms, in their order."""
        there = self._reader.connections
        wanted = [c for c in there if c.topic.endswith(TF_TOPIC) and c.msgtype in TRANSFORMS]
        if wanted:
            yield from (message for *_, message in self._read(wanted))

    def frame_of(self, topic: str) -> str | None:
        """Frame of the topic's first message; None: its messages have no header."""
        wanted = [c for c in self._reader.connections if c.topic == topic]
        _, _, message = next(self._read(wanted), (None, 0, None))
        header = getattr(message, "header", None)
        return None if header is None else str(header.frame_id)

    def messages(self, topic: Topic, imu: str = "") -> Iterator[Any]:
        """Messages of the topic, and of the IMU topic if named, in the order of recording.

        Packets come as lists of Packet.
        """
        wanted = [c for c in self._reader.connections if c.topic in (topic.name, imu)]
        self._unread.clear()
        read = 0
        for connection, recorded_ns, message in self._read(wanted):
            read += connection.topic == topic.name
            if connection.msgtype in OUSTER:
                yield [Packet(recorded_ns, bytes(message.buf))]
            elif connection.msgtype in (VELODYNE, NEBULA):
                yield [Packet(stamp_ns(p.stamp), bytes(p.data)) for p in message.packets]
            else:
                yield message
        if not read and topic.name in self._unread:
            count, why = self._unread[topic.name]
            raise Refused(f"none of its {count} messages can be read; {why}")


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Opens a bag; raises Refused with the library's message, or OSError."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in FOREIGN.items():
        store.register(get_types_from_msg(text, name))
    path.stat()
    _refuse_unfinished(path)
    try:
        metadata = parts.about(path)
        reader: Any = (
            AnyReader([path], default_typestore=store)
            if metadata is None
            else parts.Parts(path, metadata, store)
        )
        reader.open()
    except OSError:
        raise
    except Exception as error:  # The library has error types of its own for each format.
        raise Refused(f"cannot be read: {first_line(error)}{_advice(path, str(error))}") from error
    try:
        yield Bag(path, reader)
    finally:
        reader.close()
