"""The figures as Markdown tables, and one picture per data set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from tests.bench.versus.data import Scans
from tests.bench.versus.summary import KISS, Entry
from tests.bench.versus.systems import ALOAM, OURS, PEERS
from zloam_monitor import evaluation
from zloam_monitor.trajectory import Trajectory

matplotlib.use("Agg")
import matplotlib.pyplot as plt

COLUMNS = (OURS, *PEERS, ALOAM)
COLOURS = dict(zip(COLUMNS, ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e"), strict=False))
#: m; smaller errors are drawn at this value
LEAST_DRAWN_M = 1e-4


def number(value: float | None) -> str:
    """Formats with three significant digits, without exponent."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    decimals = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{decimals}f}"


def _cell(entry: Entry | None) -> str:
    if not entry:
        return "–"
    if "sweeps" not in entry:
        return next(iter(entry), "–")
    ate, drift = number(entry.get("ate_rmse_m")), number(entry.get("drift_percent"))
    cpu = number(entry.get("cpu_ms_per_sweep"))
    low, high = entry.get("spread", {}).get("cpu_ms_per_sweep", (None, None))
    if entry.get("rounds", 1) > 1 and low is not None:
        cpu += f"; {number(low)}–{number(high)}"
    lost = " **lost**" if entry.get("lost") else ""
    return f"{ate} / {drift} ({cpu}){lost}"


def _rows(head: list[str], rows: list[list[str]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines]


def errors_and_cost(found: dict[str, dict[str, Entry]]) -> list[str]:
    """One row per data set, one column per system."""
    rows = [[data, *(_cell(systems.get(c)) for c in COLUMNS)] for data, systems in found.items()]
    return _rows(["data set", *COLUMNS], rows)


def comparison(found: dict[str, dict[str, Entry]], ratios: dict[str, dict[str, Any]]) -> list[str]:
    """Ratios of ours to the peers'."""
    head = ["data set", "ATE / best peer", "drift / best peer", "CPU / kiss-icp", "CPU / a-loam"]
    rows = []
    for data, r in ratios.items():
        best = [
            f"{number(r.get(f'{n}_to_best_peer'))} ({r.get(f'{n}_best_peer', '–')})"
            for n in ("ate_rmse_m", "drift_percent")
        ]
        cpu = [number(r.get(f"cpu_to_{peer}")) for peer in (KISS, ALOAM)]
        ours = found[data].get(OURS, {})
        whole = number(ours.get("cpu_all_processes_ms_per_sweep"))
        name = f"{data} (without {', '.join(r['without'])})" if r.get("without") else data
        rows.append([name, *best, *cpu, whole, ", ".join(r["beaten_by"]) or "none"])
    return _rows([*head, "CPU ms, all five processes", "better in error and CPU both"], rows)


def memory(found: dict[str, dict[str, Entry]]) -> list[str]:
    """Peak of the resident set size, MiB."""
    systems = COLUMNS
    rows = []
    for data, of in found.items():
        each = [number(of.get(name, {}).get("rss_mib")) for name in systems]
        rows.append([data, number(of.get(OURS, {}).get("rss_all_processes_mib")), *each])
    return _rows(["data set", f"{OURS}, all five", *systems], rows)


def document(
    found: dict[str, dict[str, Entry]], ratios: dict[str, dict[str, Any]], where: str
) -> str:
    """The document versus.md."""
    parts = [
        "# Ours and the peers on the same scans",
        where,
        "ATE rmse m / drift % (CPU ms per sweep, median; least–most of the rounds). "
        f"`{OURS}`, `{ALOAM}`: registration, odometry and mapping as programs, transport included.",
        "\n".join(errors_and_cost(found)),
        "\n".join(comparison(found, ratios)),
        f"Peak RSS, MiB. `{OURS}`, `{ALOAM}`: the three algorithms' processes added up; a peer's "
        "includes its Python.",
        "\n".join(memory(found)),
    ]
    return "\n\n".join(parts) + "\n"


def picture(path: Path, title: str, scans: Scans, runs: dict[str, Trajectory]) -> None:
    """The trajectories aligned with the truth, from above, and their distance from it along the
    way."""
    figure, (above, along) = plt.subplots(
        1, 2, figsize=(16, 8), dpi=100, layout="constrained", width_ratios=[1.3, 1.0]
    )
    figure.suptitle(title)
    truth = scans.truth.positions
    above.plot(truth[:, 0], truth[:, 1], color="#111111", lw=3, alpha=0.5, label="truth")
    for name, run in runs.items():
        compared = evaluation.compare(run, scans.truth)
        if compared is None:
            continue
        at, error = compared.aligned[:, :3, 3], compared.errors_m()
        rmse = float(np.sqrt(np.mean(error**2)))
        style = {"color": COLOURS[name], "lw": 1.8 if name == OURS else 1.1}
        above.plot(at[:, 0], at[:, 1], label=f"{name}: {rmse:.3f} m", **style)
        along.semilogy(np.maximum(error, LEAST_DRAWN_M), **style)
    _frame(above, truth)
    figure.legend(loc="outside lower center", ncols=len(COLUMNS))
    along.set(xlabel="sweep", ylabel="distance from the truth (m)", title="error after alignment")
    along.grid(alpha=0.25, which="both")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)


def _frame(axes: Any, truth: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    """Limits the axes to the truth: a lost system's trajectory may leave the picture."""
    low, high = truth[:, :2].min(axis=0), truth[:, :2].max(axis=0)
    margin = 0.1 * float((high - low).max()) + 1.0
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set(xlabel="x (m)", ylabel="y (m)", title="from above")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(alpha=0.25)
