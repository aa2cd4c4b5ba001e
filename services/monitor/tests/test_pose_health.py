"""The health of a run's poses is counted."""

from __future__ import annotations

import numpy as np

from zloam_monitor import pose_health
from zloam_monitor.records import HEALTH, PoseRecord


def pose(
    sweep: int,
    health: str = "ok",
    sigmas_m: tuple[float, float, float] = (0.01, 0.01, 0.01),
    weak: tuple[float, float, float] = (0.0, 0.0, 0.0),
    jump: bool = False,
) -> PoseRecord:
    covariance = np.diag([*np.square(sigmas_m), 1e-6, 1e-6, 1e-6])
    return PoseRecord(
        run=1,
        sweep=sweep,
        instant_ns=100_000_000 * sweep,
        translation=np.zeros(3),
        quaternion=np.array([0.0, 0.0, 0.0, 1.0]),
        health=HEALTH.index(health),
        last_packet_ns=0,
        end_of_run=False,
        trace=(),
        degenerate=any(weak),
        jump=jump,
        weak_translation=weak,
        covariance=tuple(covariance.ravel()),
    )


def test_each_health_is_counted_and_the_least_sure_pose_named() -> None:
    poses = [
        pose(0),
        pose(1, "degenerate", (0.3, 0.01, 0.01), (0.99, 0.1, 0.0)),
        pose(2, "degenerate", (0.01, 0.2, 0.01), (-1.0, 0.0, 0.0)),
        pose(3, "predicted"),
        pose(4, "bridging", jump=True),
        pose(5),
    ]
    found = pose_health.judge(reversed(poses))
    assert found.counts == {"ok": 2, "bridging": 1, "degenerate": 2, "predicted": 1}
    assert (found.jumps, found.weak_axis, found.least_sure_sweep) == (1, "x", 1)
    assert found.least_sure_m is not None
    assert abs(found.least_sure_m - 0.3) < 1e-12
    assert pose_health.line(found.as_dict()) == (
        "2 of 6 poses ok, 2 degenerate (mostly along x of base_link), 1 predicted, 0 lost, "
        "1 bridging, 1 jump, largest sigma of a position 0.300 m (of sweep 1, along its least "
        "certain direction)"
    )


def test_no_axis_is_named_where_no_pose_is_degenerate() -> None:
    """A lost pose may also be flagged, but is counted as lost only."""
    lost = pose(1, "lost", weak=(0.0, 1.0, 0.0))
    text = pose_health.line(pose_health.judge([pose(0), lost]).as_dict())
    assert "0 degenerate, 0 predicted, 1 lost" in text


def test_the_sigma_is_that_of_the_worst_direction_not_of_an_axis() -> None:
    turned = pose(7)
    along = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 0.04 * np.outer(along, along)
    found = pose_health.judge(
        [PoseRecord(**{**vars(turned), "covariance": tuple(covariance.ravel())})]
    )
    assert found.least_sure_m is not None
    assert abs(found.least_sure_m - 0.2) < 1e-12


def test_nothing_heard_says_so_and_does_not_fail() -> None:
    text = pose_health.line(pose_health.judge([]).as_dict())
    assert text == "0 of 0 poses ok, 0 degenerate, 0 predicted, 0 lost, 0 jumps"
