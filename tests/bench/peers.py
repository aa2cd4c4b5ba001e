"""CPU per sweep of registration, odometry and mapping beside KISS-ICP's, same scans, same
session."""

from __future__ import annotations

from tests.acceptance.checks import ALGORITHMS
from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting


def _measure(setting: BenchSetting) -> Outcome:
    per_stage = setting.synth().report["cpu_ms_per_sweep"]
    stages = {stage: float(per_stage[stage]) for stage in ALGORITHMS}
    kiss = float(setting.kiss(setting.synth_folder())["cpu_ms_per_sweep"])
    ours = sum(stages.values())
    words = ", ".join(f"{stage} {ms:.1f}" for stage, ms in stages.items())
    return Outcome(
        f"{ours:.1f} ms ({words}), KISS-ICP {kiss:.1f} ms: {ours / kiss:.2f} ×",
        {"cpu_ms_per_sweep": stages, "kiss_icp_ms": kiss, "ratio": ours / kiss},
    )


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    return [
        Benchmark(
            "peer-kiss-icp",
            "CPU a sweep of the three algorithms with all their transport, synthetic city",
            lambda: _measure(setting),
        )
    ]
