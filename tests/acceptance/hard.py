"""Checks with rates, swings and surroundings for which the algorithms were not built (the table of
issue 36). Each drive runs in one process (tests/bench/search); the worst seed counts."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import Setting
from tests.bench.search import judge, runner, sets
from tests.bench.search.judge import Verdict
from tests.bench.search.sets import Places
from zloam_monitor import evaluation, trajectory

#: sweeps within which a diverging odometry must be flagged
FLAGGED_WITHIN = 10


@dataclass(frozen=True)
class Ran:
    """One drive and its results."""

    verdict: Verdict
    folder: Path
    truth: Path


Judge = Callable[[Ran, float], tuple[float, bool, str]]


@functools.cache
def ran(build: Path, out: Path, shared: Path, name: str) -> Ran:
    drive = next(d for d in sets.all_sets() if d.name == name)
    places, folder = Places(build, shared), out / "accept" / "hard"
    row = runner.run(drive, places, build / "bin" / "zloam-offline", folder)
    if row.verdict is None:
        if row.failure.startswith("skipped"):
            raise Skip(row.failure)
        raise RuntimeError(row.failure)
    return Ran(row.verdict, folder / runner.folder_of(name), drive.make(places).truth)


def _fused(ran: Ran, limit_m: float) -> tuple[float, bool, str]:
    return ran.verdict.fused_m, ran.verdict.fused_m <= limit_m, ""


def _fused_or_lost(ran: Ran, limit_m: float) -> tuple[float, bool, str]:
    """The fused error is within the limit, or health is Lost from the first pose on that exceeds
    it."""
    said = judge.said_of(ran.folder, trajectory.read(ran.truth))
    poses = np.arange(len(said.health))
    wrong = np.flatnonzero(judge.relative_error_m(said, np.zeros_like(poses), poses) > limit_m)
    lost = len(wrong) > 0 and bool((said.health[wrong[0] :] == judge.LOST).all())
    return ran.verdict.fused_m, ran.verdict.fused_m <= limit_m or lost, " lost" if lost else ""


def _odometry_or_flagged(ran: Ran, limit_m: float) -> tuple[float, bool, str]:
    """The odometry's error is within the limit, or it is flagged soon after it exceeds the
    limit: by its health, or because integration reports that odometry and map have come apart."""
    truth, path = trajectory.read(ran.truth), trajectory.read(ran.folder / "odom.tum")
    of_truth, of_path, _ = evaluation.associate(path, truth)
    health = np.genfromtxt(ran.folder / "sweeps.csv", delimiter=",", names=True)["health"]
    zeros = np.zeros(len(of_truth))
    said = judge.Said(of_truth, of_path, zeros.astype(np.int64), zeros > 0, zeros)
    poses = np.arange(len(of_truth))
    wrong = np.flatnonzero(judge.relative_error_m(said, np.zeros_like(poses), poses) > limit_m)
    # Sweeps without a pose in the truth are at the end, so rows up to there correspond.
    after = health[wrong[0] : wrong[0] + FLAGGED_WITHIN] if len(wrong) else np.empty(0)
    # An incomplete or dropped sweep says nothing of the motion, and NaN nothing at all.
    flagged = bool(np.isin(after, judge.FLAGS).any()) or (len(wrong) > 0 and _apart(ran, wrong[0]))
    held = ran.verdict.odometry_m <= limit_m or flagged
    return ran.verdict.odometry_m, held, " flagged" if flagged else ""


def _apart(ran: Ran, wrong: int) -> bool:
    """Whether integration reports it for one of the sweeps from the first wrong one on."""
    fused = np.genfromtxt(ran.folder / "fused.csv", delimiter=",", names=True)
    soon = (fused["sweep"] >= wrong) & (fused["sweep"] < wrong + FLAGGED_WITHIN)
    return bool((fused["odometry_drifts"][soon] > 0).any())


def _measured(setting: Setting, names: tuple[str, ...], limit_m: float, judged: Judge) -> Measured:
    found = {
        name: judged(ran(setting.build, setting.out, setting.shared, name), limit_m)
        for name in names
    }
    figures = ", ".join(f"{name} {m:.4f} m{said}" for name, (m, _, said) in found.items())
    return Measured(figures, all(held for _, held, _ in found.values()))


def _seeds(stem: str, *seeds: int) -> tuple[str, ...]:
    return tuple(f"{stem}-{seed}" for seed in seeds)


#: name, drives, text, limit in m, function that judges
LINES: tuple[tuple[str, tuple[str, ...], str, float, Judge], ...] = (
    ("hand-5hz", _seeds("hand5hz", 911), "in the hand at 5 Hz: fused", 0.05, _fused),
    ("fastrot-2nd", _seeds("fastrot/2", 307), "fastrot, every 2nd scan: fused", 0.02, _fused),
    ("swung", _seeds("swung", *range(1, 6)), "head swung 70° at 1 Hz: fused", 0.03, _fused),
    ("legged", _seeds("legged", *range(1, 6)), "legged trot: fused", 0.045, _fused),
    ("city-5th", _seeds("city/5", 307), "city, every 5th: fused, or Lost", 0.5, _fused_or_lost),
    ("indoor-3rd", _seeds("indoor/3", 307), "indoor, every 3rd scan: fused", 0.10, _fused),
    ("ouster-hand", ("ouster-hand",), "real walk at 2 Hz: fused, or Lost", 1.0, _fused_or_lost),
    ("tunnel-imu", _seeds("tunnel-imu", *range(1, 11)), "tunnel with IMU: fused", 0.24, _fused),
    (
        "company",
        ("crowd-indoor-1", "crowd-flat-1", "box-indoor-1", "box-flat-1"),
        f"a crowd along, own box of 120°: odometry, or flagged within {FLAGGED_WITHIN} sweeps",
        0.2,
        _odometry_or_flagged,
    ),
)


def checks(setting: Setting) -> list[Check]:
    """All checks, in the order of the issue."""
    return [
        Check(
            f"hard-{name}",
            text,
            f"≤ {limit_m} m",
            f"make accept ONLY=hard-{name}",
            functools.partial(_measured, setting, drives, limit_m, judged),
        )
        for name, drives, text, limit_m, judged in LINES
    ]
