"""Each sweep without a pose is counted once, at the stage that it did not come out of."""

from __future__ import annotations

from dataclasses import replace

import pytest

from zloam_monitor.accounting import Accounts, account
from zloam_monitor.keys import Keys
from zloam_monitor.records import Input, StatusRecord

KEYS = Keys("robot", "lidar")
SWEEPS = 131


def status(
    stage: str, out: int, lost: int = 0, queued: int = 0, silent: int = 0, **dropped: int
) -> StatusRecord:
    """Status of a stage that has processed all sweeps except the queued ones. silent: number of
    sweeps for which it published nothing and counted no drop."""
    name = KEYS.main_input(stage)
    done = out + silent
    received = done + queued + sum(dropped.values())
    inputs = (Input(name, received, done, 0, queued, 0, dropped, lost, 0),) if name else ()
    return StatusRecord(
        stage=stage,
        instance="a",
        health="ready",
        reason="",
        stamp_ns=1,
        run=1,
        last_sweep=SWEEPS - 1,
        end_of_run=True,
        inputs=inputs,
        published={KEYS.main_output(stage): out},
        latencies={},
        figures={},
        cpu_ms=0.0,
        rss_mib={},
    )


def books(*found: StatusRecord, poses: int) -> Accounts:
    return account({s.stage: s for s in found}, KEYS, poses)


def test_a_sweep_that_is_given_up_twice_is_counted_once() -> None:
    found = books(
        status("driver", SWEEPS),
        # 50 sweeps were dropped; empty messages with the reason stand for them.
        status("registration", SWEEPS, queue_full=50),
        # 48 messages were given up as lost; 7 of them arrived after that, too late.
        status("odometry", 83, lost=48, late=7),
        status("mapping", 60, queue_full=23),
        status("integration", 83),
        poses=83,
    )
    assert found.given_up == {"odometry.lost": 48}
    assert found.sweeps_accounted


def test_a_sweep_that_registration_gave_up_is_counted_there() -> None:
    """Odometry receives the empty message of each given-up sweep, or drops that, too."""
    found = books(
        status("driver", 121),
        status("registration", 121, queue_full=23),
        status("odometry", 94, silent=16, queue_full=11),
        status("mapping", 94),
        status("integration", 94),
        poses=94,
    )
    assert found.given_up == {"odometry.queue_full": 11, "registration.queue_full": 16}


def test_drops_of_sweeps_that_have_poses_are_no_loss() -> None:
    found = books(
        status("driver", SWEEPS),
        status("registration", SWEEPS),
        status("odometry", SWEEPS, queue_full=40),
        status("mapping", SWEEPS),
        status("integration", SWEEPS),
        poses=SWEEPS,
    )
    assert found.given_up == {}
    assert found.sweeps_accounted


def test_what_has_no_reason_is_not_accounted_for() -> None:
    found = books(
        status("driver", SWEEPS),
        status("registration", SWEEPS),
        status("odometry", 100, lost=10, silent=21),
        status("mapping", 100),
        status("integration", 99, silent=1),
        poses=99,
    )
    assert found.given_up == {"odometry.lost": 10}
    assert not found.sweeps_accounted
    assert "131 sweeps, but 99 poses and 10 given up" in found.complaints()


def test_what_was_on_its_way_at_the_end_is_named() -> None:
    """A sweep is unfinished if it is still queued, and lost if no later sweep revealed its loss."""
    found = books(
        status("driver", SWEEPS),
        status("registration", SWEEPS - 4),
        status("odometry", SWEEPS - 7, queued=3),
        status("mapping", SWEEPS - 7),
        status("integration", SWEEPS - 7),
        poses=SWEEPS - 7,
    )
    assert found.given_up == {"odometry.unfinished": 3, "registration.lost": 4}
    assert found.sweeps_accounted


def test_poses_that_the_listener_missed_are_poses() -> None:
    stages = ("driver", "registration", "odometry", "mapping", "integration")
    found = books(*(status(stage, SWEEPS) for stage in stages), poses=SWEEPS - 11)
    assert (found.poses, found.given_up) == (SWEEPS, {})
    assert found.sweeps_accounted


def test_a_driver_that_began_again_is_accounted_over_all_runs() -> None:
    """In 200 sweeps of the runs before, odometry lost 3 that are in its count still."""
    whole = SWEEPS + 200
    later = ("odometry", "mapping", "integration")
    found = books(
        status("driver", SWEEPS),
        status("registration", whole),
        *(status(stage, whole - 3, lost=3 * (stage == "odometry")) for stage in later),
        poses=SWEEPS,
    )
    assert found.several_runs
    assert (found.sweeps, found.poses, found.given_up) == (whole, whole - 3, {"odometry.lost": 3})
    assert found.complaints() == []


def test_losses_of_earlier_runs_excuse_none_of_the_last() -> None:
    """60 were lost in the runs before; in the last one, 60 more have no reason."""
    whole = SWEEPS + 200
    found = books(
        status("driver", SWEEPS),
        status("registration", whole),
        status("odometry", whole - 120, lost=60, silent=60),
        status("mapping", whole - 120),
        status("integration", whole - 120),
        poses=SWEEPS - 60,
    )
    assert found.given_up == {"odometry.lost": 60}
    assert not found.sweeps_accounted


def test_an_old_status_of_the_driver_is_no_second_run() -> None:
    """It was killed 8 sweeps after its last status; its reader saw the others, of the same run."""
    whole = SWEEPS + 8
    others = ("registration", "odometry", "mapping", "integration")
    found = books(
        status("driver", SWEEPS),
        *(replace(status(stage, whole), last_sweep=whole - 1) for stage in others),
        poses=whole,
    )
    assert not found.several_runs
    assert "131 sweeps, but 139 poses and 0 given up" in found.complaints()


@pytest.mark.parametrize("out", [20, 200])
def test_a_stage_that_counts_from_a_later_start_is_judged_by_its_drops(out: int) -> None:
    found = books(
        status("driver", SWEEPS),
        status("registration", out),
        status("odometry", SWEEPS - 5, lost=5),
        status("mapping", SWEEPS - 5),
        status("integration", SWEEPS - 5),
        poses=SWEEPS - 5,
    )
    assert found.given_up == {"odometry.lost": 5}
    assert found.sweeps_accounted
