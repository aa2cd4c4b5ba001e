"""Checks on simulated worlds beyond position errors: comparison with KISS-ICP, heights, steps, and
the benefit of an IMU."""

from __future__ import annotations

import functools
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import Setting, check_matched, is_newer
from zloam_monitor import evaluation, se3, trajectory
from zloam_monitor.evaluation import Compared
from zloam_monitor.trajectory import Trajectory

Array = NDArray[np.float64]
Measure = Callable[[Setting, str, int], Measured]
Runs = tuple[tuple[str, int], ...]  # world, seed

SEEDS = (1, 2, 3)
GRID = "services/simulator/worlds/grid.yaml"
#: A tunnel as smooth, but entered from, and left to, places with structure.
TUNNEL_ENTRY = "tests/acceptance/worlds/tunnel_entry.yaml"
KISS_WORLDS = (
    "city",
    "indoor",
    "handheld",
    "tunnel",
    "tunnel_weak",
    "flat",
    "field",
    "park",
    "moving",
    GRID,
)
#: Traffic in which most of what constrains the motion along the street are two vans that keep their
#: distance: those of twenty seeds with which the pose once followed the vans.
ESCORTED: Runs = tuple(("moving", seed) for seed in (4, 5, 7, 9, 15))
#: Nothing in the tunnel faces along it, and the drive begins at rest inside: no lidar can notice
#: that it sets off. An IMU can, so these checks use one; the figures without it are shown too.
WITH_IMU = ("tunnel",)
#: worlds in which the IMU must make no result worse, and improve what the lidar alone misses
IMU_WORLDS = ("city", "indoor", "handheld", "tunnel_weak", "flat", "field", "park", "moving")
#: worlds with enough rotation and acceleration for a delay of the IMU to show
LATE_WORLDS = ("city", "indoor", "handheld")
LATE_MS, LATE_GROWTH = 20.0, 1.2
FLAT_Z_SHARE = 0.002
STEP_M = 0.2


def checks(setting: Setting) -> list[Check]:
    """All checks, in the order of the issue."""
    lines: list[tuple[str, Runs, str, str, Measure]] = [
        (
            "kiss",
            _each(*KISS_WORLDS) + ESCORTED,
            "ATE beside KISS-ICP's, same sweeps",
            "not above",
            _beside_kiss,
        ),
        (
            "flat-z",
            _each("flat"),
            "height beside the truth's",
            f"≤ {FLAT_Z_SHARE:.1%} of path",
            _height,
        ),
        (
            "step",
            _each("tunnel", TUNNEL_ENTRY) + ESCORTED,
            "worst step between poses beside the truth's",
            f"≤ {STEP_M} m",
            _worst_step,
        ),
        (
            "imu",
            _each(*IMU_WORLDS),
            "ATE with the inertial sensor beside that without",
            "not above",
            _beside_itself,
        ),
        (
            "imu-late",
            _each(*LATE_WORLDS),
            f"ATE with an inertial sensor's stamps {LATE_MS:g} ms late beside that with right ones",
            f"≤ {LATE_GROWTH} ×",
            _late_beside_right,
        ),
    ]
    return [
        _check(setting, kind, world, seed, text, limit, measure)
        for kind, runs, text, limit, measure in lines
        for world, seed in runs
    ]


def _each(*worlds: str) -> Runs:
    return tuple((world, seed) for world in worlds for seed in SEEDS)


def _check(
    s: Setting, kind: str, world: str, seed: int, text: str, limit: str, measure: Measure
) -> Check:
    name = f"{kind}-{Path(world).stem}-{seed}"
    added = ", with the inertial sensor" if world in WITH_IMU else ""
    return Check(
        name,
        f"simulated {Path(world).stem}, seed {seed}: {text}{added}",
        limit,
        f"make accept ONLY={name}",
        functools.partial(measure, s, world, seed),
    )


def _truth(s: Setting, world: str, seed: int) -> Trajectory:
    """The simulator's truth is the lidar's, which these worlds mount at base_link."""
    return trajectory.read(s.simulated(world, seed)[1])


def _ate_m(s: Setting, world: str, seed: int, *, imu: bool, late_ms: float = 0.0) -> float:
    demo = s.world(world, seed, imu=imu, late_ms=late_ms)
    poses = trajectory.read(demo.results / "trajectory.tum")
    return _whole_ate_m(poses, _truth(s, world, seed), world)


def _whole_ate_m(poses: Trajectory, truth: Trajectory, world: str) -> float:
    scores = evaluation.evaluate(poses, truth)
    check_matched(scores.matched, scores.poses, world)
    if scores.ate_rmse_m is None:
        raise RuntimeError("too few poses")
    return scores.ate_rmse_m


def _beside_itself(s: Setting, world: str, seed: int) -> Measured:
    better, without = (_ate_m(s, world, seed, imu=imu) for imu in (True, False))
    return Measured(f"{better:.4f} m, without {without:.4f} m", better <= without)


def _late_beside_right(s: Setting, world: str, seed: int) -> Measured:
    late, right = (_ate_m(s, world, seed, imu=True, late_ms=by) for by in (LATE_MS, 0.0))
    return Measured(f"{late:.4f} m, {right:.4f} m", late <= LATE_GROWTH * right)


def _compared(s: Setting, world: str, seed: int, *, imu: bool = False) -> Compared:
    poses = trajectory.read(s.world(world, seed, imu=imu).results / "trajectory.tum")
    compared = evaluation.compare(poses, _truth(s, world, seed))
    if compared is None:
        raise RuntimeError("too few poses")
    check_matched(len(compared.truth), len(poses), world)
    return compared


def _kiss_trajectory(s: Setting, world: str, seed: int) -> Trajectory:
    """KISS-ICP's trajectory on the sweeps that the driver makes of the world's packets; stored
    beside them."""
    capture, _ = s.simulated(world, seed)
    found = capture.with_suffix(".kiss.tum")
    if not is_newer(found, capture):
        decoded = capture.with_suffix(".points")
        decoder = s.build / "bin" / "zloam-decode"
        try:
            subprocess.run(
                [str(decoder), "--pcap", str(capture), "--out", str(decoded)],
                check=True,
                capture_output=True,
            )
            s.kiss(decoded, "--trajectory", found)
        finally:
            decoded.unlink(missing_ok=True)
    return trajectory.read(found)


def _beside_kiss(s: Setting, world: str, seed: int) -> Measured:
    truth = _truth(s, world, seed)
    with_imu = world in WITH_IMU
    ours = _ate_m(s, world, seed, imu=with_imu)
    kiss = _whole_ate_m(_kiss_trajectory(s, world, seed), truth, world)
    without = f" (without: {_ate_m(s, world, seed, imu=False):.4f} m)" if with_imu else ""
    return Measured(f"{ours:.4f} m{without}, KISS-ICP {kiss:.4f} m", ours <= kiss)


def _height(s: Setting, world: str, seed: int) -> Measured:
    """Compares the heights, both in the frame of their first pose, in which the platform is
    level."""
    found = _compared(s, world, seed)
    estimate = (se3.inverse(found.estimate[:1]) @ found.estimate)[:, 2, 3]
    truth = (se3.inverse(found.truth[:1]) @ found.truth)[:, 2, 3]
    path_m = float(trajectory.path_m(found.truth)[-1])
    worst = float(np.abs(estimate - truth).max())
    return Measured(
        f"{worst:.3f} m of {path_m:.0f} m: {worst / path_m:.3%} of the path",
        worst <= FLAT_Z_SHARE * path_m,
    )


def _worst_step(s: Setting, world: str, seed: int) -> Measured:
    with_imu = world in WITH_IMU
    off_m, true_m = _step_off(_compared(s, world, seed, imu=with_imu))
    without = f" (without: {_step_off(_compared(s, world, seed))[0]:.3f} m)" if with_imu else ""
    return Measured(
        f"{off_m:.3f} m{without} (the truth's longest step: {true_m:.2f} m)", off_m <= STEP_M
    )


def _step_off(found: Compared) -> tuple[float, float]:
    """The largest error of a step, and the truth's longest step, m."""
    ours = se3.inverse(found.estimate[:-1]) @ found.estimate[1:]
    true = se3.inverse(found.truth[:-1]) @ found.truth[1:]
    off = np.linalg.norm(ours[:, :3, 3] - true[:, :3, 3], axis=1)
    return float(off.max()), float(np.linalg.norm(true[:, :3, 3], axis=1).max())
