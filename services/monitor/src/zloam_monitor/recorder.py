"""`record`: records everything that a robot publishes in MCAP files.

Each file has the robot's messages as they were sent, their schemas, the configuration in force,
and the topics that Foxglove shows (foxglove_scene.py).
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from zloam_monitor import ending, messages, se3
from zloam_monitor.foxglove_scene import Scene
from zloam_monitor.intake import MIB, Intake, Sample
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link
from zloam_monitor.mcap_file import McapFile, RecordingError
from zloam_monitor.terminal import ProgressLine
from zloam_monitor.version import version

#: Limit on messages waiting to be written.
MOST_WAITING_BYTES = 256 * MIB
TOO_FAST = "they came faster than they could be written (a slower rate, or a faster disk)"
#: Map and path are written at most this often, if they grew.
SCENE_SECONDS = 5.0
#: Keys below the robot's with messages that the stages can compute again from the sweeps, or that
#: show the contents of other keys in another form.
DERIVED = (
    "lidar/*/features",
    "lidar/*/rejected",
    "odometry/features",
    "odometry/progress",
    "map/surround",
    "map/cloud",
    "sweep/registered",
    "odometry/sweep",
)
#: Identifier of a message -> its root table.
TABLES = {kind.identifier: table for table, kind in messages.KINDS.items() if table != "Command"}
TILES = "map/tile"


@dataclass(frozen=True)
class Options:
    """Options of a recording."""

    path: Path
    #: Also record what can be computed again.
    everything: bool = False
    #: Also record the topics that Foxglove shows.
    scene: bool = True
    #: Size after which another file begins.
    split_bytes: int = 2048 * MIB


@cache
def schema_of(identifier: bytes) -> tuple[str, bytes] | None:
    """Name and binary schema of the message with this identifier; None: not a zloam message."""
    table = TABLES.get(identifier)
    if table is None:
        return None
    path = messages.schemas_path() / "zloam" / "bfbs" / f"{messages.KINDS[table].schema}.bfbs"
    return f"zloam.msg.{table}", path.read_bytes()


def topic_of(key: str) -> str:
    """The topic of a key: the key itself, but one topic for all tiles, as they have an index."""
    head, found, _ = key.partition(f"/{TILES}/")
    return f"{head}/{TILES}" if found else key


def expressions(keys: Keys, scene: bool) -> list[str]:
    """Keys to record. A subscription to all keys would make the stages publish messages that they
    make only for subscribers. The list has no keys that begin with @, which the stages use among
    themselves."""
    wanted = [
        keys.below("lidar/*/packets"),
        keys.below("lidar/*/sweep"),
        keys.below("imu/*"),
        keys.below("gnss/*"),
        keys.odometry,
        keys.pose,
        keys.map_correction,
        keys.map_odometry,
        keys.tiles,
        keys.every_status,
        keys.every_revision,
    ]
    return [*wanted, keys.odometry_sweep] if scene else wanted


@dataclass
class Recorder:
    """Receives and writes a robot's messages; used by one thread."""

    link: Link
    options: Options
    parts: list[Path] = field(default_factory=list)
    written: int = 0
    #: Bytes of the files before the open one.
    before: int = 0

    def __post_init__(self) -> None:
        keys, options = self.link.keys, self.options
        # The file before the subscriptions, as it may be impossible to create.
        self._file = self._opened()
        wanted = expressions(keys, options.scene)
        if options.everything:
            wanted = list(dict.fromkeys([*wanted, *map(keys.below, DERIVED)]))
        self._raw_clouds = options.everything
        self._intake = Intake(self.link.session, wanted, MOST_WAITING_BYTES, leave_out="newest")
        self._scene: Scene | None = None
        #: Messages that are repeated in each file, so that it can be understood without the others.
        self._standing: dict[str, Sample] = {}

    def settle(self) -> None:
        """Queries what was published before: the configuration and its changes."""
        configs = self.link.query_configs()
        keys = self.link.keys
        now = time.time_ns()
        for key in (keys.every_config, keys.every_revision):
            for found, payload in self._answers(key):
                self._stand(Sample(found, payload, now))
        if self.options.scene:
            self._scene = Scene(keys, SCENE_SECONDS, se3.mounting_shown(configs))

    def _answers(self, selector: str) -> Iterator[tuple[str, bytes]]:
        for reply in self.link.replies(selector):
            if reply.ok is not None:
                yield str(reply.ok.key_expr), reply.ok.payload.to_bytes()

    def _stand(self, sample: Sample) -> None:
        if self._standing.get(sample.key) is None:
            self._put(sample)
        self._standing[sample.key] = sample

    def _opened(self) -> McapFile:
        path = self.options.path
        number = len(self.parts) + 1
        part = path if number == 1 else path.with_name(f"{path.stem}_{number}{path.suffix}")
        keys = self.link.keys
        about = {
            "robot": keys.robot,
            "sensor": keys.sensor,
            "part": str(number),
            "version": version(),
        }
        opened = McapFile(part, about)
        self.parts.append(part)
        return opened

    @property
    def dropped(self) -> dict[str, int]:
        return self._intake.dropped

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return self.before + self._file.bytes

    def poll(self, seconds: float = 0.0) -> None:
        """Writes received messages, waiting up to `seconds` for one; raises RecordingError."""
        try:
            sample = self._intake.take(seconds)
        except queue.Empty:
            self._synced()
            return
        self._take(sample)
        for more in self._intake.taken():
            self._take(more)

    def _take(self, sample: Sample) -> None:
        is_view = sample.key == self.link.keys.odometry_sweep
        if not is_view or self._raw_clouds:
            self._put(sample)
        if sample.payload[4:8] == messages.KINDS["ConfigRevision"].identifier:
            self._standing[sample.key] = sample
        if self._scene is not None:
            with contextlib.suppress(*messages.DECODE_ERRORS):
                for shown in self._scene.take(sample):
                    self._write(
                        shown.topic, shown.schema, sample.received_ns, shown.stamp_ns, shown.data
                    )
        if self._file.bytes > self.options.split_bytes:
            self._split()

    def _put(self, sample: Sample) -> None:
        schema = schema_of(bytes(sample.payload[4:8]))
        self._write(
            topic_of(sample.key), schema, sample.received_ns, sample.received_ns, sample.payload
        )
        self.written += 1

    def _write(
        self, topic: str, schema: tuple[str, bytes] | None, log_ns: int, sent_ns: int, data: bytes
    ) -> None:
        try:
            self._file.put(topic, schema, log_ns, sent_ns, data)
        except OSError as error:
            raise self._lost(error) from error

    def _synced(self) -> None:
        try:
            self._file.sync()
        except OSError as error:
            raise self._lost(error) from error

    def _lost(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{self.parts[-1]}: {error.strerror}: the recording ends here; what was written up to "
            "half a second before is whole. The robot goes on"
        )

    def _split(self) -> None:
        self.before += self._file.bytes
        self._file.close()
        self._file = self._opened()
        for sample in self._standing.values():
            self._put(sample)

    def close(self) -> None:
        """Writes the waiting messages and the counts of those dropped, and closes the file."""
        self._intake.close()
        try:
            self.poll()
            if self._scene is not None:
                now = time.time_ns()
                for shown in self._scene.last(now):
                    self._write(shown.topic, shown.schema, now, shown.stamp_ns, shown.data)
            if self.dropped:
                self._file.note("zloam.dropped", {k: str(n) for k, n in self.dropped.items()})
        finally:
            try:
                self._file.close()
            except OSError as error:
                raise self._lost(error) from error

    def summary(self) -> str:
        """Text with the recording's files, its size, and the missing messages."""
        listed = ", ".join(str(part) for part in self.parts)
        line = f"{listed}: {self.written} messages, {self.size / MIB:.1f} MiB"
        if self.dropped:
            total = sum(self.dropped.values())
            keys = ", ".join(sorted(self.dropped))
            line += f"\n{total} messages are missing ({keys}): {TOO_FAST}"
        return line


class Beside:
    """A recorder with a thread of its own, for a run in the same process."""

    def __init__(self, link: Link, path: Path) -> None:
        self._recorder = Recorder(link, Options(path))
        self._ends = threading.Event()
        self._error: RecordingError | None = None
        self._thread = threading.Thread(target=self._run)

    def begin(self) -> None:
        """Queries the configuration and starts writing; messages received before are buffered."""
        self._recorder.settle()
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._ends.is_set():
                self._recorder.poll(0.2)
        except RecordingError as error:
            self._error = error

    def end(self) -> list[str]:
        """Ends the recording; returns texts about what is missing, none if it is complete."""
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join()
        try:
            self._recorder.close()
        except RecordingError as error:
            self._error = self._error or error
        lacks = [str(self._error)] if self._error else []
        if missing := sum(self._recorder.dropped.values()):
            lacks.append(f"{missing} messages of {self._recorder.parts[0]}: {TOO_FAST}")
        return lacks


@contextlib.contextmanager
def beside(link: Link, path: Path | None) -> Iterator[Beside | None]:
    """Yields a recorder, which ends if the block raises; otherwise the block calls its end()."""
    if path is None:
        yield None
        return
    recording = Beside(link, path)
    try:
        yield recording
    except BaseException:
        recording.end()
        raise


def record(link: Link, options: Options, seconds: float | None) -> int:
    """Records until `seconds` have passed, or Ctrl-C; returns 1 if messages are missing."""
    recorder = Recorder(link, options)
    line = ProgressLine()
    try:
        with ending.until_told(seconds) as goes_on:
            print(f"recording to {options.path}; Ctrl-C ends", flush=True)
            recorder.settle()
            began = time.monotonic()
            while goes_on():
                recorder.poll(0.2)
                line.show(
                    f"{time.monotonic() - began:.0f} s, {recorder.written} messages, "
                    f"{recorder.size / MIB:.1f} MiB"
                )
    finally:
        line.end()
        recorder.close()
    print(recorder.summary(), flush=True)
    return 1 if recorder.dropped else 0
