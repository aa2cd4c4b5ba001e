"""PointCloud2 messages as drivers publish them: variants of one drive, written by the library
rosbags.

The points of a simulated drive, as the decoder gives them, are laid out in each of the ways that
occur in bags. Reading must give the same points with the same times and rings.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.acceptance.point_files import DECODED_POINT

CLOUD = "sensor_msgs/msg/PointCloud2"
TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
PERIOD_NS = 100_000_000


@dataclass(frozen=True)
class Scan:
    """One revolution: returns in time order."""

    stamp_ns: int
    xyz: NDArray[np.float32]
    intensity: NDArray[np.float32]
    ring: NDArray[np.uint16]
    time_ns: NDArray[np.int64]


@dataclass(frozen=True)
class Layout:
    """The layout of a driver's clouds."""

    #: name and numpy type of the time field; empty: no such field
    time: tuple[str, str] = ("t", "u4")
    unit_ns: float = 1.0
    #: origin of the times: first, last, middle, epoch, start (of the sensor)
    origin: str = "first"
    ring: tuple[str, str] = ("ring", "u2")
    #: published ring number of each rank
    ring_of: Callable[[NDArray[Any]], NDArray[Any]] = lambda ranks: ranks
    xyz: str = "f4"
    more: tuple[tuple[str, str], ...] = ()
    big_endian: bool = False
    #: bytes between fields, and at the end of rows
    padding: int = 0
    row_padding: int = 0
    organised: bool = False
    shuffled: bool = False
    #: adds the placeholders that drivers publish for missing returns
    nan_returns: bool = False


def decoded(build: Path, capture: Path, folder: Path) -> list[Scan]:
    """The scans that zloam-decode makes of a capture."""
    points = folder / "points.bin"
    program = build / "bin" / "zloam-decode"
    subprocess.run([program, "--pcap", capture, "--out", points], check=True, capture_output=True)
    records = np.fromfile(points, DECODED_POINT)
    scans = []
    for number in np.unique(records["sweep"]):
        r = records[records["sweep"] == number]
        stamp_ns = int(r["time_ns"][0])
        scans.append(Scan(stamp_ns, r["xyz"], r["intensity"], r["ring"], r["time_ns"] - stamp_ns))
    return scans


def _times(scan: Scan, layout: Layout) -> tuple[int, NDArray[Any]]:
    """The header's stamp, and the values of the time field."""
    last = int(scan.time_ns[-1])
    zero = {"first": 0, "last": last, "middle": last // 2}.get(layout.origin, 0)
    stamp_ns = scan.stamp_ns + zero
    values = scan.time_ns - zero
    if layout.origin == "epoch":
        values = scan.time_ns + scan.stamp_ns
    if layout.origin == "start":
        values = scan.time_ns + scan.stamp_ns - 1_600_000_000 * 10**9
    kind = np.dtype(layout.time[1])
    if kind.kind in "iu":
        return stamp_ns, np.rint(values / layout.unit_ns).astype(kind)
    return stamp_ns, (values / layout.unit_ns).astype(kind)


def _columns(scan: Scan, layout: Layout) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {}
    for axis, name in enumerate("xyz"):
        columns[name] = scan.xyz[:, axis].astype(layout.xyz)
    columns["intensity"] = scan.intensity.astype("f4")
    if layout.ring[0]:
        columns[layout.ring[0]] = layout.ring_of(scan.ring).astype(layout.ring[1])
    if layout.time[0]:
        columns[layout.time[0]] = _times(scan, layout)[1]
    for name, kind in layout.more:
        columns[name] = np.zeros(len(scan.xyz), kind)
    return columns


def _organised(columns: dict[str, NDArray[Any]], scan: Scan) -> dict[str, NDArray[Any]]:
    """One row per ring, from the top; empty cells are NaN."""
    rings = int(scan.ring.max()) + 1
    counts = np.bincount(scan.ring, minlength=rings)
    place = np.zeros(len(scan.ring), np.int64)
    for ring in range(rings):
        place[scan.ring == ring] = np.arange(counts[ring])
    out = {}
    for name, values in columns.items():
        empty = np.nan if values.dtype.kind == "f" else 0
        grid = np.full((rings, counts.max()), empty, values.dtype)
        grid[rings - 1 - scan.ring, place] = values
        out[name] = grid
    return out


def _with_nan(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    out = {}
    for name, values in columns.items():
        more = np.full(50, np.nan if name in "xyz" else 0).astype(values.dtype)
        out[name] = np.concatenate([values, more])
    return out


def message(types: dict[str, Any], scan: Scan, layout: Layout) -> Any:
    """A PointCloud2 with the types of a rosbags type store."""
    columns = _columns(scan, layout)
    if layout.nan_returns:
        columns = _with_nan(columns)
    if layout.shuffled:
        places = np.random.default_rng(1).permutation(len(columns["x"]))
        columns = {name: values[places] for name, values in columns.items()}
    if layout.organised:
        columns = _organised(columns, scan)
    shape = columns["x"].shape
    height, width = shape if len(shape) == 2 else (1, shape[0])
    order, offset = ">" if layout.big_endian else "<", 0
    fields: list[Any] = []
    formats: list[str] = []
    offsets: list[int] = []
    Field = types["sensor_msgs/msg/PointField"]
    for name, values in columns.items():
        fields.append(Field(name, offset, TYPES[values.dtype.str[1:]], 1))
        formats.append(order + values.dtype.str[1:])
        offsets.append(offset)
        offset += values.dtype.itemsize + layout.padding
    names = list(columns)
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": offset})
    grid = np.zeros((height, width), record)
    for name, values in columns.items():
        grid[name] = values.reshape(height, width)
    rows = grid.view(np.uint8).reshape(height, -1)
    data = np.pad(rows, ((0, 0), (0, layout.row_padding))).ravel()
    stamp_ns = _times(scan, layout)[0] if layout.time[0] else scan.stamp_ns
    return types[CLOUD](
        _header(types, stamp_ns),
        height,
        width,
        fields,
        layout.big_endian,
        offset,
        width * offset + layout.row_padding,
        data,
        True,
    )


def _header(types: dict[str, Any], stamp_ns: int) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    Header = types["std_msgs/msg/Header"]
    has_number = "seq" in Header.__dataclass_fields__
    return Header(**({"seq": 0} if has_number else {}), stamp=stamp, frame_id="lidar")


@dataclass(frozen=True)
class Container:
    """A file format of bags."""

    name: str
    version: int = 2
    plugin: StoragePlugin = StoragePlugin.SQLITE3
    #: rosbag 1: bz2 or lz4; rosbag 2: compression per message or per file
    compression: str = ""


CONTAINERS = (
    Container("rosbag1", 1),
    Container("rosbag1-bz2", 1, compression="bz2"),
    Container("rosbag1-lz4", 1, compression="lz4"),
    Container("sqlite3"),
    Container("sqlite3-zstd", compression="message"),
    Container("sqlite3-zstd-file", compression="file"),
    Container("mcap", plugin=StoragePlugin.MCAP),
    Container("mcap-zstd", plugin=StoragePlugin.MCAP, compression="message"),
)


def _writer(container: Container, path: Path) -> Any:
    wanted = container.compression.upper()
    if container.version == 1:
        one: Any = Writer1(path)
        if wanted:
            one.set_compression(one.CompressionFormat[wanted])
        return one
    two: Any = Writer2(path, version=9, storage_plugin=container.plugin)
    if wanted:
        two.set_compression(CompressionMode[wanted], CompressionFormat.ZSTD)
    return two


IMU = "sensor_msgs/msg/Imu"
VELODYNE = "velodyne_msgs/msg/VelodyneScan"
#: as in Autoware's driver
NEBULA = {
    "nebula_msgs/msg/NebulaPacket": "builtin_interfaces/Time stamp\nuint8[] data\n",
    "nebula_msgs/msg/NebulaPackets": "std_msgs/Header header\nnebula_msgs/NebulaPacket[] packets\n",
}
OUSTER = "ouster_sensor_msgs/msg/PacketMsg"
#: as in the manufacturer's drivers (CustomMsg.msg, CustomPoint.msg)
LIVOX = {
    "livox_ros_driver2/msg/CustomPoint": "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\n"
    "uint8 reflectivity\nuint8 tag\nuint8 line\n",
    "livox_ros_driver2/msg/CustomMsg": "std_msgs/Header header\nuint64 timebase\n"
    "uint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nlivox_ros_driver2/CustomPoint[] points\n",
}


@dataclass
class Recorder:
    """Writes topics into one bag."""

    container: Container
    path: Path
    topics: dict[str, str] = field(default_factory=dict)

    def __enter__(self) -> Recorder:
        first = self.container.version == 1
        self.store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
        packet = f"{'time' if first else 'builtin_interfaces/Time'} stamp\nuint8[1206] data\n"
        self.store.register(get_types_from_msg(packet, "velodyne_msgs/msg/VelodynePacket"))
        scan = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
        self.store.register(get_types_from_msg(scan, VELODYNE))
        for name, text in {**LIVOX, **NEBULA, OUSTER: "uint8[] buf\n"}.items():
            self.store.register(get_types_from_msg(text, name))
        self._writer = _writer(self.container, self.path)
        self._writer.__enter__()
        self._connections: dict[str, Any] = {}
        return self

    def __exit__(self, *how: Any) -> None:
        self._writer.__exit__(*how)

    @property
    def types(self) -> dict[str, Any]:
        return self.store.types

    def put(self, topic: str, kind: str, stamp_ns: int, value: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self.store
            )
        serialize = (
            self.store.serialize_ros1 if self.container.version == 1 else self.store.serialize_cdr
        )
        self._writer.write(self._connections[topic], stamp_ns, serialize(value, kind))

    def put_cloud(self, topic: str, scan: Scan, layout: Layout) -> None:
        self.put(topic, CLOUD, scan.stamp_ns + PERIOD_NS, message(self.types, scan, layout))

    def put_nebula(self, topic: str, packets: Sequence[tuple[int, bytes]]) -> None:
        Packet, Packets = (self.types[name] for name in NEBULA)
        Time = self.types["builtin_interfaces/msg/Time"]
        all_of = [Packet(Time(*divmod(t, 10**9)), np.frombuffer(d, np.uint8)) for t, d in packets]
        scan = Packets(_header(self.types, packets[0][0]), all_of)
        self.put(topic, next(reversed(NEBULA)), packets[-1][0], scan)

    def put_ouster(self, topic: str, packets: Sequence[tuple[int, bytes]]) -> None:
        """Writes one message per packet, as ouster-ros does."""
        for stamp_ns, data in packets:
            message = self.types[OUSTER](np.frombuffer(data, np.uint8))
            self.put(topic, OUSTER, stamp_ns, message)

    def put_static(self, transforms: Sequence[tuple[str, str, Sequence[float], Any]]) -> None:
        """Writes (parent, child, translation, quaternion x y z w), as robot_state_publisher
        does."""
        Transform = self.types["geometry_msgs/msg/TransformStamped"]
        Vector = self.types["geometry_msgs/msg/Vector3"]
        Quaternion = self.types["geometry_msgs/msg/Quaternion"]
        all_of = [
            Transform(
                replace(_header(self.types, 0), frame_id=parent),
                child,
                self.types["geometry_msgs/msg/Transform"](
                    Vector(*map(float, xyz)), Quaternion(*map(float, q))
                ),
            )
            for parent, child, xyz, q in transforms
        ]
        kind = "tf2_msgs/msg/TFMessage"
        self.put("/tf_static", kind, 1, self.types[kind](all_of))

    def put_imu(
        self,
        topic: str,
        stamp_ns: int,
        rate: NDArray[Any],
        force: NDArray[Any],
        frame: str = "lidar",
        unmeasured: str = "",
    ) -> None:
        """unmeasured: name of the covariance that says so."""
        Vector = self.types["geometry_msgs/msg/Vector3"]
        unknown = np.zeros(9)
        value = self.types[IMU](
            replace(_header(self.types, stamp_ns), frame_id=frame),
            self.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            unknown,
            Vector(*map(float, rate)),
            unknown,
            Vector(*map(float, force)),
            unknown,
        )
        if unmeasured:
            value = replace(value, **{unmeasured: np.array([-1.0, *np.zeros(8)])})
        self.put(topic, IMU, stamp_ns, value)

    def put_livox(self, topic: str, scan: Scan) -> None:
        """Points of four lasers; a firing without a return has zero coordinates."""
        Point, Custom = (self.types[name] for name in LIVOX)
        points = [
            Point(int(t), *map(float, xyz), int(i), 0, int(ring) % 4)
            for xyz, i, ring, t in zip(
                scan.xyz, scan.intensity, scan.ring, scan.time_ns, strict=True
            )
        ]
        points.insert(1, Point(int(scan.time_ns[0]), 0.0, 0.0, 0.0, 0, 0, 1))
        value = Custom(
            _header(self.types, scan.stamp_ns),
            scan.stamp_ns,
            len(points),
            1,
            np.zeros(3, np.uint8),
            points,
        )
        self.put(topic, next(reversed(LIVOX)), scan.stamp_ns + PERIOD_NS, value)

    def put_packets(self, topic: str, packets: Sequence[tuple[int, bytes]]) -> None:
        Packet = self.types["velodyne_msgs/msg/VelodynePacket"]
        Time = self.types["builtin_interfaces/msg/Time"]
        all_of = [Packet(Time(*divmod(t, 10**9)), np.frombuffer(d, np.uint8)) for t, d in packets]
        scan = self.types[VELODYNE](_header(self.types, packets[0][0]), all_of)
        self.put(topic, VELODYNE, packets[-1][0], scan)


def write(
    path: Path, scans: Sequence[Scan], layout: Layout, container: Container = CONTAINERS[3]
) -> Path:
    """Writes a bag with one topic of clouds."""
    with Recorder(container, path) as bag:
        for scan in scans:
            bag.put_cloud("/points", scan, layout)
    return path


US, MS, S = 1e3, 1e6, 1e9
PLAIN = Layout()
#: layouts that can be read, and the accuracy of the times in ns
READABLE: dict[str, tuple[Layout, int]] = {
    "ouster: t, ns from the first": (PLAIN, 0),
    "velodyne: time, float s to the last": (
        replace(PLAIN, time=("time", "f4"), unit_ns=S, origin="last"),
        20,
    ),
    "hesai, robosense: timestamp, double s since 1970": (
        replace(PLAIN, time=("timestamp", "f8"), unit_ns=S, origin="epoch"),
        300,
    ),
    "livox driver: timestamp, double ns since 1970": (
        replace(PLAIN, time=("timestamp", "f8"), origin="epoch", ring=("line", "u1")),
        300,
    ),
    "time_stamp, us, integer": (replace(PLAIN, time=("time_stamp", "u4"), unit_ns=US), 1000),
    "offset_time, float ms": (replace(PLAIN, time=("offset_time", "f4"), unit_ns=MS), 20),
    "around the middle": (
        replace(PLAIN, time=("t", "i4"), origin="middle"),
        0,
    ),
    "since the sensor's start, us": (
        replace(PLAIN, time=("t", "f8"), unit_ns=US, origin="start"),
        1000,
    ),
    "big-endian, double coordinates, padded": (
        replace(PLAIN, big_endian=True, xyz="f8", padding=3, row_padding=7),
        0,
    ),
    "organised, no ring, NaN for no return": (
        replace(PLAIN, organised=True, ring=("", ""), row_padding=16),
        0,
    ),
    "no ring, not organised": (replace(PLAIN, ring=("", "")), 0),
    "rings from the top, floats, in any order": (
        replace(
            PLAIN,
            ring=("channel", "f4"),
            ring_of=lambda ranks: 15 - ranks,
            shuffled=True,
            nan_returns=True,
        ),
        0,
    ),
}
#: ambiguous layouts, and what the refusal has to name: the field, and the key that settles it
REFUSED: dict[str, tuple[Layout, tuple[str, ...]]] = {
    "no time": (replace(PLAIN, time=("", "")), ("driver.time_field", "driver.time_model")),
    "all times zero": (
        replace(PLAIN, time=("time", "f4"), unit_ns=1e30),
        ("field time", "driver.time_model=deskewed"),
    ),
    "two times": (
        replace(PLAIN, more=(("timestamp", "f8"),)),
        ("t and timestamp", "driver.time_field"),
    ),
    "a number that is no time": (
        replace(PLAIN, time=("time", "f4"), unit_ns=3e4),
        ("field time", "no unit", "driver.time_field"),
    ),
}
