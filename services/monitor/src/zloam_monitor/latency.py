"""Latencies from the trace in each message (ms, percentiles over the run)."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from zloam_monitor.records import PoseRecord, TraceStep
from zloam_monitor.stages import STAGES

Percentiles = dict[str, float] | None


def percentiles(samples_ms: Sequence[float]) -> Percentiles:
    """p50, p95, p99, or None without samples."""
    if not samples_ms:
        return None
    values = np.percentile(samples_ms, [50, 95, 99])
    return {name: float(v) for name, v in zip(("p50", "p95", "p99"), values, strict=True)}


def by_stage(
    poses: Iterable[PoseRecord], mapped: Iterable[PoseRecord]
) -> tuple[dict[str, Percentiles], dict[str, Percentiles]]:
    """(received to published, started to published) of each stage."""
    whole, work = samples(poses, mapped)
    return (
        {stage: percentiles(whole[stage]) for stage in STAGES},
        {stage: percentiles(work[stage]) for stage in STAGES},
    )


def samples(
    poses: Iterable[PoseRecord], mapped: Iterable[PoseRecord]
) -> tuple[dict[str, array[float]], dict[str, array[float]]]:
    """(received to published, started to published) of each stage and sweep, in ms. The times of
    mapping are taken from mapped poses, those of the other stages from fused poses."""
    whole: dict[str, array[float]] = defaultdict(lambda: array("d"))
    work: dict[str, array[float]] = defaultdict(lambda: array("d"))
    for step in _steps(poses, mapped):
        if step.published_ns == 0:
            continue
        if step.received_ns:
            whole[step.stage].append((step.published_ns - step.received_ns) * 1e-6)
        if step.started_ns:
            work[step.stage].append((step.published_ns - step.started_ns) * 1e-6)
    return whole, work


def _steps(poses: Iterable[PoseRecord], mapped: Iterable[PoseRecord]) -> Iterator[TraceStep]:
    for of_mapping, found in ((False, poses), (True, mapped)):
        for pose in found:
            yield from (step for step in pose.trace if (step.stage == "mapping") == of_mapping)


def from_last_packet(poses: Iterable[PoseRecord], stage: str) -> Percentiles:
    """Time from a sweep's last packet to its publication by a stage; None in a fast replay."""
    samples = (
        (step.published_ns - pose.last_packet_ns) * 1e-6
        for pose in poses
        if pose.last_packet_ns > 0
        for step in pose.trace
        if step.stage == stage and step.published_ns > 0
    )
    return percentiles(array("d", samples))
