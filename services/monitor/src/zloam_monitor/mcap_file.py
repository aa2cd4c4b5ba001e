"""An MCAP file that can be opened at any time, also after its writer was killed.

MCAP ends with an index, without which most readers refuse a file. Here each write replaces the
previous index by new messages and a new index. A separate process writes, so that killing this
process cannot interrupt a write (replaced_end.py).
"""

from __future__ import annotations

import contextlib
import copy
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from zloam_monitor import replaced_end
from zloam_monitor.ending import TOLD
from zloam_monitor.failures import FileTrouble

CHUNK_BYTES = 4 << 20
#: Time between writes: the most that is lost when the writer is killed.
SYNC_SECONDS = 0.5


class RecordingError(FileTrouble):
    """The file could not be written; the text says why, and what it contains."""


def reason(error: OSError) -> str:
    """The system's text, or else the program's own."""
    return error.strerror or str(error)


def part_path(path: Path, number: int) -> Path:
    """File of a part of the recording that begins in `path`: NAME.mcap, NAME_2.mcap and so on."""
    return path if number == 1 else path.with_name(f"{path.stem}_{number}{path.suffix}")


def further_parts(path: Path) -> dict[int, Path]:
    """Number -> file, of all files that are named like further parts."""
    named = re.compile(rf"{re.escape(path.stem)}_([1-9]\d{{0,3}}){re.escape(path.suffix)}")
    with contextlib.suppress(OSError):  # The folder may be missing.
        found = [(match[1], p) for p in path.parent.iterdir() if (match := named.fullmatch(p.name))]
        return {int(number): p for number, p in sorted(found) if int(number) > 1}
    return {}


class _Waiting:
    """Output of the MCAP library that is not in the file yet."""

    def __init__(self, at: int = 0) -> None:
        self.at = at
        self.data = bytearray()

    def write(self, data: Any) -> int:
        self.data += data
        return len(data)

    def tell(self) -> int:
        return self.at + len(self.data)

    def flush(self) -> None:
        """Does nothing, because whole() writes the file."""

    def __deepcopy__(self, memo: dict[int, Any]) -> _Waiting:
        return _Waiting(self.tell())


class Disk:
    """The process that writes the file. It ends only when this process closes the pipe or ends:
    Ctrl-C on the terminal does not reach it, nor do the signals that a supervisor such as systemd
    sends to all processes of a service at once."""

    def __init__(self, path: Path) -> None:
        # Inherited as blocked: no signal finds the new process before it could ignore it.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, TOLD)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", replaced_end.__file__, str(path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def replace_end(self, data: bytes, ending: bytes) -> None:
        """Writes data in place of the previous ending, then the new ending; raises OSError."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(replaced_end.HEAD.pack(len(data), len(ending)))
            self._process.stdin.write(data)
            self._process.stdin.write(ending)
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise OSError(f"its writer ended ({self._process.wait()})") from error
        reply = self._process.stdout.read(replaced_end.REPLY.size)
        if len(reply) < replaced_end.REPLY.size:
            raise OSError(f"its writer ended ({self._process.wait()})")
        (number,) = replaced_end.REPLY.unpack(reply)
        if number:
            raise OSError(number, os.strerror(number))

    def close(self) -> None:
        """Closes the pipe to the process and waits for its end."""
        self._process.communicate()


class McapFile:
    """Writes messages; schemas and channels are registered at their first use."""

    def __init__(self, path: Path, metadata: dict[str, str]) -> None:
        """Creates the file; raises RecordingError, and then leaves none."""
        from mcap.writer import CompressionType, Writer

        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644))
        except OSError as error:
            if os.path.lexists(path):
                raise RecordingError(f"{path} is there already: choose another name") from error
            raise RecordingError(f"{path} can't be created: {reason(error)}") from error
        self._disk = Disk(path)
        self._waiting = _Waiting()
        self._writer = Writer(
            self._waiting,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
        )
        self._writer.start(profile="", library="zloam")
        self._writer.add_metadata("zloam", metadata)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._synced = 0.0
        self.messages = 0
        self.bytes = 0
        try:
            self.whole()
        except OSError as error:
            self._disk.close()
            path.unlink(missing_ok=True)
            raise RecordingError(f"{path} can't be written: {reason(error)}") from error

    def put(
        self, topic: str, schema: tuple[str, bytes] | None, log_ns: int, sent_ns: int, data: bytes
    ) -> None:
        """Adds a message; `schema`: name and binary schema of a FlatBuffer, or None.

        Raises OSError if the disk is full: the file then stays as it was at the last sync.
        """
        self._writer.add_message(self._channel(topic, schema), log_ns, data, sent_ns, self.messages)
        self.messages += 1
        self.sync()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Adds metadata that are not known when the file is created."""
        self._writer.add_metadata(name, values)

    def sync(self) -> None:
        """Writes if a write is due; to be called at least twice a second."""
        due = len(self._waiting.data) > CHUNK_BYTES
        if due or time.monotonic() - self._synced > SYNC_SECONDS:
            self.whole()

    def whole(self) -> None:
        """Writes all messages added so far, with an index, so that the file can be opened."""
        memo: dict[int, Any] = {}
        twin = copy.deepcopy(self._writer, memo)
        twin.finish()
        ending = bytes(memo[id(self._waiting)].data)
        self._disk.replace_end(bytes(self._waiting.data), ending)
        self._waiting.at += len(self._waiting.data)
        self._waiting.data.clear()
        self.bytes = self._waiting.at + len(ending)
        self._synced = time.monotonic()

    def _channel(self, topic: str, schema: tuple[str, bytes] | None) -> int:
        if topic not in self._channels:
            known, encoding = 0, ""
            if schema is not None:
                name, data = schema
                encoding = "flatbuffer"
                if name not in self._schemas:
                    self._schemas[name] = self._writer.register_schema(name, encoding, data)
                known = self._schemas[name]
            self._channels[topic] = self._writer.register_channel(topic, encoding, known)
        return self._channels[topic]

    def close(self) -> None:
        """Writes and closes the file, which is closed even if this raises OSError as put() does."""
        try:
            self.whole()
        finally:
            self._disk.close()


@contextlib.contextmanager
def told(file: McapFile) -> Iterator[None]:
    """Reports a failure to write with the file's name."""
    try:
        yield
    except OSError as error:
        raise RecordingError(
            f"{file.path}: {reason(error)}: the recording ends here; what was written up to half a "
            "second before is whole. The robot goes on"
        ) from error
