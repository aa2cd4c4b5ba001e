"""`python -m tests.acceptance`: makes every check of the acceptance that a program can judge;
writes out/accept.md and accept.json."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.acceptance import framework
from tests.acceptance.checks import all_checks
from tests.acceptance.runs import Setting


def main() -> int:
    parser = argparse.ArgumentParser(prog="tests.acceptance", description=__doc__)
    parser.add_argument("--preset-dir", type=Path, default=Path("build/release"))
    parser.add_argument(
        "--only", help="comma-separated parts of names or lines, or patterns over names"
    )
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--list", action="store_true", help="names and lines only")
    args = parser.parse_args()
    checks = framework.chosen(all_checks(Setting.here(args.preset_dir, args.out)), args.only)
    if args.list or not checks:
        print("\n".join(f"{c.name:<24} {c.line}" for c in checks) or "nothing matches")
        return 0 if checks else 2
    results = []
    for check in checks:
        result = framework.run(check)
        results.append(result)
        framework.write(args.out, results)
        print(
            f"{result.verdict:<10} {check.name:<24} {result.figure}  (limit: {check.limit}; "
            f"{result.seconds:.0f} s)",
            flush=True,
        )
    print(f"{args.out}/accept.md")
    return 1 if any(r.verdict == framework.NOT_HELD for r in results) else 0


if __name__ == "__main__":
    sys.exit(main())
