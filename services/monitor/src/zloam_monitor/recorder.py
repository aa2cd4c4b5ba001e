"""`record`: records everything that a robot publishes in MCAP files.

Each file has the robot's messages as they were sent, their schemas, the configuration in force,
and the topics that Foxglove shows (foxglove_scene.py).
"""

from __future__ import annotations

import contextlib
import queue
import secrets
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from zloam_monitor import ending, messages, records, se3, terminal
from zloam_monitor.foxglove_scene import Scene
from zloam_monitor.intake import MIB, Intake, Sample
from zloam_monitor.keys import TILES, topic_of
from zloam_monitor.link import PATH_SECONDS, Link
from zloam_monitor.map_before import MapBefore
from zloam_monitor.map_copy import has_path
from zloam_monitor.mcap_file import (
    McapFile,
    RecordingError,
    further_parts,
    part_path,
    told,
)
from zloam_monitor.recorded_keys import expressions, schema_of
from zloam_monitor.terminal import ProgressLine
from zloam_monitor.version import version
from zloam_monitor.watch import STALE_SECONDS

#: Limit on messages waiting to be written.
MOST_WAITING_BYTES = 256 * MIB
TOO_FAST = "they came faster than they could be written (a slower rate, or a faster disk)"
LOST = (
    "they did not come here (record on the robot itself: over TLS its router sends clouds and "
    "packets once a second, and a slow link loses more)"
)
#: Map and path are written at most this often, if they grew.
SCENE_SECONDS = 5.0
CONFIG, REVISION = (messages.KINDS[t].identifier for t in ("EffectiveConfig", "ConfigRevision"))
#: Messages that each part begins with: a stranger may publish changes without end.
MOST_STANDING = 10_000
#: Health of instances that may have no configuration to ask for: standbys have none.
WITHOUT_CONFIG = ("starting", "stopping")
#: Health of an instance that says by itself that nothing more comes of it.
ENDING = ("stopping", "failed")


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
        for there in further_parts(options.path).values():
            raise RecordingError(
                f"{there} is there already, and would be a part of this recording: choose another "
                "name, or move it away"
            )
        #: The same in all parts.
        self._identity = secrets.token_hex(16)
        self._closed = False
        # The file before the subscriptions, as it may be impossible to create.
        self._file = self._opened()
        wanted = expressions(keys, options.scene, options.everything)
        self._raw_clouds = options.everything
        self._intake = Intake(self.link.session, wanted, MOST_WAITING_BYTES, leave_out="newest")
        self._map = MapBefore(self.link, self._intake.add_answer)
        self._lacks_path = False
        self._scene: Scene | None = None
        #: Messages that are repeated in each file, so that it can be understood without the others.
        self._standing: dict[tuple[str, bytes], Sample] = {}
        #: Keys of the configurations of all instances that were there.
        self._present: set[str] = set()
        #: When the newest message came, and the end, ns by the intake's clock.
        self._came_ns = self._ended_ns = self._intake.clock.now_ns()
        #: Key of a status -> when the newest came, and its health.
        self._last_words: dict[str, tuple[int, str]] = {}

    def settle(self) -> None:
        """Queries what was published before: the configuration and its changes, the path, and the
        map, which comes while the recording goes on."""
        keys = self.link.keys
        configs: dict[str, dict[str, Any]] = {}

        def ask() -> Iterable[str]:
            for payload in self._stood(keys.every_config):
                with contextlib.suppress(*messages.DECODE_ERRORS):
                    stage, values = records.effective_config(payload)
                    configs[stage] = values
            return configs

        self.link.until_all(ask)
        living = self.link.living_instances()
        self._present |= {keys.below(f"service/{s}/{instance}/config") for s, instance in living}
        self._stood(keys.every_revision)
        if self.options.scene:
            self._scene = Scene(keys, SCENE_SECONDS, se3.mounting_shown(configs))
        # Published messages are written meanwhile: a mapping that hangs lets queries wait for long.
        with ThreadPoolExecutor(1) as pool:
            past = pool.submit(self._ask_for_past)
            while not past.done():
                self.poll(0.05)
        self._keep_path(past.result())
        self._map.begin()

    def _ask_for_past(self) -> list[bytes]:
        """Asks which tiles the map has; returns all answers with the path."""
        answers = list(self.link.get(self.link.keys.path_map, PATH_SECONDS))
        self._lacks_path = not answers and has_path(self.link)
        self._map.look()
        return answers

    def _keep_path(self, answers: Iterable[bytes]) -> None:
        for payload in answers:
            with contextlib.suppress(*messages.DECODE_ERRORS):
                run, poses = records.path(payload)
                if not len(poses):
                    continue
                self._put(Sample(self.link.keys.path_map, payload, self._intake.clock.now_ns()))
                if self._scene is not None:
                    self._scene.keep_path(run, poses)

    def _stood(self, selector: str) -> list[bytes]:
        """Asks, writes each answer that is not in the file yet, and returns all answers."""
        payloads = []
        for reply in self.link.replies(selector):
            if reply.ok is not None:
                payload = reply.ok.payload.to_bytes()
                self._stand(Sample(str(reply.ok.key_expr), payload, self._intake.clock.now_ns()))
                payloads.append(payload)
        return payloads

    def _stand(self, sample: Sample) -> None:
        """Writes a message that is not there yet: an instance has one configuration, but all
        revisions of a stage have one key, and a run needs each of them."""
        which = sample.key, sample.payload if sample.payload[4:8] == REVISION else b""
        if which not in self._standing:
            self._put(sample)
        if which in self._standing or len(self._standing) < MOST_STANDING:
            self._standing[which] = sample

    def _opened(self) -> McapFile:
        number = len(self.parts) + 1
        part = part_path(self.options.path, number)
        keys = self.link.keys
        about = {
            "robot": keys.robot,
            "sensor": keys.sensor,
            "recording": self._identity,
            "part": str(number),
            "version": version(),
        }
        opened = McapFile(part, about)
        self.parts.append(part)
        return opened

    @property
    def dropped(self) -> Counter[str]:
        """Topic -> number of messages that arrived but were not written."""
        found: Counter[str] = Counter()
        for key, count in self._intake.dropped.items():
            found[topic_of(key)] += count
        return found

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

    def has_all(self, seconds: float) -> bool:
        """True if nothing waits, and no message of a replay came in the last `seconds`."""
        return self._intake.has_all(seconds)

    def asks(self) -> bool:
        """True while tiles of the map from before are asked for."""
        return self._map.asks()

    def _lacking(self) -> list[str]:
        """Keys of configurations that are not in the file yet."""
        return sorted(self._present - {key for key, _ in self._standing})

    def _met(self, sample: Sample) -> None:
        """Asks the instance that published a status for its configuration, if that is lacking: the
        instance has started after this recording. The answer comes like any other message."""
        try:
            health = records.status(sample.payload).health
        except messages.DECODE_ERRORS:
            return
        self._last_words[sample.key] = sample.received_ns, health
        if health in WITHOUT_CONFIG:
            return
        config = sample.key.removesuffix("status") + "config"
        self._present.add(config)
        if (config, b"") not in self._standing:
            with contextlib.suppress(zenoh.ZError):  # The session may be closed already.
                self.link.session.get(config, self._answered)

    def _answered(self, reply: Any) -> None:
        if reply.ok is not None:
            self._intake.add(str(reply.ok.key_expr), reply.ok.payload.to_bytes())

    def _take(self, sample: Sample) -> None:
        if sample.answered:
            if not self._map.takes(sample):
                return
        else:
            self._came_ns = sample.received_ns
        identifier = sample.payload[4:8]
        if identifier in (CONFIG, REVISION):
            self._stand(sample)
            return
        if identifier == messages.KINDS["Status"].identifier:
            self._met(sample)
        if identifier == messages.KINDS["MapTile"].identifier and not sample.answered:
            self._map.published(sample)
        if self._raw_clouds or sample.key != self.link.keys.odometry_sweep:
            self._put(sample)
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
        with told(self._file):
            self._file.put(topic, schema, log_ns, sent_ns, data)

    def _synced(self) -> None:
        with told(self._file):
            self._file.sync()

    def _split(self) -> None:
        # The next part first: if it can't be created, the open one is still closed well.
        fresh = self._opened()
        done, self._file = self._file, fresh
        with told(done):
            done.close()
        self.before += done.bytes
        for sample in self._standing.values():
            self._put(sample)

    def give_up(self) -> None:
        """Receives nothing more, so that no publisher waits for this recorder."""
        self._intake.close()
        self._map.close()

    def close(self) -> None:
        """Writes the waiting messages and the counts of those dropped, and closes the file; does
        nothing if it is closed."""
        if self._closed:
            return
        self._closed = True
        self._ended_ns = self._intake.clock.now_ns()
        self._intake.close()
        self._map.close()
        try:
            self.poll()
            for config in self._lacking():
                with contextlib.suppress(zenoh.ZError):  # The session may be closed already.
                    self._stood(config)
            if self._scene is not None:
                now = self._intake.clock.now_ns()
                for shown in self._scene.last(now):
                    self._write(shown.topic, shown.schema, now, shown.stamp_ns, shown.data)
            before = Counter({self.link.keys.below(TILES): self._map.lacking()})
            if missing := self.dropped + self._intake.lost() + before:
                self._file.note("zloam.dropped", {k: str(n) for k, n in missing.items()})
        finally:
            with told(self._file):
                self._file.close()

    def lacks(self) -> list[str]:
        """Texts about what is missing in the recording; none if it is complete."""
        found = []
        for missing, why in ((self.dropped, TOO_FAST), (self._intake.lost(), LOST)):
            if missing:
                keys = ", ".join(f"{n} of {key}" for key, n in sorted(missing.items()))
                found.append(
                    f"{missing.total()} messages of {self.parts[0]} are missing ({keys}): {why}"
                )
        if tiles := self._map.lacking():
            found.append(
                f"{tiles} tiles that the map had before are missing in {self.parts[0]}: they did "
                "not come before its end"
            )
        if self._lacks_path:
            found.append(f"the path so far is missing in {self.parts[0]}: no answer came")
        if lacking := self._lacking():
            of = ", ".join("/".join(key.split("/")[-3:-1]) for key in lacking)
            found.append(f"the configuration of {of} is missing in {self.parts[0]}: no answer came")
        return found

    def silence(self) -> list[str]:
        """A text if nothing came in the last seconds and no instance had said that it ends; no gap
        between numbers shows what was published in them."""
        silent_s = 1e-9 * (self._ended_ns - self._came_ns)
        said = [
            health
            for came_ns, health in self._last_words.values()
            if 1e-9 * (self._came_ns - came_ns) <= STALE_SECONDS
        ]
        if silent_s <= STALE_SECONDS or set(said) & set(ENDING):
            return []
        return [
            f"nothing came in the last {silent_s:.0f} s of {self.parts[-1]}: the link to the robot "
            "was cut, its stages were killed, or a replay of it was over; what was published since "
            "then is missing"
        ]

    def summary(self) -> str:
        """Text with the recording's files, its size, and what is missing."""
        listed = ", ".join(str(part) for part in self.parts)
        line = f"{listed}: {self.written} messages, {self.size / MIB:.1f} MiB"
        return "\n".join([line, *self.lacks()])


def record(link: Link, options: Options, seconds: float | None) -> int:
    """Records until `seconds` have passed, or Ctrl-C; returns 1 if something is missing."""
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
    silence = recorder.silence()
    terminal.last_words("\n".join([recorder.summary(), *silence]))
    return 1 if recorder.lacks() or silence else 0
