"""Messages that wait for a reader, and what of them never came."""

from __future__ import annotations

import threading
import time
from typing import Literal

import pytest

from fake_session import FakeSession, needs_schemas
from zloam_monitor import compose
from zloam_monitor.gaps import WINDOW
from zloam_monitor.intake import MIB, Intake

SECOND_NS = 10**9
#: Limit of the time of a test that fails.
PATIENCE_S = 60.0


@pytest.fixture(autouse=True)
def built() -> None:
    needs_schemas()


@pytest.fixture
def session() -> FakeSession:
    return FakeSession()


def opened(
    session: FakeSession, most_bytes: int = MIB, leave_out: Literal["oldest", "newest"] = "oldest"
) -> Intake:
    return Intake(session, [session.keys.below("**")], most_bytes, leave_out)


def publish(
    session: FakeSession,
    *numbers: int,
    key: str = "pose",
    instance: str = "one",
    run: int = 1,
    term: int = 1,
) -> None:
    for n in numbers:
        header = compose.HeaderValues(run, n, n, instance=instance, term=term)
        message = compose.pose("MapPose", header, n, (0, 0, 0), (0, 0, 0, 1))
        session.publish(session.keys.below(key), message)


def test_a_reader_slower_than_the_robot_gets_to_its_other_work(session: FakeSession) -> None:
    intake = opened(session)
    publish(session, 0, 1, 2)
    read = []
    for sample in intake.taken():
        read.append(sample)
        assert len(read) <= 3, "it never returns"
        publish(session, 2 + len(read))
    assert len(list(intake.taken())) == 3


def test_what_is_left_out_meanwhile_ends_it_too(session: FakeSession) -> None:
    intake = opened(session, most_bytes=400)
    session.publish("loam/robot/a", bytes(200))
    session.publish("loam/robot/a", bytes(200))
    taken = intake.taken()
    next(taken)
    session.publish("loam/robot/b", bytes(400))
    assert [len(sample.payload) for sample in taken] == [400]
    assert intake.dropped == {"loam/robot/a": 1}


def a_message(seq: int, replay: bool) -> bytes:
    header = compose.HeaderValues(1, seq, seq, replay=replay)
    return compose.pose("MapPose", header, seq, (0, 0, 0), (0, 0, 0, 1))


@pytest.mark.parametrize(("replay", "read"), [(True, 50), (False, 2)])
def test_a_replay_waits_for_room(session: FakeSession, replay: bool, read: int) -> None:
    messages = [a_message(seq, replay) for seq in range(1, 51)]
    intake = opened(session, most_bytes=2 * len(messages[0]), leave_out="newest")

    def publish_all() -> None:
        for each in messages:
            intake.add("pose", each)

    publisher = threading.Thread(target=publish_all)
    publisher.start()
    if not replay:
        publisher.join()
    taken = [intake.take(PATIENCE_S).payload for _ in range(read)]
    publisher.join()
    assert taken == messages[:read]
    assert sum(intake.dropped.values()) == 50 - read


def test_what_waits_for_room_at_the_end_is_taken(session: FakeSession) -> None:
    messages = [a_message(seq, replay=True) for seq in (1, 2)]
    intake = opened(session, most_bytes=len(messages[0]), leave_out="newest")
    intake.add("pose", messages[0])
    publisher = threading.Thread(target=intake.add, args=("pose", messages[1]))
    publisher.start()
    while not intake._outside:
        time.sleep(0.01)
    assert not intake.has_all(0.0)
    intake.close()
    # At once: its thread need not have run since.
    assert [sample.payload for sample in intake.taken()] == messages
    assert intake.has_all(0.0)
    assert not intake.has_all(PATIENCE_S)
    publisher.join()


@pytest.mark.parametrize(
    ("numbers", "lost"),
    [
        ((7, 8, 9), 0),
        ((0, 1, 5), 3),
        ((0, 1, 5, 5, 1), 3),
        ((0, 3, 1, 2), 0),
        ((5, 3, 4, 8), 2),
        ((0, 10 * WINDOW), 10 * WINDOW - 1),
        ((0, 10 * WINDOW, 10 * WINDOW - 1), 10 * WINDOW - 2),
        # A publisher of the same name starts again, and that counts by itself.
        ((5000, 5002, 0, 1, 3), 2),
    ],
)
def test_numbers_that_never_came_are_counted(
    session: FakeSession, numbers: tuple[int, ...], lost: int
) -> None:
    intake = opened(session)
    publish(session, *numbers)
    assert intake.lost() == ({"loam/robot/pose": lost} if lost else {})


def test_each_publisher_counts_for_itself(session: FakeSession) -> None:
    intake = opened(session)
    publish(session, 0, 1, instance="one")
    publish(session, 0, 1, 3, instance="another")
    publish(session, 0, 2, key="map/odometry")
    assert intake.lost() == {"loam/robot/pose": 1, "loam/robot/map/odometry": 1}


def test_a_process_that_takes_over_again_counts_from_0(session: FakeSession) -> None:
    """Also within the window in which a lower number counts as overtaken."""
    intake = opened(session)
    publish(session, 0, 1, 2, 3)
    publish(session, 0, 2, term=3)
    assert intake.lost() == {"loam/robot/pose": 1}


def test_all_tiles_are_numbered_together(session: FakeSession) -> None:
    intake = opened(session)
    for n, index in ((0, 5), (1, 6), (4, 5)):
        key = f"map/tile/plane/{index}/0/0"
        publish(session, n, key=key)
    assert intake.lost() == {"loam/robot/map/tile": 2}


def test_messages_without_a_number_are_not_counted(session: FakeSession) -> None:
    intake = opened(session)
    session.publish("loam/robot/a", b"short")
    session.publish("loam/robot/a", b"....ZLMPdamaged")
    session.publish("loam/robot/a", compose.status("mapping", 1, 1, None, [], {}))
    assert not intake.lost()
    assert len(list(intake.taken())) == 3


@pytest.mark.parametrize("step_s", [-60, 365 * 86400])
def test_a_step_of_the_clock_is_none_in_the_times(
    session: FakeSession, monkeypatch: pytest.MonkeyPatch, step_s: int
) -> None:
    intake = opened(session)
    before = time.monotonic_ns()
    publish(session, 0)
    stepped_ns = time.time_ns() + step_s * SECOND_NS
    monkeypatch.setattr("zloam_monitor.intake.time.time_ns", lambda: stepped_ns)
    publish(session, 1)
    first, second = (sample.received_ns for sample in intake.taken())
    assert 0 <= second - first <= time.monotonic_ns() - before


@pytest.mark.parametrize(
    ("in_second_run", "lost"),
    [
        ((0, 1, 3), 1),  # A program with a fixed name that was started again.
        ((1, 0, 2), 0),
        ((6, 7, 8), 1),  # A stage that goes on.
        ((5, 6, 4, 7), 0),
    ],
)
def test_numbers_go_on_in_another_run_or_begin_again(
    session: FakeSession, in_second_run: tuple[int, ...], lost: int
) -> None:
    intake = opened(session)
    publish(session, 0, 1, 2, 3, 4)
    publish(session, *in_second_run, run=2)
    assert intake.lost() == ({"loam/robot/pose": lost} if lost else {})


@pytest.mark.parametrize(
    ("runs_and_numbers", "lost"),
    [
        # Of another run, or of none, one message alone comes, late.
        (((1, 1), (0, 0), (1, 2), (1, 3)), 0),
        (((1, 2), (0, 0), (1, 3), (1, 4)), 0),
        (((2, 10), (1, 8), (2, 11), (2, 12)), 0),
        (((2, 10), (1, 8), (2, 11), (2, 14)), 2),
        (((2, 10), (1, 8), (3, 12)), 1),
        # The publisher was started again, and the last message from before comes late.
        (((1, 3), (1, 4), (2, 0), (1, 5), (2, 1)), 0),
        # Before its first run it sets none.
        (((0, 0), (0, 1), (1, 2), (0, 3), (1, 5)), 1),
        (((0, 0), (0, 3), (0, 1), (1, 4)), 1),
    ],
)
def test_an_overtaken_message_of_another_run_is_no_new_beginning(
    session: FakeSession, runs_and_numbers: tuple[tuple[int, int], ...], lost: int
) -> None:
    intake = opened(session)
    for run, number in runs_and_numbers:
        publish(session, number, run=run)
    assert intake.lost() == ({"loam/robot/pose": lost} if lost else {})
