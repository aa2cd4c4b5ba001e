"""Builds messages from plain values, for stand-ins of stages, tests and tools."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import flatbuffers
import numpy as np
from numpy.typing import NDArray

from zloam_monitor import messages
from zloam_monitor.messages import module


@dataclass(frozen=True)
class HeaderValues:
    """The fields of Header in schemas/common.fbs."""

    run: int
    sweep: int
    seq: int
    robot: str = "robot"
    sensor: str = "lidar"
    stamp_ns: int = 0
    frame: str = "lidar"
    instance: str = "python"
    term: int = 1
    map_id: int = 0
    end_of_run: bool = False
    last_packet_ns: int = 0
    replay: bool = False
    #: Each entry: stage, received_ns, started_ns, published_ns.
    trace: tuple[tuple[str, int, int, int], ...] = ()


def _trace(b: flatbuffers.Builder, values: HeaderValues) -> int:
    points, t = [], module("TracePoint")
    for stage, received, started, published in values.trace:
        name, instance = b.CreateString(stage), b.CreateString(values.instance)
        t.TracePointStart(b)
        t.TracePointAddStage(b, name)
        t.TracePointAddInstance(b, instance)
        t.TracePointAddReceivedNs(b, received)
        t.TracePointAddStartedNs(b, started)
        t.TracePointAddPublishedNs(b, published)
        points.append(t.TracePointEnd(b))
    return _table_vector(b, points)


def _table_vector(b: flatbuffers.Builder, offsets: list[int]) -> int:
    b.StartVector(4, len(offsets), 4)
    for offset in reversed(offsets):
        b.PrependUOffsetTRelative(offset)
    return int(b.EndVector())


def header(b: flatbuffers.Builder, v: HeaderValues) -> int:
    """Writes the header; returns its offset in the buffer."""
    h = module("Header")
    trace = _trace(b, v)
    texts = {n: b.CreateString(getattr(v, n)) for n in ("robot", "sensor", "frame", "instance")}
    h.HeaderStart(b)
    h.HeaderAddRobot(b, texts["robot"])
    h.HeaderAddSensor(b, texts["sensor"])
    h.HeaderAddRun(b, v.run)
    h.HeaderAddSweep(b, v.sweep)
    h.HeaderAddStampNs(b, v.stamp_ns)
    h.HeaderAddFrame(b, texts["frame"])
    h.HeaderAddSeq(b, v.seq)
    h.HeaderAddTerm(b, v.term)
    h.HeaderAddInstance(b, texts["instance"])
    h.HeaderAddMapId(b, v.map_id)
    h.HeaderAddTrace(b, trace)
    h.HeaderAddEndOfRun(b, v.end_of_run)
    h.HeaderAddLastPacketNs(b, v.last_packet_ns)
    h.HeaderAddReplay(b, v.replay)
    return int(h.HeaderEnd(b))


def _finish(b: flatbuffers.Builder, table: str, offset: int) -> bytes:
    b.Finish(offset, messages.KINDS[table].identifier)
    return bytes(b.Output())


def _pose_struct(b: flatbuffers.Builder, position: Any, quaternion: Any) -> int:
    return int(module("Pose").CreatePose(b, *map(float, position), *map(float, quaternion)))


def pose(
    table: str,
    v: HeaderValues,
    instant_ns: int,
    position: Any,
    quaternion: Any,
    health: int = 0,
    covariance: Any = (),
) -> bytes:
    """A MapPose or Odometry message; table: its name."""
    b = flatbuffers.Builder(0)
    head, m = header(b, v), module(table)
    cells = b.CreateNumpyVector(np.asarray(covariance, np.float64))
    field_name = "PoseMapBase" if table == "MapPose" else "PoseOdomBase"
    getattr(m, table + "Start")(b)
    getattr(m, table + "AddHeader")(b, head)
    getattr(m, table + "AddInstantNs")(b, instant_ns)
    getattr(m, table + "Add" + field_name)(b, _pose_struct(b, position, quaternion))
    getattr(m, table + "AddHealth")(b, health)
    getattr(m, table + "AddCovariance")(b, cells)
    return _finish(b, table, getattr(m, table + "End")(b))


def path(v: HeaderValues, poses: NDArray[Any]) -> bytes:
    """A Path message; poses: STAMPED_POSE."""
    b = flatbuffers.Builder(0)
    head, m = header(b, v), module("Path")
    vector = messages.put_struct_vector(b, poses)
    m.PathStart(b)
    m.PathAddHeader(b, head)
    m.PathAddPoses(b, vector)
    return _finish(b, "Path", m.PathEnd(b))


def tile(
    v: HeaderValues,
    layer: str,
    index: tuple[int, int, int],
    points: NDArray[Any],
    version: int = 1,
) -> bytes:
    """A MapTile message; points: MAP_POINT."""
    b = flatbuffers.Builder(0)
    head, name, m = header(b, v), b.CreateString(layer), module("MapTile")
    vector = messages.put_struct_vector(b, points)
    m.MapTileStart(b)
    m.MapTileAddHeader(b, head)
    m.MapTileAddLayer(b, name)
    m.MapTileAddI(b, index[0])
    m.MapTileAddJ(b, index[1])
    m.MapTileAddK(b, index[2])
    m.MapTileAddEdgeM(b, 50.0)
    m.MapTileAddVersion(b, version)
    m.MapTileAddPoints(b, vector)
    return _finish(b, "MapTile", m.MapTileEnd(b))


def preview(
    v: HeaderValues, epoch: int, position: Any, block_m: float, blocks: NDArray[Any], octrees: bytes
) -> bytes:
    """A Preview message; blocks: messages.PREVIEW_BLOCK. The robot's rotation is identity."""
    b = flatbuffers.Builder(0)
    head, m = header(b, v), module("Preview")
    vector = messages.put_struct_vector(b, blocks)
    trees = b.CreateByteVector(octrees)
    m.PreviewStart(b)
    m.PreviewAddHeader(b, head)
    m.PreviewAddEpoch(b, epoch)
    m.PreviewAddInstantNs(b, v.stamp_ns)
    m.PreviewAddPoseMapBase(b, _pose_struct(b, position, (0.0, 0.0, 0.0, 1.0)))
    m.PreviewAddBlockM(b, block_m)
    m.PreviewAddMapBlocks(b, len(blocks))
    m.PreviewAddBlocks(b, vector)
    m.PreviewAddOctrees(b, trees)
    return _finish(b, "Preview", m.PreviewEnd(b))


def config(stage: str, values: dict[str, Any]) -> bytes:
    """An EffectiveConfig message."""
    b = flatbuffers.Builder(0)
    name, text, m = (
        b.CreateString(stage),
        b.CreateString(json.dumps(values)),
        module("EffectiveConfig"),
    )
    m.EffectiveConfigStart(b)
    m.EffectiveConfigAddStage(b, name)
    m.EffectiveConfigAddValuesJson(b, text)
    return _finish(b, "EffectiveConfig", m.EffectiveConfigEnd(b))


@dataclass
class Counts:
    """Account of one input in a status."""

    key: str
    received: int
    processed: int
    dropped: dict[str, int] = field(default_factory=dict)


def _input(b: flatbuffers.Builder, counts: Counts) -> int:
    d, a = module("DropCount"), module("InputAccount")
    drops = []
    for reason, count in counts.dropped.items():
        name = b.CreateString(reason)
        d.DropCountStart(b)
        d.DropCountAddReason(b, name)
        d.DropCountAddCount(b, count)
        drops.append(d.DropCountEnd(b))
    vector, key = _table_vector(b, drops), b.CreateString(counts.key)
    a.InputAccountStart(b)
    a.InputAccountAddKey(b, key)
    a.InputAccountAddReceived(b, counts.received)
    a.InputAccountAddProcessed(b, counts.processed)
    a.InputAccountAddDropped(b, vector)
    return int(a.InputAccountEnd(b))


def _figure(b: flatbuffers.Builder, name: str, value: float) -> int:
    text, f = b.CreateString(name), module("Figure")
    f.FigureStart(b)
    f.FigureAddName(b, text)
    f.FigureAddValue(b, value)
    return int(f.FigureEnd(b))


def status(
    stage: str,
    stamp_ns: int,
    run: int,
    last_sweep: int | None,
    inputs: list[Counts],
    published: dict[str, int],
    end_of_run: bool = False,
    health: int = 1,
    reason: str = "",
    published_bytes: dict[str, int] | None = None,
    instance: str | None = None,
    figures: dict[str, float] | None = None,
    rss_mib: float = 12.0,
) -> bytes:
    """A Status message with the fields that a monitor reads."""
    b = flatbuffers.Builder(0)
    s, o = module("Status"), module("OutputAccount")
    ins = _table_vector(b, [_input(b, each) for each in inputs])
    outs = []
    for key, count in published.items():
        name = b.CreateString(key)
        o.OutputAccountStart(b)
        o.OutputAccountAddKey(b, name)
        o.OutputAccountAddPublished(b, count)
        o.OutputAccountAddBytes(b, (published_bytes or {}).get(key, 0))
        outs.append(o.OutputAccountEnd(b))
    out_vector = _table_vector(b, outs)
    figure_vector = _table_vector(b, [_figure(b, *each) for each in (figures or {}).items()])
    texts = [b.CreateString(t) for t in (stage, instance or f"{stage}-1", reason)]
    s.StatusStart(b)
    s.StatusAddStage(b, texts[0])
    s.StatusAddInstance(b, texts[1])
    s.StatusAddReason(b, texts[2])
    s.StatusAddHealth(b, health)
    s.StatusAddStampNs(b, stamp_ns)
    s.StatusAddRun(b, run)
    s.StatusAddLastSweep(b, last_sweep or 0)
    s.StatusAddHasSweep(b, last_sweep is not None)
    s.StatusAddEndOfRun(b, end_of_run)
    s.StatusAddInputs(b, ins)
    s.StatusAddOutputs(b, out_vector)
    s.StatusAddFigures(b, figure_vector)
    s.StatusAddCpuMs(b, 100.0)
    s.StatusAddRssStartMib(b, 10.0)
    s.StatusAddRssNowMib(b, rss_mib)
    s.StatusAddRssPeakMib(b, 13.0)
    return _finish(b, "Status", s.StatusEnd(b))


def sweep(
    v: HeaderValues, points: NDArray[Any], period_ns: int = 100_000_000, rings: int = 16
) -> bytes:
    """A Sweep message; points: POINT, frame lidar."""
    b = flatbuffers.Builder(0)
    head, model, m = header(b, v), b.CreateString("VLP-16"), module("Sweep")
    vector = messages.put_struct_vector(b, points)
    columns = b.CreateNumpyVector(np.arange(len(points), dtype="<u2"))
    m.SweepStart(b)
    m.SweepAddHeader(b, head)
    m.SweepAddPoints(b, vector)
    m.SweepAddColumns(b, columns)
    m.SweepAddPeriodNs(b, period_ns)
    m.SweepAddRings(b, rings)
    m.SweepAddModel(b, model)
    m.SweepAddReturnMode(b, 1)
    m.SweepAddClockSource(b, 5)
    m.SweepAddComplete(b, True)
    return _finish(b, "Sweep", m.SweepEnd(b))


def imu(v: HeaderValues, samples: NDArray[Any]) -> bytes:
    """An ImuBatch message; samples: messages.IMU_SAMPLE, stamped by the lidar's clock."""
    b = flatbuffers.Builder(0)
    head, m = header(b, v), module("ImuBatch")
    vector = messages.put_struct_vector(b, samples)
    m.ImuBatchStart(b)
    m.ImuBatchAddHeader(b, head)
    m.ImuBatchAddSamples(b, vector)
    return _finish(b, "ImuBatch", m.ImuBatchEnd(b))


#: The point clouds of a Features message.
FEATURE_CLOUDS = ("Sharp", "LessSharp", "Flat", "LessFlat")


def features(v: HeaderValues, clouds: dict[str, NDArray[Any]], rings: int = 16) -> bytes:
    """A Features message; clouds: name of FEATURE_CLOUDS -> POINT, frame lidar. Clouds that are not
    named are empty."""
    b = flatbuffers.Builder(0)
    head, m = header(b, v), module("Features")
    vectors = {name: messages.put_struct_vector(b, cloud) for name, cloud in clouds.items()}
    m.FeaturesStart(b)
    m.FeaturesAddHeader(b, head)
    m.FeaturesAddPeriodNs(b, 100_000_000)
    m.FeaturesAddRings(b, rings)
    for name, vector in vectors.items():
        getattr(m, "FeaturesAdd" + name)(b, vector)
    m.FeaturesAddRangeNoiseM(b, 0.02)
    return _finish(b, "Features", m.FeaturesEnd(b))


def odometry_features(
    v: HeaderValues, instant_ns: int, position: Any, edges: NDArray[Any], planes: NDArray[Any]
) -> bytes:
    """An OdometryFeatures message; edges, planes: POINT, frame base_link at the instant. The
    rotation of base_link is identity."""
    b = flatbuffers.Builder(0)
    head, m = header(b, v), module("OdometryFeatures")
    covariance = b.CreateNumpyVector(np.diag([1e-4] * 6).ravel())
    edge_vector = messages.put_struct_vector(b, edges)
    plane_vector = messages.put_struct_vector(b, planes)
    upright = (0.0, 0.0, 0.0, 1.0)
    m.OdometryFeaturesStart(b)
    m.OdometryFeaturesAddHeader(b, head)
    m.OdometryFeaturesAddInstantNs(b, instant_ns)
    m.OdometryFeaturesAddPoseOdomBase(b, _pose_struct(b, position, upright))
    m.OdometryFeaturesAddTwist(b, module("Twist").CreateTwist(b, 0, 0, 0, 0, 0, 0))
    m.OdometryFeaturesAddCovariance(b, covariance)
    m.OdometryFeaturesAddPeriodNs(b, 100_000_000)
    m.OdometryFeaturesAddPoseBaseLidar(b, _pose_struct(b, (0, 0, 0), upright))
    m.OdometryFeaturesAddEdges(b, edge_vector)
    m.OdometryFeaturesAddPlanes(b, plane_vector)
    m.OdometryFeaturesAddPrevSweep(b, max(v.sweep, 1) - 1)
    m.OdometryFeaturesAddRangeNoiseM(b, 0.02)
    return _finish(b, "OdometryFeatures", m.OdometryFeaturesEnd(b))
