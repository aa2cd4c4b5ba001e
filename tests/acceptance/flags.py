"""Checks of degeneracy flags: they are set where a direction is unconstrained, and nowhere else."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import Setting, check_matched, said_of_poses
from tests.acceptance.worlds import STEP_M
from zloam_monitor import se3, trajectory
from zloam_monitor.records import HEALTH

Array = NDArray[np.float64]
#: setting, world, seed, with the IMU
Measure = Callable[[Setting, str, int, bool], Measured]

SEEDS = (1, 2, 3)
#: least share of flagged sweeps in a tunnel without any surface across it, and largest angle
#: between the degenerate direction and its axis
TUNNEL_SHARE, AXIS_DEG = 0.95, 10.0
#: largest share of flagged sweeps in worlds that constrain all directions
CLEAR_SHARE = 0.01
CLEAR_WORLDS = ("city", "indoor")
#: a field with a farm at one end, where the robot can be found again; beyond this x no wall is in
#: sight
FIELD, OPEN_FROM_X_M = "tests/acceptance/worlds/farm_and_field.yaml", 115.0
#: least share of flagged sweeps in the open field
OPEN_SHARE = 0.95
#: back at the farm: number of the last whole sweeps that are checked, and the limit of the error of
#: their steps, as in the tunnel
END_POSES, END_STEP_M = 50, STEP_M
SEEN = ("ok", "incomplete")


def checks(setting: Setting) -> list[Check]:
    # An IMU does not make a direction constrained that the points leave open, and vice versa.
    lines: list[tuple[str, bool, str, str, Measure]] = [
        *(
            (
                "tunnel",
                imu,
                "flagged, with the weak axis along the tunnel",
                f"≥ {TUNNEL_SHARE:.0%} of the sweeps, within {AXIS_DEG:.0f}°",
                _along_the_tunnel,
            )
            for imu in (False, True)
        ),
        *(
            (world, imu, "flagged", f"≤ {CLEAR_SHARE:.0%} of the sweeps", _flagged)
            for imu in (False, True)
            for world in CLEAR_WORLDS
        ),
        (
            FIELD,
            False,
            "predicted or flagged in the open; found again",
            f"≥ {OPEN_SHARE:.0%} of the sweeps; the last {END_POSES} unflagged, "
            f"steps within {END_STEP_M} m",
            _field,
        ),
    ]
    return [
        _check(setting, world, seed, imu, text, limit, measure)
        for world, imu, text, limit, measure in lines
        for seed in SEEDS
    ]


def _check(
    s: Setting, world: str, seed: int, imu: bool, text: str, limit: str, measure: Measure
) -> Check:
    name = f"flags-{Path(world).stem}-{seed}" + ("-imu" if imu else "")
    added = ", with the inertial sensor" if imu else ""
    return Check(
        name,
        f"simulated {Path(world).stem}, seed {seed}: {text}{added}",
        limit,
        f"make accept ONLY={name}",
        functools.partial(measure, s, world, seed, imu),
    )


def _truth_at_poses(s: Setting, world: str, seed: int, imu: bool) -> tuple[NDArray[Any], Array]:
    """Rows of poses.csv, and the truth at their instants as (N, 4, 4)."""
    said = said_of_poses(s.world(world, seed, imu=imu))
    truth, inside = trajectory.interpolate(
        trajectory.read(s.simulated(world, seed)[1]), said["instant_ns"].astype(np.int64)
    )
    check_matched(int(inside.sum()), len(said), world)
    return said[inside], truth.transforms


def _along_the_tunnel(s: Setting, world: str, seed: int, imu: bool) -> Measured:
    said, truth = _truth_at_poses(s, world, seed, imu)
    axis = truth[-1, :3, 3] - truth[0, :3, 3]
    axis_base = np.einsum("nji,j->ni", truth[:, :3, :3], axis / np.linalg.norm(axis))
    weak = np.stack([said["weak_x"], said["weak_y"], said["weak_z"]], axis=1)
    flagged = (said["degenerate"] > 0) & (np.linalg.norm(weak, axis=1) > 0)
    cosine = np.clip(np.abs((weak * axis_base).sum(axis=1)), 0.0, 1.0)
    near = flagged & (np.degrees(np.arccos(cosine)) <= AXIS_DEG)
    return Measured(
        f"{flagged.mean():.1%} flagged, {near.mean():.1%} within {AXIS_DEG:.0f}° of {len(said)}",
        bool(near.mean() >= TUNNEL_SHARE),
    )


def _flagged(s: Setting, world: str, seed: int, imu: bool) -> Measured:
    said = said_of_poses(s.world(world, seed, imu=imu))
    share = float((said["degenerate"] != 0).mean())  # NaN is not clear
    return Measured(f"{share:.2%} of {len(said)}", share <= CLEAR_SHARE)


def _field(s: Setting, world: str, seed: int, imu: bool) -> Measured:
    """Poses in the open are flagged; those back at the farm are not, and their steps are right."""
    said, truth = _truth_at_poses(s, world, seed, imu)
    names = np.array(HEALTH)[said["health"].astype(int)]
    told = (said["degenerate"] > 0) | ~np.isin(names, SEEN)
    outside = told[truth[:, 0, 3] > OPEN_FROM_X_M]
    # The last sweep is partial, as the capture ends within a revolution.
    last = slice(-END_POSES - 1, -1)
    poses = trajectory.read(s.world(world, seed, imu=imu).results / "trajectory.tum").transforms[
        last
    ]
    true = truth[last]
    ours = se3.inverse(poses[:-1]) @ poses[1:]
    steps = se3.inverse(true[:-1]) @ true[1:]
    off_m = float(np.linalg.norm(ours[:, :3, 3] - steps[:, :3, 3], axis=1).max())
    return Measured(
        f"{outside.mean():.0%} of {len(outside)} told of in the open, "
        f"{told[last].mean():.0%} of the last {END_POSES}, "
        f"whose steps are off by {off_m:.3f} m at most",
        bool(outside.mean() >= OPEN_SHARE and not told[last].any() and off_m <= END_STEP_M),
    )
