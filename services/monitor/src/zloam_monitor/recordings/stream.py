"""Frames for the driver (services/driver/io/recording.hpp), and the command that writes them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from zloam_monitor.recordings import Refused, bags
from zloam_monitor.recordings.bags import Bag, Topic
from zloam_monitor.recordings.fields import stamp_ns
from zloam_monitor.recordings.sweeps import Sweep, Sweeper, Timing

IDENTITY, SWEEP, REMARK, REFUSAL, END, PACKETS = 1, 2, 3, 4, 5, 6
HEAD = struct.Struct("<4sIQ")
SWEEP_HEAD = struct.Struct("<qIHBB")
PACKET_HEAD = struct.Struct("<qHHI")


class Frames:
    """Written to a pipe."""

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


def write(path: Path, topic: str, timing: Timing, out: BinaryIO) -> int:
    """The whole recording; 0, or 1 when it is refused, which is in the frames."""
    frames = Frames(out)
    try:
        with bags.opened(path) as bag:
            chosen = bag.choose(topic)
            frames.text(IDENTITY, f"{bags.KINDS[chosen.kind]} {bags.identity(path)}")
            if chosen.kind == bags.CLOUD:
                _write_sweeps(bag, chosen, timing, frames)
            else:
                _write_packets(bag, chosen, frames)
    except BrokenPipeError:
        return 1
    except (Refused, OSError) as error:
        frames.text(REFUSAL, str(error))
        return 1
    frames.text(END, "")
    return 0


def _write_sweeps(bag: Bag, topic: Topic, timing: Timing, frames: Frames) -> None:
    sweeper = Sweeper(timing)
    for sweep in sweeper.sweeps(whole(bag, topic, frames)):
        frames.sweep(sweep)
    for remark in sweeper.remarks():
        frames.text(REMARK, f"{topic.name}: {remark}")


def whole(bag: Bag, topic: Topic, frames: Frames) -> Iterator[Any]:
    """What can be read: of a recording that was cut off, what is whole."""
    count = 0
    messages = bag.messages(topic)
    while True:
        try:
            message = next(messages, None)
        except Exception as error:  # the library has errors of its own for each format
            text = f"after {count} messages it cannot be read: {type(error).__name__}: {error}"
            if not count:
                raise Refused(text) from error
            frames.text(REMARK, f"{topic.name}: {text}; what is whole is used")
            return
        if message is None:
            return
        count += 1
        yield message


def _write_packets(bag: Bag, topic: Topic, frames: Frames) -> None:
    for scan in whole(bag, topic, frames):
        parts: list[bytes] = []
        for packet in scan.packets:
            data = bytes(packet.data)
            parts += [PACKET_HEAD.pack(stamp_ns(packet.stamp), len(data), 0, 0), data]
        frames.put(PACKETS, *parts)


def described(path: Path, topic: str, timing: Timing) -> Iterator[str]:
    """What is in it, and how it would be read; raises Refused."""
    with bags.opened(path) as bag:
        yield from (f"{t}" for t in bag.topics)
        chosen = bag.choose(topic)
        yield f"replayed: {chosen.name}"
        if chosen.kind == bags.CLOUD:
            sweeper = Sweeper(timing)
            next(iter(sweeper.sweeps(bag.messages(chosen))), None)
            yield from sweeper.said
