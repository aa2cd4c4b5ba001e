"""Reads sessions independently of the driver: records, replies, checksums, values."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def records(path: Path) -> Iterator[tuple[float, bytes]]:
    """(receive time in s, bytes) of each record."""
    data, at = path.read_bytes(), 0
    while at < len(data):
        seconds, microseconds, length = struct.unpack_from(">III", data, at)
        yield seconds + 1e-6 * microseconds, data[at + 12 : at + 12 + length]
        at += 12 + length


def replies(path: Path) -> list[list[bytes]]:
    whole = b"".join(data for _, data in records(path))
    return [reply.split(b"\n") for reply in whole.split(b"\n\n") if reply]


def checksum(text: bytes) -> int:
    return (sum(text) & 0x3F) + 0x30


def is_whole(reply: list[bytes]) -> bool:
    """Whether all checksums are right; the echo has none."""
    for line in reply[1:]:
        text, last = line[:-1], line[-1]
        if checksum(text) != last and not (text.endswith(b";") and checksum(text[:-1]) == last):
            return False
    return True


def numbers(data: bytes, characters: int) -> NDArray[np.int64]:
    digits = np.frombuffer(data, np.uint8).astype(np.int64).reshape(-1, characters) - 0x30
    weights = 64 ** np.arange(characters - 1, -1, -1)
    return np.asarray(digits @ weights)


@dataclass(frozen=True)
class Scan:
    """The measurements of one reply."""

    first_step: int
    ranges_mm: NDArray[np.int64]
    intensities: NDArray[np.int64]


def scans(path: Path) -> list[Scan]:
    found = []
    for reply in replies(path):
        echo = reply[0]
        if echo[:2] not in (b"MD", b"ME", b"GD", b"GE") or len(reply) < 3:
            continue
        data = b"".join(line[:-1] for line in reply[3:])
        if echo[1:2] == b"E":
            both = numbers(data, 3)
            found.append(Scan(int(echo[2:6]), both[0::2], both[1::2]))
        else:
            ranges = numbers(data, 3)
            found.append(Scan(int(echo[2:6]), ranges, np.zeros_like(ranges)))
    return found
