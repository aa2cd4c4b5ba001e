"""Bags of ROS 2 whose files are compressed as wholes (zstd, mode FILE).

One file is unpacked at a time, into the folder of TMPDIR.
"""

from __future__ import annotations

import errno
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from zloam_monitor.recordings import Refused

#: A frame of zstd has its size in these first bytes.
FRAME_HEAD_BYTES = 18


@dataclass(frozen=True)
class Connection:
    """A topic by the bag's metadata."""

    topic: str
    msgtype: str
    msgcount: int


def about(path: Path) -> dict[str, Any] | None:
    """The bag's metadata if its files are compressed as wholes; None: another recording."""
    file = path / "metadata.yaml"
    if not file.is_file():
        return None
    try:
        found = yaml.safe_load(file.read_bytes())["rosbag2_bagfile_information"]
        compressed = found["compression_mode"].lower(), found["compression_format"]
    except (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError):
        return None  # The library names what is wrong, or the version has no compression.
    return dict(found) if compressed == ("file", "zstd") else None


class Parts:
    """Reads such a bag, with the interface of the library's AnyReader."""

    def __init__(self, path: Path, metadata: dict[str, Any], store: Any) -> None:
        self._files = [path / Path(each).name for each in metadata["relative_file_paths"]]
        self._store = store
        self._part: Any = None
        self.connections = [
            Connection(
                each["topic_metadata"]["name"],
                each["topic_metadata"]["type"],
                int(each["message_count"]),
            )
            for each in metadata["topics_with_message_count"]
        ]

    def open(self) -> None:
        """Raises OSError if a part is missing."""
        for file in self._files:
            file.stat()

    def close(self) -> None:
        """Nothing is left open: messages() removes what it unpacked."""

    def messages(self, connections: list[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Connection, time of recording in ns and message of these topics."""
        from rosbags.highlevel import AnyReader

        topics = {each.topic for each in connections}
        for file in self._files:
            with tempfile.TemporaryDirectory() as folder:
                unpacked = _unpacked(file, Path(folder))
                with AnyReader([unpacked], default_typestore=self._store) as self._part:
                    # Open it stays readable, and nothing is left if this process is ended.
                    unpacked.unlink()
                    if wanted := [c for c in self._part.connections if c.topic in topics]:
                        yield from self._part.messages(connections=wanted)

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """A message that messages() has just given."""
        return self._part.deserialize(raw, kind)


def _unpacked(file: Path, folder: Path) -> Path:
    """The file, unpacked into the folder; refused if it does not fit."""
    if sys.version_info >= (3, 14):  # For which rosbags does not install backports.zstd.
        from compression import zstd
    else:
        from backports import zstd

    with file.open("rb") as packed:
        size = zstd.get_frame_info(packed.read(FRAME_HEAD_BYTES)).decompressed_size or 0
        if size > shutil.disk_usage(folder).free:
            raise _too_large(file, folder)
        packed.seek(0)
        target = folder / file.stem
        try:
            with zstd.open(packed, "rb") as data, target.open("wb") as out:
                shutil.copyfileobj(data, out)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise _too_large(file, folder) from error
            raise
    return target


def _too_large(file: Path, folder: Path) -> Refused:
    return Refused(
        f"{file.name} is compressed as a whole, and unpacked it does not fit into {folder.parent}: "
        "name a folder with room by the environment variable TMPDIR"
    )
