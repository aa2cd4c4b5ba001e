"""A simulated drive, sent over UDP in real time, through the five stages on two cores and on
one."""

from __future__ import annotations

import functools
from typing import Any

from tests.acceptance import live
from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, on_cores

#: stages on the pose's path, none of which may lose a sweep
POSE_PATH = ("driver", "registration", "odometry", "integration")
KB = 1000.0
#: limits in ms: last packet to fused pose (P50, P99), and to mapped pose
FUSED_P50_MS, FUSED_P99_MS, MAPPED_P99_MS = 8.0, 20.0, 60.0


def _lost(report: dict[str, Any]) -> dict[str, dict[str, int]]:
    lost = {}
    for stage in POSE_PATH:
        sweeps = report["sweeps"][stage]
        drops = dict(sweeps["dropped"]) | ({"lost": sweeps["lost"]} if sweeps["lost"] else {})
        if drops:
            lost[stage] = drops
    return lost


def _measure(setting: BenchSetting, cores: int) -> dict[str, Any]:
    setting.capture()
    with on_cores(cores):
        return live.run(setting, f"live-{cores}")


def _loss(report: dict[str, Any]) -> Outcome:
    lost, books = _lost(report), report["identities"]
    sweeps, poses = books["sweeps"], books["poses"]
    mapping = report["sweeps"]["mapping"]
    return Outcome(
        f"{sweeps} sweeps, {poses} poses"
        + (f", {lost}" if lost else "")
        + f"; mapping left out {sum(mapping['dropped'].values())}",
        {"sweeps": sweeps, "poses": poses, "lost": lost, "mapping_dropped": mapping["dropped"]},
        not lost and sweeps == poses and sweeps >= live.SECONDS * 9,
    )


def _latency(report: dict[str, Any]) -> Outcome:
    pose, mapped = report["latency_ms"]["end_to_end"], report["latency_ms"]["mapped_pose"]
    if not pose:
        raise RuntimeError("no pose came with the time of its last packet")
    if not mapped:
        raise RuntimeError("no mapped pose came with the time of its last packet")
    words = f"fused pose p50 {pose['p50']:.1f}, p99 {pose['p99']:.1f} ms"
    words += f"; mapped pose p50 {mapped['p50']:.1f}, p99 {mapped['p99']:.1f} ms"
    held = pose["p50"] <= FUSED_P50_MS and pose["p99"] <= FUSED_P99_MS
    return Outcome(
        words, {"pose": pose, "mapped_pose": mapped}, held and mapped["p99"] <= MAPPED_P99_MS
    )


def _cpu(report: dict[str, Any]) -> Outcome:
    cpu = report["cpu_ms_per_sweep"]
    words = ", ".join(f"{stage} {ms:.1f}" for stage, ms in cpu.items())
    return Outcome(f"{sum(cpu.values()):.1f} ms a sweep ({words})", {"cpu_ms_per_sweep": cpu})


def _bytes(report: dict[str, Any]) -> Outcome:
    moved = report["bytes_per_sweep"]
    words = "; ".join(
        f"{stage} {each['published'] / KB:.0f}, {each['copied'] / KB:.0f}"
        for stage, each in moved.items()
    )
    return Outcome(words, {"bytes_per_sweep": moved})


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    """Four rows from one run on two cores; one row from a run on a single core."""

    @functools.cache
    def report() -> dict[str, Any]:
        return _measure(setting, 2)

    return [
        Benchmark(
            "live-loss",
            f"{live.SECONDS:.0f} s at 10 Hz over UDP on two cores: sweeps lost before the pose",
            lambda: _loss(report()),
            "none lost",
        ),
        Benchmark(
            "live-latency",
            "the same run: last packet to fused and to mapped pose",
            lambda: _latency(report()),
            f"fused p50 ≤ {FUSED_P50_MS:.0f}, p99 ≤ {FUSED_P99_MS:.0f}, "
            f"mapped p99 ≤ {MAPPED_P99_MS:.0f} ms",
        ),
        Benchmark("live-cpu", "the same run: CPU of each stage", lambda: _cpu(report())),
        Benchmark(
            "live-bytes",
            "the same run: kB a sweep that each stage published, and copied of what it received",
            lambda: _bytes(report()),
        ),
        Benchmark(
            "live-one-core",
            "another on a single core, the sender's too: sweeps lost before the pose",
            lambda: _loss(_measure(setting, 1)),
            "none lost",
        ),
    ]
