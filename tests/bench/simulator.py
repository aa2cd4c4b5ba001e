"""Speed of the simulator: simulated seconds per second of wall time."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, simulate

SECONDS = 10.0


def _measure(setting: BenchSetting) -> Outcome:
    cores = min(2, len(os.sched_getaffinity(0)))
    with tempfile.TemporaryDirectory() as folder:
        out = ("--out", Path(folder) / "capture.pcap")
        start = simulate(setting.build, 0.1, *out, "--threads", 1)
        one = simulate(setting.build, SECONDS, *out, "--threads", 1)
        both = simulate(setting.build, SECONDS, *out, "--threads", cores)
    one_thread = SECONDS / (one.cpu_s - start.cpu_s)
    all_cores = SECONDS / both.wall_s
    return Outcome(
        f"{one_thread:.1f} × real time per CPU second, {all_cores:.1f} × on {cores} cores "
        f"(wall clock), {start.cpu_s:.1f} s to build the world",
        {"one_thread": one_thread, "all_cores": all_cores, "start_cpu_s": start.cpu_s},
    )


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    return [
        Benchmark(
            "simulator",
            f"{SECONDS:.0f} s of the city loop, VLP-16 at 600 rpm, as a multiple of real time",
            lambda: _measure(setting),
        )
    ]
