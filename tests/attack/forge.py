"""Forged messages of a stranger: genuine ones, received from the network, with modified
contents."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator
from typing import Any

import flatbuffers

from zloam_monitor import messages
from zloam_monitor.messages import KINDS, module

FAR_SWEEPS = 900_000
OTHER_TERM = 4_000_000_000
WILD = 1e300
HUGE_BYTES = 40_000_000
#: nesting deeper than any parser's stack
NESTED = 80_000
#: field of a Header -> its FlatBuffers slot
_SLOTS = {"Run": 2, "Sweep": 3, "StampNs": 4, "Seq": 6, "Term": 7, "MapId": 10, "Replay": 15}
_TEXTS = ("Robot", "Sensor", "Frame", "Instance")
#: table -> its field with a pose
_POSES = {
    "Odometry": "PoseOdomBase",
    "OdometryFeatures": "PoseOdomBase",
    "MapCorrection": "PoseMapOdom",
    "MapPose": "PoseMapBase",
}
#: table -> its field with a vector of points
_POINTS = {
    "Sweep": "Points",
    "Features": "Sharp",
    "OdometryFeatures": "Planes",
    "MapTile": "Points",
}


def _own_header(data: bytes, table: str, changes: dict[str, int]) -> bytes:
    """A copy of the message's header with the changes, as a buffer of its own."""
    old = messages.decode(table, data).Header()
    values = {name: getattr(old, name)() for name in _SLOTS} | changes
    b = flatbuffers.Builder(256)
    b.ForceDefaults(True)
    texts = {name: b.CreateString(getattr(old, name)() or b"") for name in _TEXTS}
    code = module("Header")
    code.Start(b)
    for name, value in (texts | values).items():
        getattr(code, "Add" + name)(b, value)
    b.Finish(code.End(b))
    return bytes(b.Output())


def with_header(data: bytes, table: str, **changes: int) -> bytes:
    """The message with another header: it is appended to the message, and the root's offset leads
    to it."""
    header = _own_header(data, table, changes)
    padded = data + b"\0" * (-len(data) % 8)
    root = messages.decode(table, data)
    # The header is the first field of every table.
    field = root._tab.Offset(4) + root._tab.Pos
    target = len(padded) + struct.unpack_from("<I", header)[0]
    forged = bytearray(padded + header)
    struct.pack_into("<I", forged, field, target - field)
    return bytes(forged)


def with_values(data: bytes, table: str, value: float) -> bytes | None:
    """The message with the value in its pose and in its first point; None if it has neither."""
    forged, found = bytearray(data), False
    root = messages.decode(table, data)
    if name := _POSES.get(table):
        struct.pack_into("<d", forged, getattr(root, name)()._tab.Pos, value)
        found = True
    if (name := _POINTS.get(table)) and getattr(root, name + "Length")():
        point = getattr(root, name)(0)._tab.Pos
        struct.pack_into("<f", forged, point, min(value, 3e38) if value == value else value)
        found = True
    return bytes(forged) if found else None


def noise(table: str, rng: random.Random) -> bytes:
    """A valid identifier followed by random bytes."""
    return b"\x08\x00\x00\x00" + KINDS[table].identifier + rng.randbytes(rng.randrange(9, 4000))


Forger = Callable[[bytes, str], bytes | None]


def forgers(rng: random.Random) -> dict[str, Forger]:
    """Name of a forgery -> function that applies it to a genuine message."""

    def run(data: bytes, table: str) -> bytes:
        return with_header(data, table, Run=rng.getrandbits(63) + 1)

    def header_of(data: bytes, table: str) -> Any:
        return messages.decode(table, data).Header()

    def far(data: bytes, table: str) -> bytes:
        header = header_of(data, table)
        number = FAR_SWEEPS + rng.randrange(1000)
        return with_header(data, table, Sweep=header.Sweep() + number, Seq=header.Seq() + number)

    def soon(data: bytes, table: str) -> bytes | None:
        """A message two sweeps ahead, with a pose or point elsewhere."""
        header = header_of(data, table)
        moved = with_values(data, table, 1000.0)
        ahead = {"Sweep": header.Sweep() + 2, "Seq": header.Seq() + 2}
        return moved and with_header(moved, table, **ahead)

    def other_map(data: bytes, table: str) -> bytes:
        return with_header(data, table, MapId=rng.getrandbits(63) + 1)

    return {
        "random bytes": lambda data, table: noise(table, rng),
        "cut short": lambda data, table: data[: rng.randrange(8, len(data))],
        "other run": run,
        "far sweep": far,
        "two sweeps ahead": soon,
        "other term": lambda data, table: with_header(data, table, Term=OTHER_TERM),
        "other map": other_map,
        "as a replay": lambda data, table: with_header(data, table, Replay=1),
        "wild values": lambda data, table: with_values(data, table, WILD),
        "not a number": lambda data, table: with_values(data, table, float("nan")),
    }


def progress(run: int) -> bytes:
    """A message that claims that an odometry has received every sweep already."""
    b = flatbuffers.Builder(256)
    instance = b.CreateString("stranger")
    code = module("Progress")
    code.Start(b)
    code.AddRun(b, run)
    code.AddInstance(b, instance)
    code.AddNextSweep(b, 1 << 60)
    code.AddReceivedBelow(b, 1 << 60)
    b.Finish(code.End(b), KINDS["Progress"].identifier)
    return bytes(b.Output())


def revision(stage: str, values: str, rev: int = 1) -> bytes:
    """A change of configuration that the stranger has no right to issue."""
    b = flatbuffers.Builder(256)
    texts = {"Stage": stage, "ValuesJson": values, "By": "stranger"}
    texts = {name: b.CreateString(value) for name, value in texts.items()}
    code = module("ConfigRevision")
    code.Start(b)
    for name, offset in texts.items():
        getattr(code, "Add" + name)(b, offset)
    code.AddRev(b, rev)
    b.Finish(code.End(b), KINDS["ConfigRevision"].identifier)
    return bytes(b.Output())


def revisions() -> Iterator[tuple[str, bytes]]:
    for stage in ("registration", "odometry", "mapping"):
        yield stage, revision(stage, "{}", 7)
        yield stage, revision(stage, f'{{"{stage}.nothing": 1}}', 8)
        yield stage, revision(stage, "[" * NESTED, 9)
