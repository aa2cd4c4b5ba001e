"""Figures of the report come from stamps that ascend; those that do not are said."""

from __future__ import annotations

import numpy as np
import pytest

from zloam_monitor import report
from zloam_monitor.keys import Keys
from zloam_monitor.records import PoseRecord
from zloam_monitor.report import Run
from zloam_monitor.trajectory import from_records

STEP_NS = 100_000_000


def run_with(instants_ns: list[int]) -> Run:
    """A robot that goes 1 m a sweep; where its stamps go back it is drawn 1000 m away."""
    latest = -1
    poses = {}
    for sweep, instant in enumerate(instants_ns):
        x = float(sweep) if instant > latest else 1000.0
        latest = max(latest, instant)
        poses[sweep] = PoseRecord(
            run=1,
            sweep=sweep,
            instant_ns=instant,
            translation=np.array([x, 0.0, 0.0]),
            quaternion=np.array([0.0, 0.0, 0.0, 1.0]),
            health=0,
            last_packet_ns=0,
            end_of_run=False,
            trace=(),
        )
    heard = from_records({n: (p.instant_ns, p.translation, p.quaternion) for n, p in poses.items()})
    return Run(Keys("robot", "lidar"), {}, poses, {}, heard, heard, wall_s=1.0)


def test_ascending_stamps_are_no_complaint() -> None:
    found = report.build(run_with([STEP_NS * i for i in range(11)]))
    assert found["path_m"] == pytest.approx(10.0)
    assert found["realtime_factor"] == pytest.approx(1.1)
    assert found["stamps_went_back"] == []


def test_stamps_that_go_back_are_said_and_left_out() -> None:
    instants = [STEP_NS * i for i in range(11)]
    instants[5] = instants[4]
    instants[7] = -30 * STEP_NS
    found = report.build(run_with(instants))
    assert found["stamps_went_back"] == [5, 7]
    assert found["path_m"] == pytest.approx(10.0)
    assert "2 stamps are not after those before, first of sweep 5" in str(found["identities"])
    assert not report.accounted(found)
