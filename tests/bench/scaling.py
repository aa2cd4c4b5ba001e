"""CPU time per sweep against the number of points, the size of the map and the length of the run.

The three algorithms run in one process without messages (`offline/`). Picture:
out/bench/scaling.png.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from tests.acceptance import laps
from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, cost_of
from tests.bench.versus import data
from zloam_monitor.chain import binary

matplotlib.use("Agg")
import matplotlib.pyplot as plt

#: keep the returns of every n-th part of the revolution
THIN = (8, 4, 2, 1)
LAPS = laps.LAPS
#: number of parts of the way; costs are averaged over each part
PLACES = 10
STEPS = ("registration", "odometry", "mapping")
COLOURS = dict(zip((*STEPS, "all"), ("#2ca02c", "#ff7f0e", "#1f77b4", "#111111"), strict=True))
#: Limits: the cost grows at most in proportion to the points, and not at all with the map and the
#: run.
MOST_EXPONENT = 1.0
MOST_GROWTH = laps.GROWTH

Array = NDArray[np.float64]
Costs = dict[str, Array]


@dataclass(frozen=True)
class Law:
    """Mean costs against a quantity x; `all` is the sum of the steps."""

    name: str
    x_label: str
    x: Array
    ms: Costs


def _costs(setting: BenchSetting, source: Path, name: str, *options: object) -> Costs:
    """Columns of the table that `zloam-offline` writes about each sweep."""
    out = setting.out / "scaling" / name
    cost_of([binary(setting.build, "offline"), source, out, *options])
    table = np.genfromtxt(out / "cost.csv", delimiter=",", names=True)
    found = {step: table[f"{step}_ms"] for step in STEPS}
    found["all"] = sum((found[step] for step in STEPS), np.zeros(len(table)))
    return found | {"points": table["points"], "map_points": table["map_points"]}


def _means(costs: Costs, chosen: slice) -> dict[str, float]:
    return {name: float(column[chosen].mean()) for name, column in costs.items()}


def _law(name: str, x_label: str, over: str, means: list[dict[str, float]]) -> Law:
    x = np.array([m[over] for m in means])
    return Law(name, x_label, x, {n: np.array([m[n] for m in means]) for n in COLOURS})


def _by_points(setting: BenchSetting, name: str, source: Path, *options: object) -> Law:
    """Costs of one drive at several degrees of thinning."""
    runs = [_costs(setting, source, f"{name}-{thin}", "--thin", thin, *options) for thin in THIN]
    # The first quarter is left out: there the map is still being initialized.
    means = [_means(costs, slice(len(costs["all"]) // 4, None)) for costs in runs]
    return _law(name, "points a sweep", "points", means)


def _exponent(law: Law) -> float:
    """Exponent of cost ~ points^exponent, over all steps."""
    return float(np.polyfit(np.log(law.x), np.log(law.ms["all"]), 1)[0])


@dataclass(frozen=True)
class Laws:
    """All measured dependencies."""

    points: list[Law]
    map_size: Law
    length: Law
    #: ratio of the second lap's cost to the first's at the same places, and that of the map's
    #: points there
    same_places: tuple[float, float]


def _measure(setting: BenchSetting) -> Laws:
    costs = _costs(setting, laps.capture(setting), "laps")
    sweeps = len(costs["all"])
    of_lap = [
        _means(costs, slice(n * sweeps // LAPS, (n + 1) * sweeps // LAPS)) | {"lap": n + 1.0}
        for n in range(LAPS)
    ]
    places = [
        _means(costs, slice(n * sweeps // LAPS // PLACES, (n + 1) * sweeps // LAPS // PLACES))
        for n in range(2 * PLACES)
    ]
    late = slice(PLACES // 2, PLACES), slice(PLACES + PLACES // 2, 2 * PLACES)
    first, second = (
        {n: float(np.mean([p[n] for p in places[part]])) for n in ("mapping", "map_points")}
        for part in late
    )
    laws = Laws(
        _all_by_points(setting),
        _law("the first two laps", "points in the map", "map_points", places),
        _law(f"{LAPS} laps of the city", "lap", "lap", of_lap),
        (second["mapping"] / first["mapping"], second["map_points"] / first["map_points"]),
    )
    _draw(setting.out / "scaling.png", laws)
    return laws


def _all_by_points(setting: BenchSetting) -> list[Law]:
    found = [_by_points(setting, "simulated city, VLP-16", setting.capture())]
    if (setting.shared / "data/hdl64e_drive").exists():
        drive = data.chosen(data.all_sets(setting), "drive")[0].get().folder
        scans = drive / json.loads((drive / "meta.json").read_text())["scans_in"]
        options = ("--set", "registration.min_range_m=3")
        found.append(_by_points(setting, "recorded drive, HDL-64E", scans, *options))
    return found


def _draw(path: Path, laws: Laws) -> None:
    shown = [*laws.points, laws.map_size, laws.length]
    figure, panels = plt.subplots(
        1, len(shown), figsize=(5 * len(shown), 4.5), dpi=100, layout="constrained"
    )
    for panel, law in zip(panels, shown, strict=True):
        order = np.argsort(law.x)
        for name, colour in COLOURS.items():
            panel.plot(law.x[order], law.ms[name][order], "o-", color=colour, label=name)
        panel.set(title=law.name, xlabel=law.x_label, ylabel="CPU ms a sweep")
        panel.set(xlim=(0, None), ylim=(0, None))
        panel.grid(alpha=0.25)
    panels[0].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    plt.close(figure)


def _points(laws: Laws) -> Outcome:
    found = {law.name: _exponent(law) for law in laws.points}
    words = "; ".join(
        f"{law.name}: {law.x[0]:.0f} to {law.x[-1]:.0f} points, "
        f"{law.ms['all'][0]:.1f} to {law.ms['all'][-1]:.1f} ms, exponent {found[law.name]:.2f}"
        for law in laws.points
    )
    return Outcome(words, {"exponent": found}, all(e <= MOST_EXPONENT for e in found.values()))


def _map_size(laws: Laws) -> Outcome:
    cost, size = laws.same_places
    return Outcome(
        f"mapping {cost:.2f} × where the map has {size:.2f} × the points",
        {"mapping_cost_ratio": cost, "map_points_ratio": size},
        cost <= MOST_GROWTH,
    )


def _length(laws: Laws) -> Outcome:
    every = laws.length.ms["all"]
    ratio = float(every[-1] / every[1])
    words = f"lap 2 {every[1]:.1f}, lap {LAPS} {every[-1]:.1f} ms: {ratio:.2f} ×"
    return Outcome(words, {"ms_by_lap": every.tolist(), "ratio": ratio}, ratio <= MOST_GROWTH)


_ROWS: tuple[tuple[str, str, Callable[[Laws], Outcome], str], ...] = (
    (
        "points",
        "CPU a sweep of the three algorithms in one process, sweeps thinned out",
        _points,
        f"exponent ≤ {MOST_EXPONENT:.0f}",
    ),
    (
        "map",
        "second half of the second lap beside the first lap's: the same places, a larger map",
        _map_size,
        f"≤ {MOST_GROWTH} ×",
    ),
    ("length", f"{LAPS} laps of the simulated city", _length, f"≤ {MOST_GROWTH} ×"),
)


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    """Three rows from one set of runs."""

    @functools.cache
    def measured() -> Laws:
        return _measure(setting)

    def row(judge: Callable[[Laws], Outcome]) -> Callable[[], Outcome]:
        return lambda: judge(measured())

    return [
        Benchmark(f"scaling-{name}", what, row(judge), limit) for name, what, judge, limit in _ROWS
    ]
