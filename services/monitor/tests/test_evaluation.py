"""Compares scores with closed forms, and with evo."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core import trajectory as evo_trajectory
from scipy.spatial.transform import Rotation

from zloam_monitor import evaluation, se3
from zloam_monitor.trajectory import Trajectory, interpolate

START_NS = 1_600_000_000_000_000_000


def loop(n: int = 2001, radius_m: float = 50.0, turns: float = 1.0) -> Trajectory:
    """A circle with small changes of height, heading along the path; about 314 m per turn."""
    angle = np.linspace(0, 2 * np.pi * turns, n)
    positions = np.c_[radius_m * np.cos(angle), radius_m * np.sin(angle), 0.5 * np.sin(3 * angle)]
    quats = Rotation.from_rotvec(np.outer(angle + np.pi / 2, [0, 0, 1])).as_quat()
    stamps = START_NS + (np.arange(n) * 20_000_000).astype(np.int64)
    return Trajectory(se3.matrices(positions, quats), stamps, np.arange(n))


def straight(n: int, step_m: float) -> Trajectory:
    positions = np.c_[np.arange(n) * step_m, np.zeros(n), np.zeros(n)]
    quats = np.tile([0.0, 0, 0, 1], (n, 1))
    stamps = START_NS + (np.arange(n) * 100_000_000).astype(np.int64)
    return Trajectory(se3.matrices(positions, quats), stamps, np.arange(n))


def test_another_origin_is_no_error() -> None:
    truth = loop()
    moved = se3.from_xyz_rpy_deg([30, -7, 2], [3, -5, 120])
    estimate = Trajectory(moved @ truth.transforms, truth.stamps_ns, truth.sweeps)
    scores = evaluation.evaluate(estimate, truth)
    assert scores.ate_rmse_m == pytest.approx(0, abs=1e-6)
    assert scores.drift_percent == pytest.approx(0, abs=1e-6)
    assert scores.rpe_1m_m == pytest.approx(0, abs=1e-6)


def test_scale_is_not_forgiven() -> None:
    truth = straight(1001, 0.3)
    stretched = truth.transforms.copy()
    stretched[:, :3, 3] *= 1.01
    scores = evaluation.evaluate(Trajectory(stretched, truth.stamps_ns, truth.sweeps), truth)
    # A scale error of 1 % on a line of length L leaves, once centred, an rms of 0.01 L / sqrt(12).
    assert scores.ate_rmse_m == pytest.approx(0.01 * 300.3 / np.sqrt(12), rel=0.01)
    assert scores.drift_percent == pytest.approx(1.0, rel=0.01)
    # A step of at least 1 m has four poses with 0.3 m between them.
    assert scores.rpe_1m_m == pytest.approx(0.012, rel=1e-6)


def test_heading_drift_in_closed_form() -> None:
    truth = straight(401, 0.5)  # 200 m, for which the sub-lengths are 5 to 80 m.
    rate = np.radians(0.02)  # Per m.
    along = np.arange(401) * 0.5
    quats = Rotation.from_rotvec(np.outer(rate * along, [0, 0, 1])).as_quat()
    positions = np.c_[np.sin(rate * along) / rate, (1 - np.cos(rate * along)) / rate, 0 * along]
    estimate = Trajectory(se3.matrices(positions, quats), truth.stamps_ns, truth.sweeps)
    scores = evaluation.evaluate(estimate, truth)
    assert scores.drift_deg_per_m == pytest.approx(0.02, rel=1e-6)
    # Distance between the ends of arc and straight line, averaged over all starts as by KITTI.
    expected = []
    for start in range(0, 401, 10):
        for length in (5, 10, 20, 40, 60, 80):
            if start * 0.5 + length <= 200:
                a = rate * length
                gap = np.hypot(np.sin(a) / rate - length, (1 - np.cos(a)) / rate)
                expected.append(gap / length * 100)
    assert scores.drift_percent == pytest.approx(np.mean(expected), rel=1e-6)


def test_white_noise_shows_in_full() -> None:
    truth = loop(20_001)
    noise = np.random.default_rng(3).normal(0, 0.1, (len(truth), 3))
    noisy = truth.transforms.copy()
    noisy[:, :3, 3] += noise
    scores = evaluation.evaluate(Trajectory(noisy, truth.stamps_ns, truth.sweeps), truth)
    assert scores.ate_rmse_m == pytest.approx(0.1 * np.sqrt(3), rel=0.02)


def test_truth_is_taken_at_the_instant_of_the_pose() -> None:
    truth = loop(2001)
    between, _ = interpolate(truth, truth.stamps_ns[:-1] + 9_000_000)
    scores = evaluation.evaluate(between, truth)
    assert scores.ate_rmse_m < 1e-6
    # Stamps that are 1 s late still give a figure.
    late = Trajectory(between.transforms, between.stamps_ns + 1_000_000_000, between.sweeps)
    assert evaluation.evaluate(late, truth).drift_percent is not None


def test_a_constant_time_error_is_seen() -> None:
    truth = straight(500, 0.1)
    wobble = truth.transforms.copy()
    wobble[:, 1, 3] = np.sin(np.arange(500) / 10)
    truth = Trajectory(wobble, truth.stamps_ns, truth.sweeps)
    late = Trajectory(wobble[:-2], truth.stamps_ns[2:], truth.sweeps[:-2])
    assert evaluation.evaluate(late, truth).ate_rmse_m > 0.1


def test_truth_of_the_sensor_is_carried_to_base_link() -> None:
    T_base_lidar = se3.from_xyz_rpy_deg([0.4, 0.1, 1.2], [2, -8, 90])
    base = loop()
    sensor = base.carried(T_base_lidar)
    carried = sensor.carried(se3.inverse(T_base_lidar))
    assert evaluation.evaluate(base, carried).ate_rmse_m == pytest.approx(0, abs=1e-9)
    # Without carrying, the lever arm and the rotation of the mounting are visible.
    assert evaluation.evaluate(base, sensor).rpe_1m_m > 1e-3


def test_kitti_truth_is_joined_by_sweep_number_at_the_middle_of_each_sweep() -> None:
    fine = loop(2002, turns=0.2)
    ends, middles = np.arange(1, 2002, 2), np.arange(0, 2002, 2)
    number = np.arange(1001)
    by_number = Trajectory(fine.transforms[middles], None, number)
    missing = np.r_[0:500, 510:1001]
    estimate = Trajectory(
        fine.transforms[ends][missing], fine.stamps_ns[ends][missing], number[missing]
    )
    scores = evaluation.evaluate(estimate, by_number)
    # The first pose and the one after the gap lack the pose at the beginning of their sweep.
    assert scores.matched == 989
    assert scores.remark == "no truth for 1 of 991 poses, which do not count"
    # Interpolation uses chords of 6 cm on a circle of 50 m.
    assert scores.ate_rmse_m == pytest.approx(0, abs=1e-4)
    assert scores.rpe_1m_m == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize(
    ("path_m", "lengths"),
    [(801, [100, 800]), (800, [50, 400]), (250, [5, 80]), (61, [5, 80]), (60, [1, 10])],
)
def test_sub_length_rule(path_m: float, lengths: list[int]) -> None:
    found = evaluation.sub_lengths_m(path_m)
    assert [found[0], found[-1]] == lengths


def test_too_few_poses_give_no_figure() -> None:
    truth = loop(10)
    few = Trajectory(truth.transforms[:2], truth.stamps_ns[:2], truth.sweeps[:2])
    assert evaluation.evaluate(few, truth).ate_rmse_m is None


def test_standing_still_is_an_answer() -> None:
    still = straight(50, 0.0)
    assert evaluation.evaluate(still, still).ate_rmse_m == pytest.approx(0, abs=1e-9)


def as_evo(t: Trajectory) -> Any:
    return evo_trajectory.PoseTrajectory3D(
        poses_se3=list(t.transforms), timestamps=t.times_s(START_NS)
    )


def drifting(truth: Trajectory) -> Trajectory:
    """Every fifth pose, with a random walk added to position and heading."""
    rng = np.random.default_rng(5)
    off = np.cumsum(rng.normal(0, 0.002, (len(truth), 6)), axis=0)
    bent = truth.transforms.copy()
    bent[:, :3, :3] = bent[:, :3, :3] @ Rotation.from_rotvec(off[:, 3:] / 10).as_matrix()
    bent[:, :3, 3] += off[:, :3]
    return Trajectory(bent[::5], truth.stamps_ns[::5], truth.sweeps[::5])


def test_errors_equal_those_of_evo_by_its_own_association() -> None:
    truth = loop(2001)
    estimate = drifting(truth)
    scores = evaluation.evaluate(estimate, truth)
    reference, path = sync.associate_trajectories(as_evo(truth), as_evo(estimate), max_diff=0.001)
    rpe = metrics.RPE(
        metrics.PoseRelation.translation_part, 1.0, metrics.Unit.meters, pairs_from_reference=True
    )
    rpe.process_data((reference, path))
    path.align(reference, correct_scale=False)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, path))
    for ours, evos in (
        (scores.ate_rmse_m, ape.get_statistic(metrics.StatisticsType.rmse)),
        (scores.ate_max_m, ape.get_statistic(metrics.StatisticsType.max)),
        (scores.rpe_1m_m, rpe.get_statistic(metrics.StatisticsType.rmse)),
    ):
        assert ours == pytest.approx(evos, rel=1e-9)


def test_steps_of_the_relative_error_are_those_of_evo_on_a_regular_grid() -> None:
    # With exactly 0.1 m per step, rounding decides whether ten steps make a metre.
    truth = straight(1001, 0.1)
    estimate = drifting(truth)
    reference, path = sync.associate_trajectories(as_evo(truth), as_evo(estimate), max_diff=0.001)
    rpe = metrics.RPE(
        metrics.PoseRelation.translation_part, 1.0, metrics.Unit.meters, pairs_from_reference=True
    )
    rpe.process_data((reference, path))
    assert evaluation.evaluate(estimate, truth).rpe_1m_m == pytest.approx(
        rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-9
    )


def test_a_hole_in_the_reference_is_not_bridged() -> None:
    truth = loop()
    keep = np.r_[0:400, 1400:2001]
    assert truth.stamps_ns is not None
    holed = Trajectory(truth.transforms[keep], truth.stamps_ns[keep], np.arange(len(keep)))
    scores = evaluation.evaluate(truth, holed)
    assert scores.matched == len(keep)
    assert scores.ate_rmse_m == pytest.approx(0, abs=1e-6)
    assert scores.remark == "no truth for 1000 of 2001 poses, which do not count"


def test_a_reference_of_another_time_or_of_one_pose_says_so() -> None:
    truth = loop()
    assert truth.stamps_ns is not None
    late = Trajectory(truth.transforms, truth.stamps_ns + 3600 * 10**9, truth.sweeps)
    one = Trajectory(truth.transforms[:1], truth.stamps_ns[:1], truth.sweeps[:1])
    for reference in (late, one):
        scores = evaluation.evaluate(truth, reference)
        assert scores.ate_rmse_m is None
        assert str(scores.remark).startswith("fewer than 3 poses have a truth: poses 2001 from")
