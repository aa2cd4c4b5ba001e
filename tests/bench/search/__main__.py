"""python -m tests.bench.search [SETS] [--binary PATH] [--set key=value ...]: one row per drive.

SETS: comma-separated names, patterns of names (swung-*), the groups table, normal, worlds, or
random drives: drive-SEED-NUMBER.
"""

from __future__ import annotations

import argparse
import fnmatch
import functools
import os
import sys
from pathlib import Path

from tests.acceptance.runs import ROOT
from tests.bench.search import report, runner, sets
from tests.bench.search.sets import DataSet, Places


def chosen(known: list[DataSet], wanted: str) -> list[DataSet]:
    """The selected sets in the given order; ends the program if a part of `wanted` matches
    nothing."""
    found: set[str] = set()
    random: list[DataSet] = []
    for part in (p.strip() for p in wanted.split(",")):
        if drive := sets.by_name(part):
            random.append(drive)
            continue
        names = {d.name for d in known if fnmatch.fnmatch(d.name, part) or part == d.group}
        if not names:
            raise SystemExit(f"no drive or group {part}; --list names all")
        found |= names
    return [d for d in known if d.name in found] + random


def main() -> int:
    parser = argparse.ArgumentParser(prog="tests.bench.search", description=__doc__)
    parser.add_argument("sets", nargs="?", default="table,normal,worlds")
    parser.add_argument("--preset-dir", type=Path, default=Path("build/release"))
    parser.add_argument("--binary", type=Path, help="a zloam-offline, of this tree or another")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--arg", action="append", default=[], help="further arguments, as given")
    parser.add_argument("--out", type=Path, default=Path("out/search"))
    parser.add_argument("--json", type=Path, help="default: OUT/rows.json")
    parser.add_argument("--jobs", type=int, default=runner.JOBS, help="two at most")
    parser.add_argument("--drives", type=int, help="so many random drives instead of SETS")
    parser.add_argument("--seed", type=int, default=1, help="of the random drives")
    parser.add_argument("--list", action="store_true")
    args = parser.parse_args()
    wanted = (
        [sets.drawn(args.seed, n) for n in range(args.drives)]
        if args.drives
        else chosen(sets.all_sets(), args.sets)
    )
    if args.list:
        print("\n".join(f"{d.name:<18} {d.group}" for d in wanted))
        return 0
    shared = Path(os.environ.get("ZLOAM_SHARED", ROOT.parent / "shared"))
    places = Places(args.preset_dir.resolve(), shared)
    binary = args.binary or places.build / "bin" / "zloam-offline"
    more = (*(f"--set={s}" for s in args.set), *args.arg)
    print(runner.HEAD, flush=True)
    rows = []
    each = functools.partial(
        runner.run, places=places, binary=binary.resolve(), out=args.out.resolve(), more=more
    )
    for row in runner.run_all(wanted, each, args.jobs):
        rows.append(row)
        print(runner.line(row), flush=True)
    print(report.summary(report.found_in(rows)))
    runner.write_json(args.json or args.out / "rows.json", rows, binary, more)
    if all(d.group == sets.SEARCH for d in wanted):
        report.write(args.out / "report.md", rows)
    failed = any(r.verdict is None and not r.failure.startswith("skipped") for r in rows)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
