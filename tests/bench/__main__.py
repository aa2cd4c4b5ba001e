"""`python -m tests.bench`: runs all benchmarks; out/bench/report.md and report.json.

Exit code 0: no limit is exceeded (benchmarks whose prerequisites are missing do not count); 1: a
limit is exceeded; 2: no benchmark matches.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.bench import (
    decode,
    decode_ouster,
    drive,
    framework,
    graph,
    kidnap,
    live,
    memory,
    peers,
    replay,
    scaling,
    simulator,
    transport,
    versus,
)
from tests.bench.search import rows as search
from tests.bench.setting import BenchSetting
from tests.bench.versus.rows import Options


def all_benchmarks(
    setting: BenchSetting, options: Options, drives: search.Options
) -> list[framework.Benchmark]:
    """All benchmarks, in the order of the report."""
    modules = (
        transport,
        live,
        replay,
        memory,
        decode,
        decode_ouster,
        simulator,
        peers,
        scaling,
        graph,
        kidnap,
        drive,
    )
    rows = [b for module in modules for b in module.benchmarks(setting)]
    return rows + versus.benchmarks(setting, options) + search.benchmarks(setting, drives)


def options_of(args: argparse.Namespace) -> Options:
    """The options for the benchmarks versus-*."""
    systems = tuple(args.systems.split(",")) if args.systems else Options.systems
    return Options(args.data, args.runs, args.add, args.kept_peers, systems)


def main() -> int:
    parser = argparse.ArgumentParser(prog="tests.bench", description=__doc__)
    parser.add_argument("--preset-dir", type=Path, default=Path("build/release"))
    parser.add_argument("--only", help="part of a name, or a pattern over names")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    parser.add_argument("--list", action="store_true", help="names only")
    parser.add_argument(
        "--data", default="small", help="versus-*: data sets, patterns over them, `small` or `all`"
    )
    parser.add_argument("--runs", type=int, default=3, help="versus-*: rounds of all systems")
    parser.add_argument(
        "--add", action="store_true", help="versus-*: keep the rounds of an earlier call"
    )
    parser.add_argument(
        "--kept-peers",
        action="store_true",
        help="versus-*: peers' errors as kept, no CPU",
    )
    parser.add_argument("--systems", help="versus-*: comma-separated")
    parser.add_argument("--drives", type=int, default=search.DRIVES, help="search-*: how many")
    parser.add_argument("--seed", type=int, default=search.SEED, help="search-*: of the drives")
    args = parser.parse_args()
    setting = BenchSetting.at(args.preset_dir, args.out)
    drives = search.Options(args.drives, args.seed)
    benchmarks = framework.chosen(all_benchmarks(setting, options_of(args), drives), args.only)
    if args.list or not benchmarks:
        print("\n".join(f"{b.name:<20} {b.what}" for b in benchmarks) or "nothing matches")
        return 0 if benchmarks else 2
    where, results = framework.machine(), []
    for benchmark in benchmarks:
        print(f"{benchmark.name}: {benchmark.what}", flush=True)
        results.append(framework.run(benchmark))
        framework.write(args.out, results, where)
    print("\n" + framework.table(results))
    if any(r.report for r in results):
        print("\n" + (args.out / "versus.md").read_text())
    print(f"{args.out}/report.md")
    bad = (framework.NOT_HELD, framework.FAILED)
    return 1 if any(r.verdict.startswith(bad) for r in results) else 0


if __name__ == "__main__":
    sys.exit(main())
