"""report.html: a run's report as one self-contained page with its picture."""

from __future__ import annotations

import base64
import csv
import json
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from zloam_monitor import pose_health
from zloam_monitor import report as reports
from zloam_monitor.files import written_whole
from zloam_monitor.records import HEALTH

STYLE = """
:root { color-scheme: light dark; --line: #8884; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2rem auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .5rem 0 1.5rem; }
th, td { text-align: right; padding: .2rem .8rem .2rem 0; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
img, svg { max-width: 100%; height: auto; }
.good { color: #1b7f4b; } .bad { color: #c0392b; }
"""
#: Sizes of the chart in its own units.
WIDTH, HEIGHT, LEFT, BOTTOM = 1000, 220, 60, 30


class NoRun(RuntimeError):
    """The folder has no report."""


def write(folder: Path, title: str) -> Path:
    """Writes the page into the folder of a finished run; raises NoRun."""
    try:
        found: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise NoRun(f"{folder}: there is no report.json of a run in it") from error
    path = folder / "report.html"
    with written_whole(path) as out:
        out.write(page(found, title, folder / "picture.png", folder / "poses.csv"))
    return path


def page(found: dict[str, Any], title: str, picture: Path, poses: Path) -> str:
    """The whole HTML document."""
    parts = [
        f"<h1>{escape(title)}</h1>",
        _verdict(found),
        _picture(picture),
        "<h2>Errors</h2>",
        _errors(found),
        "<h2>Stages</h2>",
        _table(*_head_and_rows(reports.stage_rows(found))),
        f"<p>{escape(reports.WORK_TIMES)}</p>",
        f"<p>{escape(reports.latency_line(found))}</p>",
        "<h2>Sigma of the position</h2>",
        sigma_chart(poses),
        _listed("Said by the stages", found.get("remarks", [])),
        _listed("Changed while it ran", found.get("set_at", [])),
        _listed("Changes that the run ended before", found.get("set_too_late", [])),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def _verdict(found: dict[str, Any]) -> str:
    complaints = reports.complaints(found)
    kind = "bad" if complaints else "good"
    words = "; ".join(complaints) or "every sweep is accounted for, every process ended well"
    lines = (reports.summary_line(found), pose_health.line(found["health"]))
    return f'<p class="{kind}">{escape(words)}</p>' + "".join(f"<p>{escape(x)}</p>" for x in lines)


def _picture(path: Path) -> str:
    if not path.is_file():
        return ""
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="map and trajectory from above" src="data:image/png;base64,{data}">'


def _errors(found: dict[str, Any]) -> str:
    scores = reports.scores_of(found)
    rows = [
        [
            words,
            reports.number_text(s["ate_rmse_m"], 3),
            reports.number_text(s["drift_percent"], 3),
            reports.number_text(s["rpe_1m_m"], 3),
            str(s["matched"]),
        ]
        for words, s in scores
    ]
    table = _table(["", "ATE, m", "drift, %", "RPE over 1 m, m", "poses"], rows) if rows else ""
    said = [f"{words}: {s['remark']}" for words, s in scores if s.get("remark")]
    said += reports.without_error(found)
    return table + "".join(f"<p>{escape(line)}</p>" for line in said)


def _head_and_rows(grid: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    return grid[0], grid[1:]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["<tr>" + "".join(f'<th scope="col">{escape(c)}</th>' for c in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows]
    return "<table>" + "".join(lines) + "</table>"


def _listed(title: str, items: Sequence[str]) -> str:
    if not items:
        return ""
    return f"<h2>{title}</h2><ul>" + "".join(f"<li>{escape(i)}</li>" for i in items) + "</ul>"


def sigma_chart(path: Path) -> str:
    """Largest position sigma of the three axes for each pose; poses that are not ok in red."""
    if not path.is_file():
        return ""
    with path.open(encoding="utf-8") as file:
        rows = [
            (int(r["sweep"]), int(r["health"]), [float(r[f"c{i}{i}"]) for i in range(3)])
            for r in csv.DictReader(file)
            if r["c00"]
        ]
    if len(rows) < 2:
        return "" if rows else "<p>The poses have no covariance.</p>"
    sweeps = np.array([row[0] for row in rows])
    sigma_m = np.sqrt(np.maximum(np.array([max(row[2]) for row in rows]), 0.0))
    bad = np.array([row[1] != HEALTH.index("ok") for row in rows])
    highest = float(sigma_m.max()) or 1.0
    x = LEFT + (WIDTH - LEFT) * (sweeps - sweeps[0]) / max(1, sweeps[-1] - sweeps[0])
    y = (HEIGHT - BOTTOM) * (1.0 - sigma_m / highest)
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    marks = "".join(
        f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2" fill="#c0392b"/>'
        for a, b in zip(x[bad], y[bad], strict=True)
    )
    text = 'font-size="14" fill="currentColor"'
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="sigma of the position by '
        f'sweep"><polyline points="{line}" fill="none" stroke="#2f7fd6" stroke-width="1.5"/>'
        f'{marks}<text x="0" y="14" {text}>{highest:.3g} m</text>'
        f'<text x="0" y="{HEIGHT - BOTTOM}" {text}>0</text>'
        f'<text x="{LEFT}" y="{HEIGHT - 8}" {text}>sweep {sweeps[0]}</text>'
        f'<text x="{WIDTH - 110}" y="{HEIGHT - 8}" {text}>sweep {sweeps[-1]}</text></svg>'
        + ("<p>Red: poses that are not ok.</p>" if bad.any() else "")
    )
