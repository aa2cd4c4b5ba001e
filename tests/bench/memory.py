"""Memory of the five stages at the end of the simulated city loop."""

from __future__ import annotations

from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting
from zloam_monitor.stages import STAGES

MAPPING_MB, ALL_MB = 150.0, 600.0
MB_PER_MIB = 1.048576


def _measure(setting: BenchSetting) -> Outcome:
    demo = setting.city()
    report = demo.report
    # Of a stage that ended before PSS was measured only the RSS is known, which includes shared
    # memory.
    rest = {stage: report["rss_mib"][stage]["end"] for stage in STAGES}
    held = {stage: MB_PER_MIB * mib for stage, mib in {**rest, **report["pss_mib"]}.items()}
    words = ", ".join(f"{stage} {mb:.0f}" for stage, mb in held.items())
    total = sum(held.values())
    return Outcome(
        f"{total:.0f} MB ({words})",
        {"pss_mb": held},
        held["mapping"] <= MAPPING_MB and total <= ALL_MB,
    )


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    return [
        Benchmark(
            "memory-city",
            "the stages' own memory (PSS) at the end of the simulated city loop",
            lambda: _measure(setting),
            f"mapping ≤ {MAPPING_MB:.0f}, all ≤ {ALL_MB:.0f} MB",
        )
    ]
