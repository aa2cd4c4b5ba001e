"""A benchmark measures something, reports it in words and figures, and may have a limit."""

from __future__ import annotations

import copy
import fnmatch
import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tests.acceptance.framework import Skip

HELD, NOT_HELD, REPORTED, SKIPPED, FAILED = "held", "not held", "reported", "skipped", "failed"


@dataclass(frozen=True)
class Outcome:
    """What was measured; `held` is set only where a limit can be judged by it."""

    figure: str
    values: dict[str, Any]
    held: bool | None = None
    #: goes to the top level of report.json, merged with that of the other benchmarks
    report: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Benchmark:
    """One row of the report."""

    name: str
    what: str
    measure: Callable[[], Outcome]
    limit: str = ""


@dataclass
class Result:
    """The outcome of a benchmark."""

    name: str
    what: str
    limit: str
    verdict: str
    figure: str
    seconds: float
    values: dict[str, Any] = field(default_factory=dict)
    report: dict[str, Any] = field(default_factory=dict)


def _verdict(benchmark: Benchmark, outcome: Outcome) -> str:
    if not benchmark.limit or outcome.held is None:
        return REPORTED
    return HELD if outcome.held else NOT_HELD


def run(benchmark: Benchmark) -> Result:
    """Runs the benchmark; an exception becomes its verdict."""
    began = time.monotonic()
    figure, values, report = "–", {}, {}
    try:
        outcome = benchmark.measure()
        verdict, figure, values = _verdict(benchmark, outcome), outcome.figure, outcome.values
        report = outcome.report
    except Skip as skip:
        verdict = f"{SKIPPED}: {skip}"
    except Exception as error:
        verdict = f"{FAILED}: {type(error).__name__}: {' '.join(str(error).split())[:300]}"
    return Result(
        benchmark.name,
        benchmark.what,
        benchmark.limit,
        verdict,
        figure,
        time.monotonic() - began,
        values,
        report,
    )


def chosen(benchmarks: list[Benchmark], pattern: str | None) -> list[Benchmark]:
    """All benchmarks, or those that a comma-separated part of the pattern selects: the one with
    exactly that name, or else all whose name contains or matches it."""
    if not pattern:
        return benchmarks
    names = {b.name for b in benchmarks}
    found: set[str] = set()
    for part in (text.strip() for text in pattern.split(",")):
        wide = {n for n in names if part in n or fnmatch.fnmatch(n, part)}
        found |= {part} if part in names else wide
    return [b for b in benchmarks if b.name in found]


def machine() -> dict[str, Any]:
    """The machine of the figures; its load tells whether absolute figures mean anything."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": models[0] if models else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "load_1min": os.getloadavg()[0],
        "system": platform.platform(),
    }


def merge(into: dict[str, Any], more: dict[str, Any]) -> None:
    """Adds new keys recursively."""
    for key, value in more.items():
        if isinstance(value, dict) and isinstance(into.get(key), dict):
            merge(into[key], value)
        else:
            into[key] = copy.deepcopy(value)


def write(folder: Path, results: list[Result], where: dict[str, Any]) -> None:
    """Writes report.json and report.md."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [asdict(r) for r in results]
    report: dict[str, Any] = {"machine": where, "benchmarks": rows}
    for row in rows:
        merge(report, row.pop("report"))
    (folder / "report.json").write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n")
    head = f"{where['cpu']}, {where['cores']} cores, load {where['load_1min']:.1f} at the start"
    lines = ["| benchmark | measures | limit | figure | verdict |", "|---|---|---|---|---|"]
    lines += [
        "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
        for cells in ((r.name, r.what, r.limit or "–", r.figure, r.verdict) for r in results)
    ]
    (folder / "report.md").write_text(f"# Benchmarks\n\n{head}\n\n" + "\n".join(lines) + "\n")


def table(results: list[Result]) -> str:
    """The results as a table for the terminal."""
    width = max(len(r.name) for r in results)
    lines = []
    for r in results:
        limit = f" (limit: {r.limit})" if r.limit else ""
        lines.append(f"{r.name:<{width}}  {r.figure}{limit}: {r.verdict}")
    return "\n".join(lines)
