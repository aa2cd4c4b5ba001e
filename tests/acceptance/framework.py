"""A check of the acceptance has a name, a text, a limit, and a function that measures."""

from __future__ import annotations

import fnmatch
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

HELD, NOT_HELD, SKIPPED = "held", "not held", "skipped"


class Skip(RuntimeError):
    """The check cannot be made here; the text is the reason."""


@dataclass(frozen=True)
class Measured:
    """The measured figure in words, and whether it is within the limit."""

    figure: str
    held: bool


@dataclass(frozen=True)
class Check:
    """One check of the acceptance that a program can judge."""

    name: str
    line: str
    limit: str
    command: str
    measure: Callable[[], Measured]
    #: part A to E of issue 37; such checks have a table of their own: what was injected, and the
    #: result
    part: str = ""


@dataclass
class Result:
    """One row of out/accept.md."""

    name: str
    line: str
    limit: str
    figure: str
    verdict: str
    command: str
    seconds: float = field(default=0.0)
    part: str = ""


def run(check: Check) -> Result:
    """Makes the check; an exception becomes the verdict `not held` with its text."""
    began = time.monotonic()
    try:
        measured = check.measure()
        figure, verdict = measured.figure, HELD if measured.held else NOT_HELD
    except Skip as skip:
        figure, verdict = "–", f"{SKIPPED} ({skip})"
    except Exception as error:
        figure, verdict = f"{type(error).__name__}: {_first_line(str(error))}", NOT_HELD
    seconds = time.monotonic() - began
    return Result(
        check.name, check.line, check.limit, figure, verdict, check.command, seconds, check.part
    )


def _first_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[0][:160] if lines else "no text"


def chosen(checks: list[Check], pattern: str | None) -> list[Check]:
    """All checks, or those whose name or line contains or matches one of the comma-separated
    patterns."""
    if not pattern:
        return checks
    wanted = [part.strip().lower() for part in pattern.split(",")]
    return [
        c
        for c in checks
        if any(
            w in f"{c.name} {c.line}".lower() or fnmatch.fnmatch(c.name.lower(), w) for w in wanted
        )
    ]


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *([_cell(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _injected(results: list[Result]) -> str:
    rows = sorted((r for r in results if r.part), key=lambda r: r.part)
    if not rows:
        return ""
    head = ["", "injected", "limit", "seen", "verdict", "command"]
    cells = [[r.part, r.line, r.limit, r.figure, r.verdict, f"`{r.command}`"] for r in rows]
    return "\n## A–E: what was injected, and what was seen\n\n" + _table(head, cells)


def write(folder: Path, results: list[Result]) -> None:
    """Writes accept.md and accept.json."""
    folder.mkdir(parents=True, exist_ok=True)
    counts = {v: sum(r.verdict.startswith(v) for r in results) for v in (HELD, NOT_HELD, SKIPPED)}
    total = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    head = ["line", "limit", "figure", "verdict", "command"]
    cells = [
        [r.line, r.limit, r.figure, r.verdict, f"`{r.command}`"] for r in results if not r.part
    ]
    text = f"# Acceptance\n\n{total}\n\n" + _table(head, cells) + _injected(results)
    (folder / "accept.md").write_text(text)
    (folder / "accept.json").write_text(
        json.dumps([asdict(r) for r in results], indent=2, ensure_ascii=False) + "\n"
    )
