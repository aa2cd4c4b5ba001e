"""Checks of LOAM's own sensor, a 2-D scanner on a motor (issue 44): drives, calibrations, real
sessions."""

from __future__ import annotations

import functools
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from tests.acceptance.flags import SEEN
from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import Demo, Setting, check_matched, said_of_poses
from tests.hokuyo import simulated
from tests.hokuyo.simulated import Session
from zloam_monitor import evaluation, se3, trajectory
from zloam_monitor.records import HEALTH
from zloam_monitor.sources import HOKUYO_SPEED_FACTOR

SEEDS = (1, 2, 3)
#: least length of the path and least rate of poses, without which the errors would mean little
LEAST_WAY_M, POSES_PER_S = 50.0, 10.0
INDOOR_IMU_M, INDOOR_M, OUTDOOR_DRIFT_PERCENT = 0.05, 0.15, 0.8
#: world -> (factor on the world's largest speed, which keeps below 0.5 m/s; length of the drive)
SLOW: dict[str, tuple[float, str]] = {
    "indoor": (HOKUYO_SPEED_FACTOR, "full"),
    "city": (0.05, "260"),
}
ANGLE_DEG, OFFSET_MS = 0.05, 1.0
#: A stretch of this many poses (10 s) is wrong if its error exceeds one of these limits.
STRETCH_POSES, WRONG_M, WRONG_DEG = 100, 1.0, 10.0
CALIBRATED_IN = ("indoor", "handheld")


def _stem(setting: Setting, name: str) -> Path:
    for program in ("zloam-simulator", "zloam-calibrate"):
        if not (setting.build / "bin" / program).exists():
            raise Skip(f"{program} is not built")
    folder = setting.out / "accept" / "scanner"
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


def _drive(setting: Setting, world: str, seed: int, with_imu: bool) -> tuple[Demo, Session]:
    speed_factor, duration = SLOW[world]
    motion = ["--speed-factor", speed_factor, "--duration", duration]
    where = ["--world", world, "--seed", seed]
    stem = _stem(setting, f"{world}-{seed}")
    session = simulated.session(setting.build, stem, *where, *motion)
    readings = ["--imu", session.imu] if with_imu else []
    name = f"scanner-{world}-{seed}" + ("-imu" if with_imu else "")
    return setting.demo(name, "--session", session.log, *readings), session


def _scores(demo: Demo, session: Session) -> tuple[evaluation.Scores, float]:
    """The errors, and the number of poses per second of the whole session."""
    found = trajectory.read(demo.results / "trajectory.tum")
    truth = trajectory.read(session.truth)
    # Not from the first to the last pose: poses that are missing at the end count.
    rate = 1e9 * len(found) / float(truth.stamps_ns[-1] - truth.stamps_ns[0])
    scores = evaluation.evaluate(found, truth)
    check_matched(scores.matched, scores.poses, session.truth.name)
    return scores, rate


def _drives(
    setting: Setting,
    world: str,
    with_imu: bool,
    figure: Callable[[evaluation.Scores], float],
    limit: float,
    unit: str,
) -> Measured:
    texts, held = [], True
    for seed in SEEDS:
        scores, rate = _scores(*_drive(setting, world, seed, with_imu))
        if scores.path_m is None or scores.path_m < LEAST_WAY_M:
            raise RuntimeError(f"seed {seed}: a way of {scores.path_m} m")
        held = held and figure(scores) <= limit and rate >= 0.99 * POSES_PER_S
        texts.append(f"{figure(scores):.3f} {unit}")
    return Measured(f"{', '.join(texts)}; way {scores.path_m:.0f} m", held)


def _ate_m(scores: evaluation.Scores) -> float:
    return np.inf if scores.ate_rmse_m is None else scores.ate_rmse_m


def _drift_percent(scores: evaluation.Scores) -> float:
    return np.inf if scores.drift_percent is None else scores.drift_percent


def _silent(setting: Setting, world: str) -> Measured:
    """Number of wrong stretches in which no pose is flagged."""
    wrong = silent = 0
    for seed in SEEDS:
        demo, session = _drive(setting, world, seed, with_imu=False)
        found = trajectory.read(demo.results / "trajectory.tum")
        at, inside = trajectory.interpolate(trajectory.read(session.truth), found.stamps_ns)
        check_matched(int(inside.sum()), len(found), session.truth.name)
        truth, estimate = at.transforms, found.transforms[inside]
        first, last = np.arange(len(truth))[:-STRETCH_POSES], np.arange(len(truth))[STRETCH_POSES:]
        true_way = se3.inverse(truth[first]) @ truth[last]
        off = se3.inverse(true_way) @ se3.inverse(estimate[first]) @ estimate[last]
        far_m = np.linalg.norm(off[:, :3, 3], axis=1)
        is_wrong = (far_m > WRONG_M) | (se3.rotation_angle_rad(off) > np.radians(WRONG_DEG))
        names = np.array(HEALTH)[said_of_poses(demo)["health"].astype(int)[inside]]
        flags = np.concatenate([[0], np.cumsum(~np.isin(names, SEEN))])
        wrong += int(is_wrong.sum())
        silent += int((is_wrong & (flags[last + 1] == flags[first])).sum())
    return Measured(f"{silent} of {wrong} wrong stretches", silent == 0)


def _calibrated(setting: Setting, world: str) -> Measured:
    calibrate = setting.build / "bin" / "zloam-calibrate"
    worst_deg = worst_ms = 0.0
    for seed in SEEDS:
        stem = _stem(setting, f"still-{world}-{seed}")
        session = simulated.at_rest(setting.build, stem, world, seed)
        done = subprocess.run(
            [str(calibrate), str(session.log)], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            return Measured(f"seed {seed}: {done.stderr.strip()}", held=False)
        found = yaml.safe_load(done.stdout)
        off_deg = np.subtract(found["scanner"]["rpy_deg"][1:], simulated.MOUNT_DEG)
        off_ms = found["motor"]["delay_ms"] - simulated.DELAY_MS
        if not np.isfinite([*off_deg, off_ms]).all():  # max() would pass over NaN.
            return Measured(f"seed {seed}: {off_deg}°, {off_ms} ms", held=False)
        worst_deg = max(worst_deg, float(np.abs(off_deg).max()))
        worst_ms = max(worst_ms, abs(off_ms))
    return Measured(
        f"worst {worst_deg:.3f}°, {worst_ms:.3f} ms",
        worst_deg <= ANGLE_DEG and worst_ms <= OFFSET_MS,
    )


def checks(setting: Setting) -> list[Check]:
    drives = (
        ("indoor-imu", "indoor, with IMU", "indoor", True, _ate_m, INDOOR_IMU_M, "m"),
        ("indoor", "indoor, without IMU", "indoor", False, _ate_m, INDOOR_M, "m"),
        (
            "outdoor",
            "a block outdoors, without IMU: drift",
            "city",
            False,
            _drift_percent,
            OUTDOOR_DRIFT_PERCENT,
            "%",
        ),
    )
    return [
        *(
            Check(
                f"hokuyo-{name}",
                f"scanner on a motor, ≤ 0.5 m/s, seeds 1 to 3, ten poses a second: {text}",
                f"≤ {limit} {unit}",
                f"make accept ONLY=hokuyo-{name}",
                functools.partial(_drives, setting, world, with_imu, figure, limit, unit),
            )
            for name, text, world, with_imu, figure, limit, unit in drives
        ),
        Check(
            "hokuyo-outdoor-said",
            "scanner on a motor, a block outdoors, without IMU, seeds 1 to 3: stretches of 10 s "
            f"wrong by {WRONG_M:.0f} m or {WRONG_DEG:.0f}° in which every pose is Ok",
            "0",
            "make accept ONLY=hokuyo-outdoor-said",
            functools.partial(_silent, setting, "city"),
        ),
        *(
            Check(
                f"hokuyo-mount-{world}",
                f"scanner on a motor: calibrated from a minute at rest, {world}, seeds 1 to 3",
                f"≤ {ANGLE_DEG}°, ≤ {OFFSET_MS} ms",
                f"make accept ONLY=hokuyo-mount-{world}",
                functools.partial(_calibrated, setting, world),
            )
            for world in CALIBRATED_IN
        ),
    ]
