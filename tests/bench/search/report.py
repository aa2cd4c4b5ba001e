"""Results of a search: the figures of issue 36, the ten worst drives, kinds and worlds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench.search import drawing
from tests.bench.search.judge import Verdict
from tests.bench.search.runner import Row

WORST = 10
FALSE_FLAG_SHARE = 0.01
SKIPPED = "skipped"


@dataclass(frozen=True)
class Found:
    """Sums over all drives of a search."""

    drives: int
    failed: tuple[str, ...]
    poses: int
    above_bound: int
    silent: int
    silent_drives: int
    vague: int
    false_flags: int
    right: int

    @property
    def false_share(self) -> float:
        return self.false_flags / max(1, self.right)

    @property
    def whole(self) -> bool:
        """Whether every drive has a verdict."""
        return self.drives > 0 and not self.failed


def found_in(rows: list[Row]) -> Found:
    """Sums up the verdicts; a drive that failed counts only as failed."""
    judged = [r.verdict for r in rows if r.verdict is not None]
    return Found(
        drives=len(judged),
        failed=tuple(f"{r.name}: {r.failure}" for r in rows if r.verdict is None),
        poses=sum(v.poses for v in judged),
        above_bound=sum(not v.within_bound for v in judged),
        silent=sum(v.silent for v in judged),
        silent_drives=sum(v.silent > 0 for v in judged),
        vague=sum(v.vague for v in judged),
        false_flags=sum(v.false_flags for v in judged),
        right=sum(v.right for v in judged),
    )


def badness_m(verdict: Verdict) -> float:
    """Metres by which a user was misled: error beyond the reported one, plus fused error above the
    bound."""
    # A missing error counts as arbitrarily bad.
    above = float(np.nan_to_num(verdict.fused_m - verdict.bound_m, nan=1e9))
    return verdict.worst_silent_m + max(0.0, above)


def worst(rows: list[Row], count: int = WORST) -> list[tuple[Row, Verdict]]:
    """The drives with the largest `badness_m`, worst first; none with zero."""
    judged = [(r, r.verdict) for r in rows if r.verdict is not None]
    ranked = sorted(judged, key=lambda pair: badness_m(pair[1]), reverse=True)
    return [pair for pair in ranked[:count] if badness_m(pair[1]) > 0]


def command_of(name: str) -> str:
    """Command line that runs a single drive again."""
    return f"PYTHONPATH=services/monitor/src:. .venv/bin/python -m tests.bench.search {name}"


def _in_words(name: str) -> str:
    _, seed, number = name.split("-")
    return drawing.in_words(*drawing.draw(int(seed), int(number)))


def _worst_lines(rows: list[Row]) -> list[str]:
    lines = [
        "| drive | odometry, map, fused m | ok of poses | silent | by m | false | what |",
        "|---|---|---|---|---|---|---|",
    ]
    for row, v in worst(rows):
        lines.append(
            f"| {row.name} | {v.odometry_m:.3f}, {v.map_m:.3f}, {v.fused_m:.3f} | {v.ok} of "
            f"{v.poses} | {v.silent} from pose {v.first_silent} | {v.worst_silent_m:.3f} | "
            f"{v.false_flags} | {_in_words(row.name)} |"
        )
    return lines


def _grouped(rows: list[Row], title: str, key: Callable[[str], str]) -> list[str]:
    """Medians and counts of the drives, grouped by `key` of their names."""
    groups: dict[str, list[Verdict]] = defaultdict(list)
    for row in rows:
        if row.verdict is not None:
            groups[key(row.name)].append(row.verdict)
    lines = [
        f"| {title} | drives | median fused m | fused > 1 m | above bound | with silent | vague |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, of_group in sorted(groups.items()):
        fused = np.array([v.fused_m for v in of_group])
        lines.append(
            f"| {name} | {len(of_group)} | {np.median(fused):.4f} | {int((fused > 1.0).sum())} | "
            f"{sum(not v.within_bound for v in of_group)} | "
            f"{sum(v.silent > 0 for v in of_group)} | {sum(v.vague for v in of_group)} |"
        )
    return lines


def _drawn(name: str) -> tuple[drawing.Description, drawing.Kind]:
    _, seed, number = name.split("-")
    return drawing.draw(int(seed), int(number))


def _rate(name: str) -> str:
    drive, _ = _drawn(name)
    hz = drive["lidar"]["hz"]
    turns = max(1, int(drive["duration_s"] * hz))
    arriving_hz = hz * (1.0 - len(drive["dropped"]) / turns)
    edges = (3.0, 5.0, 8.0, 12.0)
    return next((f"below {edge:g} Hz" for edge in edges if arriving_hz < edge), "12 Hz and above")


def summary(found: Found) -> str:
    """The results in one line."""
    return (
        f"{found.drives} drives, {found.poses} poses: fused above 1.2 x the better of odometry and "
        f"map + 5 mm in {found.above_bound} drives; silently wrong {found.silent} poses in "
        f"{found.silent_drives} drives; false flags {found.false_flags} of {found.right} right "
        f"poses ({found.false_share:.2%}); vague {found.vague}; failed {len(found.failed)}"
    )


def write(path: Path, rows: list[Row]) -> None:
    """Writes the report as Markdown."""
    found = found_in(rows)
    lines = ["# Search for the worst", "", summary(found), ""]
    lines += [f"- {failure}" for failure in found.failed]
    lines += ["", f"## The worst {WORST}", "", *_worst_lines(rows), ""]
    if ranked := worst(rows):
        lines += ["One of them again:", "", f"    {command_of(ranked[0][0].name)}", ""]
    lines += ["## By platform", "", *_grouped(rows, "platform", lambda n: _drawn(n)[1].name), ""]
    lines += ["## By world", "", *_grouped(rows, "world", lambda n: _drawn(n)[0]["world"]), ""]
    lines += ["## By sweeps a second that arrive", "", *_grouped(rows, "rate", _rate), ""]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines))
