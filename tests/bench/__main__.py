"""`python -m tests.bench`: all benchmarks; out/bench/report.md and report.json.

Exit code 0: every limit is held (or what it needs is not here); 1: one is not; 2: nothing matches.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.bench import decode, framework, live, peers, simulator, transport
from tests.bench.setting import BenchSetting


def all_benchmarks(setting: BenchSetting) -> list[framework.Benchmark]:
    """In the order of the report."""
    modules = (transport, live, decode, simulator, peers)
    return [b for module in modules for b in module.benchmarks(setting)]


def main() -> int:
    parser = argparse.ArgumentParser(prog="tests.bench", description=__doc__)
    parser.add_argument("--preset-dir", type=Path, default=Path("build/release"))
    parser.add_argument("--only", help="part of a name, or a pattern over names")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    parser.add_argument("--list", action="store_true", help="names only")
    args = parser.parse_args()
    setting = BenchSetting.at(args.preset_dir, args.out)
    benchmarks = framework.chosen(all_benchmarks(setting), args.only)
    if args.list or not benchmarks:
        print("\n".join(f"{b.name:<20} {b.what}" for b in benchmarks) or "nothing matches")
        return 0 if benchmarks else 2
    where, results = framework.machine(), []
    for benchmark in benchmarks:
        print(f"{benchmark.name}: {benchmark.what}", flush=True)
        results.append(framework.run(benchmark))
        framework.write(args.out, results, where)
    print("\n" + framework.table(results))
    print(f"{args.out}/report.md")
    bad = (framework.NOT_HELD, framework.FAILED)
    return 1 if any(r.verdict.startswith(bad) for r in results) else 0


if __name__ == "__main__":
    sys.exit(main())
