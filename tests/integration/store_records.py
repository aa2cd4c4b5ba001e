"""Records in the files of a tile store (services/store/record_log.hpp)."""

from __future__ import annotations

import struct
from pathlib import Path


def crc32c(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def append_unknown(folder: Path) -> None:
    """Appends a record that is whole, but of a kind that only a later version could know."""
    body = b"\xffa later version"
    with max(folder.glob("*.log")).open("ab") as log:
        log.write(struct.pack("<II", len(body), crc32c(body)) + body)
