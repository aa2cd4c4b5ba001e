"""Decodes messages to plain values."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import messages
from zloam_monitor.clouds import Tile
from zloam_monitor.messages import text

#: Names of the values of Health and ServiceHealth in the schemas.
HEALTH = (
    "ok",
    "empty",
    "too few points",
    "incomplete",
    "degenerate",
    "predicted",
    "dropped",
    "invalid",
    "bridging",
    "lost",
)
#: Limits on the entries of a list of names, and on a name. A stage has far fewer and shorter ones;
#: those of a stranger would be as many lines and time series in all that watches the robot.
MOST_NAMES = 256
MOST_NAME_BYTES = 512
DROPPED = HEALTH.index("dropped")
SERVICE_HEALTH = ("starting", "ready", "degraded", "failed", "stopping")


def _count(entries: int) -> range:
    if entries > MOST_NAMES:
        raise messages.MessageError(f"{entries} entries in a list of names")
    return range(entries)


def _label(value: bytes | None) -> str:
    if value is not None and len(value) > MOST_NAME_BYTES:
        raise messages.MessageError(f"a name of {len(value)} bytes")
    return text(value)


def name_of(names: tuple[str, ...], number: int) -> str:
    """Name of a state; of one that this version does not know yet, its number."""
    return names[number] if number < len(names) else str(number)


def pose_health(number: int) -> str:
    """Name of a pose's health."""
    return name_of(HEALTH, number)


@dataclass(frozen=True)
class TraceStep:
    """A stage's entry in the trace of a sweep; times of its host's clock in ns."""

    stage: str
    received_ns: int
    started_ns: int
    published_ns: int


@dataclass(frozen=True)
class RevisionRecord:
    """A change of a stage's configuration during a run."""

    stage: str
    rev: int
    run: int
    from_sweep: int
    #: Full key -> value, for all keys changed since the stage's start.
    values: dict[str, Any]
    by: str
    at_ns: int


@dataclass(frozen=True)
class ReplyRecord:
    """Reply to a command."""

    ok: bool
    message: str
    results: dict[str, Any]


@dataclass(frozen=True)
class PoseRecord:
    """One pose message."""

    run: int
    sweep: int
    instant_ns: int
    translation: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    health: int
    last_packet_ns: int
    end_of_run: bool
    trace: tuple[TraceStep, ...]
    degenerate: bool = False
    #: A correction moved the pose by more than integration.jump_*.
    jump: bool = False
    #: Least constrained translation in base_link; zero if none is degenerate.
    weak_translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: 6x6 row by row, translation before rotation, tangent at base_link; empty if unknown.
    covariance: tuple[float, ...] = ()
    #: Revision of the publisher's configuration.
    config_rev: int = 0
    #: Map of a mapped pose or of a preview's; other messages do not name it (0).
    map_id: int = 0


@dataclass(frozen=True)
class PreviewRecord:
    """One preview message, for thin links."""

    #: Instance, map and epoch: previews of different sources are of different maps.
    source: tuple[str, int, int]
    pose: PoseRecord | None
    block_m: float
    #: Number of blocks of the whole map that are not empty.
    map_blocks: int
    #: Blocks as messages.PREVIEW_BLOCK, and their octrees one after another.
    blocks: NDArray[Any]
    octrees: NDArray[np.uint8]


@dataclass(frozen=True)
class Input:
    """Account of one input (docs/protocol.md, section 2)."""

    key: str
    received: int
    processed: int
    not_mine: int
    queued: int
    in_work: int
    dropped: dict[str, int]
    lost: int
    recovered: int

    def balanced(self) -> bool:
        known = self.processed + self.not_mine + self.queued + self.in_work
        return self.received == known + sum(self.dropped.values())


@dataclass(frozen=True)
class StatusRecord:
    """One status message."""

    stage: str
    instance: str
    health: str
    reason: str
    stamp_ns: int
    run: int
    last_sweep: int | None
    end_of_run: bool
    inputs: tuple[Input, ...]
    published: dict[str, int]
    latencies: dict[str, dict[str, float]]
    figures: dict[str, float]
    cpu_ms: float
    rss_mib: dict[str, float]
    version: str = ""
    #: By its host's clock, like stamp_ns.
    started_ns: int = 0
    memory: dict[str, int] = field(default_factory=dict)
    config_rev: int = 0
    #: Key -> bytes published since the start, counted once for any number of subscribers.
    published_bytes: dict[str, int] = field(default_factory=dict)

    @property
    def is_silent(self) -> bool:
        """True if another instance works in this one's place, or seems to."""
        return self.figures.get("silent", 0.0) > 0.0

    def input(self, key: str) -> Input | None:
        return next((i for i in self.inputs if i.key == key), None)


def _trace(header: Any) -> tuple[TraceStep, ...]:
    points = (header.Trace(i) for i in _count(header.TraceLength()))
    return tuple(
        TraceStep(_label(p.Stage()), p.ReceivedNs(), p.StartedNs(), p.PublishedNs()) for p in points
    )


def _vector(vec3: Any) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0) if vec3 is None else (vec3.X(), vec3.Y(), vec3.Z())


def _covariance(table: Any) -> tuple[float, ...]:
    """Unknown if a cell is not finite: one NaN would spoil all that is computed from it."""
    cells = tuple(table.Covariance(i) for i in range(table.CovarianceLength()))
    return cells if all(map(math.isfinite, cells)) else ()


def _pose(table: Any, pose: Any) -> PoseRecord:
    header = table.Header()
    if header is None or pose is None:
        raise messages.MessageError("a pose message without header or pose")
    translation, quaternion = messages.pose_arrays(pose)
    return PoseRecord(
        run=header.Run(),
        sweep=header.Sweep(),
        instant_ns=table.InstantNs(),
        translation=translation,
        quaternion=quaternion,
        health=table.Health(),
        last_packet_ns=header.LastPacketNs(),
        end_of_run=bool(header.EndOfRun()),
        trace=_trace(header),
        degenerate=bool(table.Degenerate()),
        jump=bool(table.Jump()) if hasattr(table, "Jump") else False,
        weak_translation=_vector(table.WeakTranslation()),
        covariance=_covariance(table),
        config_rev=header.ConfigRev(),
        map_id=header.MapId(),
    )


def map_pose(payload: bytes) -> PoseRecord:
    """Decodes a message of key pose or map/odometry."""
    table = messages.decode("MapPose", payload)
    return _pose(table, table.PoseMapBase())


def odometry(payload: bytes) -> PoseRecord:
    """Decodes a message of key odometry."""
    table = messages.decode("Odometry", payload)
    return _pose(table, table.PoseOdomBase())


def _input(account: Any) -> Input:
    drops = (account.Dropped(i) for i in _count(account.DroppedLength()))
    return Input(
        key=_label(account.Key()),
        received=account.Received(),
        processed=account.Processed(),
        not_mine=account.NotMine(),
        queued=account.Queued(),
        in_work=account.InWork(),
        dropped={_label(d.Reason()): d.Count() for d in drops},
        lost=account.Lost(),
        recovered=account.Recovered(),
    )


def _measured(value: float, what: str) -> float:
    if not 0.0 <= value < math.inf:
        raise messages.MessageError(f"no {what}: {value}")
    return float(value)


def status(payload: bytes) -> StatusRecord:
    """Decodes a message of key service/<stage>/<instance>/status."""
    s = messages.decode("Status", payload)
    outputs = [s.Outputs(i) for i in _count(s.OutputsLength())]
    latencies = (s.Latencies(i) for i in _count(s.LatenciesLength()))
    figures = (s.Figures(i) for i in _count(s.FiguresLength()))
    return StatusRecord(
        stage=_label(s.Stage()),
        instance=_label(s.Instance()),
        health=name_of(SERVICE_HEALTH, s.Health()),
        reason=text(s.Reason()),
        stamp_ns=s.StampNs(),
        run=s.Run(),
        last_sweep=s.LastSweep() if s.HasSweep() else None,
        end_of_run=bool(s.EndOfRun()),
        inputs=tuple(_input(s.Inputs(i)) for i in _count(s.InputsLength())),
        published={_label(o.Key()): o.Published() for o in outputs},
        latencies={
            _label(each.Name()): {"p50": each.P50Ms(), "p95": each.P95Ms(), "p99": each.P99Ms()}
            for each in latencies
        },
        figures={_label(f.Name()): f.Value() for f in figures},
        cpu_ms=_measured(s.CpuMs(), "processor time"),
        rss_mib={
            name: _measured(mib, "memory")
            for name, mib in (
                ("start", s.RssStartMib()),
                ("end", s.RssNowMib()),
                ("peak", s.RssPeakMib()),
            )
        },
        version=text(s.Version()),
        started_ns=s.StartedNs(),
        memory={
            "bytes_published": sum(o.Bytes() for o in outputs),
            "bytes_in_place": s.BytesInPlace(),
            "bytes_copied": s.BytesCopied(),
            "messages_shm": s.MessagesShm(),
            "messages_net": s.MessagesNet(),
        },
        config_rev=s.ConfigRev(),
        published_bytes={text(o.Key()): o.Bytes() for o in outputs},
    )


def preview(payload: bytes) -> PreviewRecord:
    """Decodes a message of key preview."""
    m = messages.decode("Preview", payload)
    header, pose = m.Header(), m.PoseMapBase()
    if header is None:
        raise messages.MessageError("a preview without a header")
    found = None
    if pose is not None:
        translation, quaternion = messages.pose_arrays(pose)
        found = PoseRecord(
            run=header.Run(),
            sweep=header.Sweep(),
            instant_ns=m.InstantNs(),
            translation=translation,
            quaternion=quaternion,
            health=m.Health(),
            last_packet_ns=header.LastPacketNs(),
            end_of_run=bool(header.EndOfRun()),
            trace=_trace(header),
            degenerate=bool(m.Degenerate()),
            map_id=header.MapId(),
        )
    octrees = m.OctreesAsNumpy() if m.OctreesLength() else np.empty(0, np.uint8)
    return PreviewRecord(
        source=(text(header.Instance()), header.MapId(), m.Epoch()),
        pose=found,
        block_m=m.BlockM(),
        map_blocks=m.MapBlocks(),
        blocks=messages.struct_vector(m, "Blocks", messages.PREVIEW_BLOCK),
        octrees=octrees,
    )


def tile(payload: bytes) -> Tile:
    """Decodes a message of key map/tile/<layer>/<i>/<j>/<k>."""
    t = messages.decode("MapTile", payload)
    points = messages.struct_vector(t, "Points", messages.MAP_POINT)
    if not all(np.isfinite(points[axis]).all() for axis in ("x", "y", "z")):
        raise messages.MessageError("a point of a tile is not finite")  # As the stages do.
    header = t.Header()
    map_id = header.MapId() if header is not None else 0
    return Tile(text(t.Layer()), (t.I(), t.J(), t.K()), t.Version(), points, map_id)


def path(payload: bytes) -> tuple[int, NDArray[Any]]:
    """Decodes (run, array of STAMPED_POSE) of keys path/odometry and path/map."""
    table = messages.decode("Path", payload)
    header = table.Header()
    poses = messages.struct_vector(table, "Poses", messages.STAMPED_POSE)
    return (header.Run() if header is not None else 0), poses


def effective_config(payload: bytes) -> tuple[str, dict[str, Any]]:
    """Decodes (stage, full key -> value) of key service/<stage>/<instance>/config."""
    table = messages.decode("EffectiveConfig", payload)
    return text(table.Stage()), dict(json.loads(text(table.ValuesJson())))


def config_revision(payload: bytes) -> RevisionRecord:
    """Decodes a message of key config/<stage>."""
    r = messages.decode("ConfigRevision", payload)
    return RevisionRecord(
        stage=text(r.Stage()),
        rev=r.Rev(),
        run=r.Run(),
        from_sweep=r.FromSweep(),
        values=dict(json.loads(text(r.ValuesJson()))),
        by=text(r.By()),
        at_ns=r.AtNs(),
    )


def command_reply(payload: bytes) -> ReplyRecord:
    """Decodes a reply of key command/<stage>/<verb>."""
    r = messages.decode("CommandReply", payload)
    return ReplyRecord(bool(r.Ok()), text(r.Message()), dict(json.loads(text(r.ResultsJson()))))
