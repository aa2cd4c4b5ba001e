"""Reads what `zloam record` wrote: a robot's own messages, in one MCAP file or several parts.

The driver replays the recorded sweeps as they were published, with the configuration that was in
force; `zloam replay` publishes all messages again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from zloam_monitor import messages, records
from zloam_monitor.mcap_file import further_parts, part_path
from zloam_monitor.recordings import Refused
from zloam_monitor.records import RevisionRecord

SWEEP = "zloam.msg.Sweep"
CONFIG = "zloam.msg.EffectiveConfig"
REVISION = "zloam.msg.ConfigRevision"
#: Recorded configuration that applies to a replay: all that affects the processing of sweeps. The
#: driver's is left out, as its sweeps are replayed unchanged.
STAGE_KEYS = ("sensor.model", "mounting.", "registration.", "odometry.", "mapping.", "integration.")
#: Keys among these that belong to the replaying run.
PLACES = ("mapping.map_path", "mapping.spill_directory", "integration.output_dir")
#: Later than any message.
MOST_NS = 1 << 63
T = TypeVar("T")
#: Metadata that all parts of a recording have in common.
IDENTITY = ("recording", "robot", "sensor", "version")


@dataclass(frozen=True)
class Logged:
    """One recorded message."""

    topic: str
    #: Name of its schema; empty: none.
    schema: str
    log_ns: int
    payload: bytes


@dataclass(frozen=True)
class Extent:
    """Time span of the whole recording, ns since the Unix epoch, and number of messages."""

    begin_ns: int
    end_ns: int
    messages: int

    @property
    def seconds(self) -> float:
        return 1e-9 * (self.end_ns - self.begin_ns)


def is_mcap(path: Path) -> bool:
    """True if the file has the first bytes of MCAP."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(8).startswith(b"\x89MCAP")


def is_one(path: Path) -> bool:
    """True if `zloam record` wrote the file."""
    return is_mcap(path) and RobotLog(path).about is not None


@dataclass
class RobotLog:
    """All parts of a recording, in their order."""

    path: Path
    remarks: list[str] = field(default_factory=list)
    #: Topics with configurations or changes that could not be read, and were left out.
    unread: set[str] = field(default_factory=set)

    @cached_property
    def parts(self) -> list[Path]:
        """run.mcap, then run_2.mcap and so on, if their metadata say that they are the parts of
        this recording: another recording may have such a name. A missing one gives a remark."""
        first = self.about or {}
        found = {1: self.path}
        for number, path in further_parts(self.path).items():
            about = _about(path) if path.is_file() else None
            if about is None:
                self.remarks.append(
                    f"{path.name} is no recording of zloam, or its beginning is damaged: it is "
                    "left out"
                )
            elif _same(about, first) and about.get("part") == str(number):
                found[number] = path
        for number in range(2, max(found)):
            if number not in found:
                self.remarks.append(
                    f"{part_path(self.path, number).name} is missing: the recording has a gap there"
                )
        return [path for _, path in sorted(found.items())]

    @property
    def about(self) -> dict[str, str] | None:
        """The recorder's metadata; None: `zloam record` did not write the file."""
        return _about(self.path)

    def extent(self) -> Extent:
        """Extent by the indexes of the parts; for a part without an index, by all its messages."""
        begins, ends, count = [], [], 0
        for part in self.parts:
            statistics = _statistics(part)
            if statistics is None:
                stamps = [m.log_ns for m in self._linear(part)]
                statistics = (min(stamps), max(stamps), len(stamps)) if stamps else None
            if statistics is not None:
                begins.append(statistics[0])
                ends.append(statistics[1])
                count += statistics[2]
        if not begins:
            raise Refused("no recording of `zloam record`, or one without a message")
        return Extent(min(begins), max(ends), count)

    def messages(self, wanted: tuple[str, ...] = ()) -> Iterator[Logged]:
        """Messages in the order of their arrival; `wanted`: only these schemas. From a truncated
        part come its complete messages, and a remark is added."""
        for part in self.parts:
            yield from (m for m in self._linear(part) if not wanted or m.schema in wanted)

    def _linear(self, part: Path) -> Iterator[Logged]:
        from mcap.records import Channel, Message, Schema

        names: dict[int, str] = {0: ""}
        channels: dict[int, tuple[str, str]] = {}
        with part.open("rb") as file:
            try:
                for record in self._records(part, file):
                    if isinstance(record, Schema):
                        names[record.id] = record.name
                    elif isinstance(record, Channel):
                        channels[record.id] = record.topic, names.get(record.schema_id, "")
                    elif isinstance(record, Message):
                        topic, schema = channels[record.channel_id]
                        yield Logged(topic, schema, record.log_time, record.data)
            except Exception as error:  # The library raises various errors for damaged files.
                self._damaged(part, error)

    def _records(self, part: Path, file: BinaryIO) -> Iterator[Any]:
        """All records; those of a chunk whose checksum is wrong are left out, with a remark."""
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader, breakup_chunk

        for record in StreamReader(file, emit_chunks=True).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            try:
                inside = breakup_chunk(record, validate_crc=True)
            except Exception as error:  # The library raises various errors for damaged files.
                kind = type(error).__name__
                self._remark(f"{part.name} is damaged within ({kind}): what is whole is used")
                continue
            yield from inside

    def _damaged(self, part: Path, error: Exception) -> None:
        self._remark(
            f"{part.name} is cut off or damaged ({type(error).__name__}): what is whole before "
            "that is used"
        )

    def _remark(self, remark: str) -> None:
        if remark not in self.remarks:  # It may be read several times.
            self.remarks.append(remark)

    def found(
        self, wanted: tuple[str, ...] = (), begin_ns: int = 0, end_ns: int = MOST_NS
    ) -> Iterator[Logged]:
        """Messages logged from begin_ns to before end_ns, in the order of their times in each
        part; `wanted`: only these schemas. The index finds them, and the rest is not read; a part
        without an index is read as a whole."""
        for part in self.parts:
            if _statistics(part) is not None:
                yield from self._indexed(part, wanted, begin_ns, end_ns)
                continue
            for m in self._linear(part):
                if begin_ns <= m.log_ns < end_ns and (not wanted or m.schema in wanted):
                    yield m

    def _indexed(
        self, part: Path, wanted: tuple[str, ...], begin_ns: int, end_ns: int
    ) -> Iterator[Logged]:
        from mcap.reader import make_reader

        with part.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            names = {0: "", **{schema.id: schema.name for schema in summary.schemas.values()}}
            channels = summary.channels.values()
            topics = {c.topic for c in channels if not wanted or names[c.schema_id] in wanted}
            try:
                for _, channel, m in reader.iter_messages(
                    topics, starting_at=begin_ns, ending_before=end_ns
                ):
                    yield Logged(channel.topic, names[channel.schema_id], m.log_time, m.data)
            except Exception as error:  # The library raises various errors for damaged files.
                self._damaged(part, error)

    def sweeps(self) -> Iterator[Logged]:
        """Sweeps of the first run, each once, by ascending number."""
        run: int | None = None
        last = -1
        missing = 0
        for logged in self.messages((SWEEP,)):
            header = _header(logged.payload)
            if header is None:
                self.remarks.append("a sweep could not be read: it is left out")
                continue
            if run is None:
                run, last = header.Run(), header.Sweep() - 1
            if header.Run() != run:
                self.remarks.append(f"a further run begins after sweep {last}: it is left out")
                break
            if header.Sweep() > last:
                missing += header.Sweep() - last - 1
                last = header.Sweep()
                yield logged
        if missing:
            self.remarks.append(f"{missing} sweeps are missing between others")

    def settings(self) -> list[str]:
        """The stages' configuration, KEY=VALUE: of each key the first value, as a stage that
        started later, or again, may have been given another."""
        found: dict[str, Any] = {}
        for _, (_, values) in self._read(CONFIG, records.effective_config):
            found = {**values, **found}
        kept = {k: v for k, v in found.items() if k.startswith(STAGE_KEYS) and k not in PLACES}
        return [f"{k}={_text(v)}" for k, v in sorted(kept.items())]

    def takes_imu(self) -> bool:
        """True if the driver was configured to take IMU readings, whenever they began."""
        configs = self._read(CONFIG, records.effective_config)
        return any(values.get("driver.imu", "none") != "none" for _, (_, values) in configs)

    def _read(self, schema: str, read: Callable[[bytes], T]) -> Iterator[tuple[Logged, T]]:
        """Messages and what they say. A recorder writes all that comes on the robot's keys, also
        what a stranger publishes: what can't be read is left out."""
        for logged in self.found((schema,)):
            try:
                said = read(logged.payload)
            except messages.DECODE_ERRORS:
                self.unread.add(logged.topic)
                continue
            yield logged, said

    def changes(self) -> list[str]:
        """Changes during the first run, SWEEP:KEY=VALUE; sweeps are counted from the first one.
        Those of earlier runs hold from there on."""
        revisions: dict[tuple[str, int], RevisionRecord] = {}
        for _, revision in self._read(REVISION, records.config_revision):
            revisions[(revision.stage, revision.rev)] = revision
        begin = next(self.sweeps(), None)
        header = _header(begin.payload) if revisions and begin is not None else None
        found, before = [], dict[str, dict[str, Any]]()
        for (stage, _), revision in sorted(revisions.items()):
            sweep = revision.from_sweep
            if begin is not None and header is not None:
                is_own = revision.run in (0, header.Run())
                if not is_own and revision.at_ns > begin.log_ns:
                    continue  # Of a further run, whose sweeps are left out.
                sweep = max(0, sweep - header.Sweep()) if is_own else 0
            known = before.get(stage, {})
            new = {k: v for k, v in revision.values.items() if known.get(k) != v}
            found += [f"{sweep}:{key}={_text(value)}" for key, value in new.items()]
            before[stage] = revision.values
        return found


def _about(path: Path) -> dict[str, str] | None:
    from mcap.records import Message, Metadata
    from mcap.stream_reader import StreamReader

    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Metadata) and record.name == "zloam":
                    return dict(record.metadata)
                if isinstance(record, Message):
                    return None
        except Exception:  # The library raises various errors for damaged files.
            return None
    return None


def _same(part: dict[str, str], first: dict[str, str]) -> bool:
    """True if both files are of one recording. Older recorders wrote no `recording`, a random
    identifier; their parts agree in the rest."""
    return all(part.get(name) == first.get(name) for name in IDENTITY)


def imu_of(payload: bytes) -> Any:
    """The IMU readings in a sweep (messages.IMU_SAMPLE)."""
    sweep = messages.decode("Sweep", payload)
    return messages.struct_vector(sweep, "Imu", messages.IMU_SAMPLE)


def _header(payload: bytes) -> Any:
    try:
        return messages.decode("Sweep", payload).Header()
    except messages.DECODE_ERRORS:
        return None


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _statistics(part: Path) -> tuple[int, int, int] | None:
    """(first, last, count) from the index; None: there is none."""
    from mcap.reader import make_reader

    with part.open("rb") as file:
        try:
            summary = make_reader(file).get_summary()
        except Exception:  # The library raises various errors for damaged files.
            return None
    if summary is None or summary.statistics is None or not summary.statistics.message_count:
        return None
    said = summary.statistics
    return said.message_start_time, said.message_end_time, said.message_count
