#!/usr/bin/env python3
"""evaluate.py TRUTH.tum ESTIMATE.tum [--mount x y z roll pitch yaw] : errors of a trajectory.

TRUTH is a dense trajectory (any rate above the estimate's) that is interpolated at each estimated
pose's own stamp. Prints
  ape     root mean square of the position error after SE(3) alignment without scale (evo)
  drift   KITTI's: mean relative translation error over sub-lengths, % ; rotation in deg/m
  rpe     root mean square of the error of the motion over ten poses, m and degrees
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp


def read_tum(path: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = np.loadtxt(path, ndmin=2)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(rows[:, 4:8]).as_matrix()
    poses[:, :3, 3] = rows[:, 1:4]
    return rows[:, 0], poses


def interpolated(
    times: NDArray[np.float64], poses: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    out = np.tile(np.eye(4), (len(at), 1, 1))
    out[:, :3, :3] = Slerp(times, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    for axis in range(3):
        out[:, axis, 3] = np.interp(at, times, poses[:, axis, 3])
    return out


def inverse(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3] = np.transpose(poses[:, :3, :3], (0, 2, 1))
    out[:, :3, 3] = -np.einsum("nij,nj->ni", out[:, :3, :3], poses[:, :3, 3])
    return out


def angles(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    trace = np.trace(rotations, axis1=1, axis2=2)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def sub_lengths(path_length: float) -> list[int]:
    if path_length > 800:
        return [100 * k for k in range(1, 9)]
    if path_length > 250:
        return [50, 100, 200, 300, 400]
    return [5, 10, 20, 40, 60, 80] if path_length > 60 else [1, 2, 5, 10]


def drift(truth: NDArray[np.float64], estimate: NDArray[np.float64]) -> tuple[float, float]:
    steps = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    along = np.r_[0.0, np.cumsum(steps)]
    errors = []
    for i in range(0, len(truth), 10):
        for length in sub_lengths(along[-1]):
            j = int(np.searchsorted(along, along[i] + length))
            if j >= len(truth):
                continue
            inv = np.linalg.inv
            motion_error = inv(inv(estimate[i]) @ estimate[j]) @ (inv(truth[i]) @ truth[j])
            shift = np.linalg.norm(motion_error[:3, 3]) / length * 100.0
            turn = np.degrees(angles(motion_error[None, :3, :3])[0]) / length
            errors.append((shift, turn))
    return np.mean(errors, axis=0) if errors else (np.nan, np.nan)


def relative(
    truth: NDArray[np.float64], estimate: NDArray[np.float64], poses: int = 10
) -> tuple[float, float]:
    n = min(poses, len(truth) - 2)
    error = inverse(inverse(truth[:-n]) @ truth[n:]) @ (inverse(estimate[:-n]) @ estimate[n:])
    shift = np.sqrt((error[:, :3, 3] ** 2).sum(1).mean())
    return shift, np.degrees(np.sqrt((angles(error[:, :3, :3]) ** 2).mean()))


def evo_trajectory(times: NDArray[np.float64], poses: NDArray[np.float64]) -> Any:
    quaternion = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return PoseTrajectory3D(poses[:, :3, 3], quaternion, times)


def evaluate(
    truth_file: str, estimate_file: str, base_from_lidar: NDArray[np.float64] | None = None
) -> dict[str, float]:
    truth_times, truth_poses = read_tum(truth_file)
    times, estimate = read_tum(estimate_file)
    inside = (times >= truth_times[0]) & (times <= truth_times[-1] + 1e-6)
    times, estimate = np.minimum(times[inside], truth_times[-1]), estimate[inside]
    truth = interpolated(truth_times, truth_poses, times)
    if base_from_lidar is not None:
        # The truth is the sensor's: move it to base_link.
        truth = truth @ np.linalg.inv(base_from_lidar)
    reference, aligned = evo_trajectory(times, truth), evo_trajectory(times, estimate)
    aligned.align(reference, correct_scale=False)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    shift_pct, turn = drift(truth, estimate)
    rpe_m, rpe_deg = relative(truth, estimate)
    return {
        "poses": len(times),
        "ape_rmse_m": float(ape.get_statistic(metrics.StatisticsType.rmse)),
        "ape_max_m": float(ape.get_statistic(metrics.StatisticsType.max)),
        "drift_pct": float(shift_pct),
        "drift_deg_per_m": float(turn),
        "rpe10_m": float(rpe_m),
        "rpe10_deg": float(rpe_deg),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("truth")
    parser.add_argument("estimate", nargs="+")
    parser.add_argument("--mount", nargs=6, type=float, help="T_base_lidar: m, degrees")
    arguments = parser.parse_args()
    mount = None
    if arguments.mount:
        mount = np.eye(4)
        mount[:3, 3] = arguments.mount[:3]
        mount[:3, :3] = Rotation.from_euler("xyz", arguments.mount[3:], degrees=True).as_matrix()
    for file in arguments.estimate:
        result = evaluate(arguments.truth, file, mount)
        rounded = {k: round(v, 5) if isinstance(v, float) else v for k, v in result.items()}
        print(file, json.dumps(rounded))


if __name__ == "__main__":
    main()
