"""Loops: share of the revisits that are found, false loops, and the effect on the trajectory.

Registration, odometry, mapping and the graph run in one process each, without messages
(`offline/`). By the simulator's truth, a submap is a revisit if it is less than 5 m from an earlier
one, 40 m or more of way before. The revisit is found if a loop within 20 m of way is in force. A
loop is false if it is off by more than 0.5 m.

Moving objects are told from static ones by the same drive without traffic: whether it has points
where a voxel of a submap lies.
"""

from __future__ import annotations

import csv
import functools
import re
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, cost_of
from zloam_monitor import evaluation, se3, trajectory
from zloam_monitor.chain import binary

WORLDS = Path("services/simulator/worlds")
SEEDS = (1, 2, 3)
ALIASED_SEEDS = range(1, 21)
#: a poor sensor, with which mapping drifts
POOR = ("--noise", "0.06", "--dropout", "0.3", "--range-bias-mm", "30")
LOOP_WAY_M, NEAR_M, FOUND_WAY_M, FALSE_M = 40.0, 5.0, 20.0, 0.5
#: A voxel moved if the drive without traffic has no point within FREE_M, and is static with one
#: within STANDS_M.
FREE_M, STANDS_M = 0.4, 0.3
LEAST_MOVED, LEAST_KEPT = 0.9, 0.99
MOST_WORSE, MOST_LEFT, LEAST_FOUND, MOST_CPU_MS = 1.02, 0.5, 0.95, 20.0

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """Results of the graph on one drive."""

    without_m: float
    with_m: float
    revisits: int
    found: int
    loops: int
    false: int
    cpu_ms: float

    @property
    def ratio(self) -> float:
        return self.with_m / self.without_m

    def words(self) -> str:
        return (
            f"ATE {self.without_m:.4f} → {self.with_m:.4f} m, {self.found} of {self.revisits} "
            f"revisits, {self.loops} loops, {self.false} false, {self.cpu_ms:.0f} ms a submap"
        )


def _graph(setting: BenchSetting, out: Path, simulated: Sequence[object], *more: object) -> str:
    """Runs the graph over a simulated drive and returns its output; the truth is in truth.tum."""
    out.mkdir(parents=True, exist_ok=True)
    capture, submaps = out / "capture.pcap", out / "submaps"
    made = ("--quiet", "--out", capture, "--truth-base", out / "truth.tum")
    subprocess.run(
        [str(c) for c in (binary(setting.build, "simulator"), *simulated, *made)], check=True
    )
    cost_of([binary(setting.build, "offline"), capture, out, "--submaps", submaps])
    judged = (submaps, out / "est.tum", out, *more)
    said = cost_of([binary(setting.build, "graph-offline"), *judged]).said
    for large in (capture, submaps):
        large.unlink()
    return said


def _drive(setting: BenchSetting, name: str, *simulated: object) -> Seen:
    out = setting.out / "graph" / name
    said = _graph(setting, out, simulated)
    return _seen(out, trajectory.read(out / "truth.tum"), said)


def _seen(out: Path, truth: trajectory.Trajectory, said: str) -> Seen:
    without = evaluation.evaluate(trajectory.read(out / "chain.tum"), truth)
    closed = evaluation.evaluate(trajectory.read(out / "graph.tum"), truth)
    nodes = trajectory.read(out / "submaps.tum")
    assert nodes.stamps_ns is not None
    real = trajectory.interpolate(truth, nodes.stamps_ns)[0].transforms
    assert len(real) == len(nodes), "submaps without a truth"
    with (out / "loops.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["verdict"] == "accepted"]
    loops = {(int(row["from"]), int(row["to"])): _pose(row) for row in rows}
    off = [
        float(np.linalg.norm((se3.inverse(T) @ se3.inverse(real[a]) @ real[b])[:3, 3]))
        for (a, b), T in loops.items()
    ]
    revisits, found = _revisits(real[:, :3, 3], {b for _, b in loops})
    cpu = re.search(r"CPU ms/submap ([0-9.]+)", said)
    assert cpu is not None
    assert without.ate_rmse_m is not None
    assert closed.ate_rmse_m is not None
    false = sum(not each <= FALSE_M for each in off)  # NaN is wrong, too
    return Seen(
        without.ate_rmse_m,
        closed.ate_rmse_m,
        revisits,
        found,
        len(loops),
        false,
        float(cpu[1]),
    )


def _pose(row: dict[str, str]) -> Array:
    at = [float(row[name]) for name in ("x", "y", "z")]
    turn = [float(row[name]) for name in ("qx", "qy", "qz", "qw")]
    return se3.matrices(np.array([at]), np.array([turn]))[0]


def _revisits(positions: Array, closed: set[int]) -> tuple[int, int]:
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    at = [way[i] for i in sorted(closed)]
    revisits = found = 0
    for i, here in enumerate(positions):
        before = positions[way[i] - way > LOOP_WAY_M]
        if not len(before) or np.linalg.norm(before - here, axis=1).min() > NEAR_M:
            continue
        revisits += 1
        found += any(abs(each - way[i]) <= FOUND_WAY_M for each in at)
    return revisits, found


def _town(setting: BenchSetting, seed: int, poor: bool) -> Outcome:
    name = f"{'worse' if poor else 'town'}-{seed}"
    seen = _drive(setting, name, "--world", "town", "--seed", seed, *(POOR if poor else ()))
    held = (
        seen.ratio <= (MOST_LEFT if poor else MOST_WORSE)
        and seen.found >= LEAST_FOUND * seen.revisits > 0
        and seen.false == 0
        and seen.cpu_ms <= MOST_CPU_MS
    )
    return Outcome(seen.words(), asdict(seen), held)


def _aliased(setting: BenchSetting, world: str) -> Outcome:
    drives = [
        _drive(
            setting,
            f"{world}-{seed}",
            *("--world", WORLDS / f"{world}.yaml", "--seed", seed, "--laps", 2),
        )
        for seed in ALIASED_SEEDS
    ]
    false, loops = sum(d.false for d in drives), sum(d.loops for d in drives)
    found, revisits = sum(d.found for d in drives), sum(d.revisits for d in drives)
    # Unlike max(), it keeps NaN, wherever that stands.
    worst = float(np.max([d.ratio for d in drives]))
    figure = (
        f"{false} of {loops} loops false, {found} of {revisits} revisits, ATE at most {worst:.3f} ×"
    )
    held = false == 0 and found >= LEAST_FOUND * revisits > 0 and worst <= MOST_WORSE
    return Outcome(figure, {"drives": [asdict(d) for d in drives]}, held)


def _points(setting: BenchSetting, world: str, seed: int) -> NDArray[np.float32]:
    """x, y, z of all submaps' points; the fourth column is positive for points that moved."""
    out = setting.out / "graph" / f"{world}-{seed}"
    points = out / "points.bin"
    _graph(setting, out, ("--world", world, "--seed", seed), "--points", points)
    read = np.fromfile(points, np.float32).reshape(-1, 4)
    points.unlink()
    return read


def _moving(setting: BenchSetting, seed: int) -> Outcome:
    with_traffic, without = (_points(setting, world, seed) for world in ("moving", "city"))
    off, _ = KDTree(without[:, :3]).query(with_traffic[:, :3], workers=2)
    moved = with_traffic[:, 3] > 0
    found, kept = float(moved[off > FREE_M].mean()), float((~moved)[off < STANDS_M].mean())
    taken = float((without[:, 3] > 0).mean())
    figure = f"{found:.3f} of what moved found, {kept:.4f} of what stands kept"
    figures = {"found": found, "kept": kept, "taken_without_traffic": taken}
    return Outcome(figure, figures, found >= LEAST_MOVED and kept >= LEAST_KEPT)


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    both = f"{LEAST_FOUND:.0%} of revisits, no false loop, {MOST_CPU_MS:.0f} ms a submap"
    rows = []
    for poor, most in ((False, MOST_WORSE), (True, MOST_LEFT)):
        for seed in SEEDS:
            name = f"graph-{'worse' if poor else 'town'}-{seed}"
            what = "3.2 km of town" + (", a poor sensor" if poor else "") + f", seed {seed}: loops"
            measure = functools.partial(_town, setting, seed, poor)
            rows.append(Benchmark(name, what, measure, f"ATE ≤ {most} ×, {both}"))
    for seed in SEEDS:
        what = f"streets full of traffic, seed {seed}: what moved in the submaps"
        limit = f"{LEAST_MOVED:.0%} found, {LEAST_KEPT:.0%} of what stands kept"
        rows.append(
            Benchmark(f"moving-{seed}", what, functools.partial(_moving, setting, seed), limit)
        )
    for world in ("equal_corridors", "equal_houses"):
        what = f"{world}.yaml, {len(ALIASED_SEEDS)} seeds: loops"
        measure = functools.partial(_aliased, setting, world)
        limit = f"no false loop, {LEAST_FOUND:.0%} of revisits, ATE ≤ {MOST_WORSE} ×"
        rows.append(Benchmark(f"graph-aliased-{world}", what, measure, limit))
    return rows
