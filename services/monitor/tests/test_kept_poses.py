"""Packed poses are those that came, and small."""

from __future__ import annotations

import tracemalloc
from dataclasses import astuple, replace

import numpy as np
import pytest

from zloam_monitor import kept_poses, latency, pose_health
from zloam_monitor.kept_poses import KeptPoses
from zloam_monitor.records import PoseRecord, TraceStep

STAGES = ("driver", "registration", "odometry", "integration")
FIRST_NS = 1_700_000_000_000_000_000


def pose(sweep: int) -> PoseRecord:
    """One with a value of its own in each field; covariances are exact in 32 bits."""
    at_ns = FIRST_NS + sweep * 10**8
    steps = range(at_ns, at_ns + 4000, 1000)
    return PoseRecord(
        run=2**63 + 5,
        sweep=sweep,
        instant_ns=at_ns,
        translation=np.array([0.1 * sweep, -1.0 / 3.0, 7.0]),
        quaternion=np.array([0.0, 0.6, 0.0, 0.8]),
        health=sweep % 10,
        last_packet_ns=at_ns - 7,
        end_of_run=sweep % 2 == 0,
        trace=tuple(TraceStep(s, t, t + 1, t + sweep) for s, t in zip(STAGES, steps, strict=True)),
        degenerate=sweep % 3 == 0,
        jump=sweep % 5 == 0,
        weak_translation=(0.1, 0.2 * (sweep % 3), 0.0),
        covariance=tuple(float(sweep % 7 + i) / 64.0 for i in range(36 * (sweep % 4 > 0))),
        config_rev=sweep % 4,
        map_id=2**63 + sweep // 20,
    )


@pytest.fixture
def packing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_poses, "WHOLE", 5)


def assert_same(found: PoseRecord, wanted: PoseRecord) -> None:
    for a, b in zip(astuple(found), astuple(wanted), strict=True):
        assert np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b


@pytest.mark.usefixtures("packing")
def test_a_packed_pose_is_the_one_that_came() -> None:
    """Poses that come late, or twice, too."""
    order = [0, 2, 1, *range(10, 30), 5, *range(30, 60), 31, 5]
    kept = KeptPoses()
    added = [kept.add(pose(sweep)) for sweep in order]
    assert added == [True] * (len(order) - 2) + [False] * 2
    assert sorted(kept) == sorted(set(order))
    assert len(kept) == len(set(order))
    for sweep in order:
        assert sweep in kept
        assert_same(kept[sweep], pose(sweep))
    assert 6 not in kept
    with pytest.raises(KeyError):
        kept[6]
    last = kept.last()
    assert last is not None
    assert last.sweep == 59
    kept.clear()
    assert (len(kept), list(kept), kept.last()) == (0, [], None)


@pytest.mark.usefixtures("packing")
def test_figures_of_packed_poses_are_those_of_whole_ones() -> None:
    whole = {sweep: pose(sweep) for sweep in range(200)}
    kept = KeptPoses()
    for each in whole.values():
        kept.add(each)
    assert latency.by_stage(kept.values(), []) == latency.by_stage(whole.values(), [])
    assert latency.from_last_packet(kept.values(), "integration") == latency.from_last_packet(
        whole.values(), "integration"
    )
    assert pose_health.judge(kept.values()) == pose_health.judge(whole.values())


def test_only_the_newest_are_kept_if_so_chosen() -> None:
    kept = KeptPoses(3)
    for sweep in (10**9, *range(10)):
        kept.add(pose(sweep))
    assert sorted(kept) == [7, 8, 9]
    last = kept.last()
    assert last is not None
    assert last.sweep == 9


@pytest.mark.usefixtures("packing")
def test_what_is_not_needed_of_old_ones_is_left_out() -> None:
    kept = KeptPoses(needed=lambda each: replace(each, covariance=(), trace=()))
    for sweep in range(10):
        kept.add(pose(sweep))
    assert (kept[1].covariance, kept[1].trace) == ((), ())
    assert kept[9].covariance == pose(9).covariance
    assert np.array_equal(kept[1].translation, pose(1).translation)


@pytest.mark.usefixtures("packing")
def test_a_long_run_takes_little_memory() -> None:
    """Whole, a pose takes 3 kB: at 10 Hz and for three kinds, 8.6 GB in a day."""
    kept = KeptPoses()
    tracemalloc.start()
    for sweep in range(5000):
        kept.add(pose(sweep))
    taken, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert taken / len(kept) < 500.0
