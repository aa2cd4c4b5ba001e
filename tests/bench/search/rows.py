"""`make bench ONLY='search-*'`: random drives through the algorithms, in one run with three
judgements.

300 drives take about 25 minutes on two idle cores.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

from tests.bench.framework import Benchmark, Outcome
from tests.bench.search import report, runner, sets
from tests.bench.search.report import Found
from tests.bench.search.sets import Places
from tests.bench.setting import BenchSetting

DRIVES, SEED = 300, 1


@dataclass(frozen=True)
class Options:
    """Options of the command line."""

    drives: int = DRIVES
    seed: int = SEED


class _Search:
    """All drives, which run once."""

    def __init__(self, setting: BenchSetting, options: Options) -> None:
        self.setting, self.options = setting, options

    @functools.cached_property
    def found(self) -> Found:
        setting, out = self.setting, self.setting.out / "search"
        places = Places(setting.build, setting.shared)
        binary = setting.build / "bin" / "zloam-offline"
        drives = [sets.drawn(self.options.seed, n) for n in range(self.options.drives)]
        rows = []
        print(runner.HEAD, flush=True)
        each = functools.partial(runner.run, places=places, binary=binary, out=out)
        for row in runner.run_all(drives, each):
            rows.append(row)
            print(f"{runner.line(row)}  {len(rows)}/{len(drives)}", flush=True)
        runner.write_json(out / "rows.json", rows, binary, ())
        report.write(out / "report.md", rows)
        return report.found_in(rows)

    def _outcome(self, figure: str, held: bool) -> Outcome:
        found = self.found
        if found.failed:
            raise RuntimeError(f"{len(found.failed)} drives without a verdict: {found.failed[0]}")
        return Outcome(figure, {"seed": self.options.seed, **vars(found)}, held)

    def fused(self) -> Outcome:
        found = self.found
        figure = f"above in {found.above_bound} of {found.drives} drives"
        return self._outcome(figure, found.above_bound == 0)

    def silent(self) -> Outcome:
        found = self.found
        figure = f"{found.silent} of {found.poses} poses, in {found.silent_drives} drives"
        return self._outcome(figure, found.silent == 0)

    def flags(self) -> Outcome:
        found = self.found
        figure = f"{found.false_share:.2%} of {found.right} right poses"
        return self._outcome(figure, found.false_share < report.FALSE_FLAG_SHARE)


def benchmarks(setting: BenchSetting, options: Options) -> list[Benchmark]:
    """Three rows; the ten worst drives, with their commands, are in OUT/search/report.md."""
    search, many = _Search(setting, options), f"{options.drives} random drives, seed {options.seed}"
    return [
        Benchmark(
            "search-fused",
            f"{many}: ATE of the fused pose beside odometry's and the map's",
            search.fused,
            "≤ 1.2 × the better + 5 mm in each",
        ),
        Benchmark(
            "search-silent",
            f"{many}: Ok though the motion since the last Ok is off by over 3 σ + 2 cm",
            search.silent,
            "none",
        ),
        Benchmark(
            "search-flags",
            f"{many}: Degenerate, Predicted, Bridging or Lost said of a pose that is right",
            search.flags,
            f"< {report.FALSE_FLAG_SHARE:.0%}",
        ),
    ]
