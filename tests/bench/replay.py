"""Speed of replays through the five stages on two cores, as a multiple of the sensor's pace."""

from __future__ import annotations

import functools
import statistics

from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, on_cores

RUNS = 3
CITY_FACTOR, HDL64E_FACTOR = 8.0, 2.0


def _measure(setting: BenchSetting, name: str, source: tuple[object, ...], limit: float) -> Outcome:
    factors = []
    for number in range(RUNS):
        with on_cores(2):
            demo = setting.demo(f"{name}-{number}", *source)
        factors.append(float(demo.report["realtime_factor"]))
    median = statistics.median(factors)
    each = ", ".join(f"{factor:.1f}" for factor in factors)
    return Outcome(f"{median:.1f} × ({each})", {"factors": factors}, median >= limit)


def _city(setting: BenchSetting) -> Outcome:
    capture, truth = setting.simulated("city", 1)
    source = ("--pcap", capture, "--truth", truth)
    return _measure(setting, "replay-city", source, CITY_FACTOR)


def _hdl64e(setting: BenchSetting) -> Outcome:
    source = ("--kitti", setting.recording("data/hdl64e_drive"))
    return _measure(setting, "replay-hdl64e", source, HDL64E_FACTOR)


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    """A sensor with 16 lasers and one with 64."""
    return [
        Benchmark(
            "replay-city",
            f"the simulated city loop, VLP-16: median of {RUNS} runs",
            functools.partial(_city, setting),
            f"≥ {CITY_FACTOR:.0f} × real time",
        ),
        Benchmark(
            "replay-hdl64e",
            f"the recorded HDL-64E drive, 120 000 points a sweep: median of {RUNS} runs",
            functools.partial(_hdl64e, setting),
            f"≥ {HDL64E_FACTOR:.0f} × real time",
        ),
    ]
