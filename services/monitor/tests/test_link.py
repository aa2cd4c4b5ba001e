"""A link asks until all living stages have answered, and counts what can not be read."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from fake_session import FakeSession, linked, needs_schemas, one_misses_a_query
from zloam_monitor import cli, compose, discovery, link
from zloam_monitor.compose import HeaderValues
from zloam_monitor.link import Link
from zloam_monitor.messages import MAP_POINT

GARBAGE = b"\x10\x00\x00\x00" + b"ZLxx" + bytes(40)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    needs_schemas()
    monkeypatch.setattr(link, "BUSY_SECONDS", 0.3)


@pytest.fixture
def session() -> FakeSession:
    return one_misses_a_query()


def test_a_stage_that_misses_a_query_is_asked_again(session: FakeSession) -> None:
    asking = linked(session)
    assert asking.query_configs() == {"odometry": {"a.b": 1}, "mapping": {"c.d": 2}}
    assert asking.unanswered == set()


@pytest.fixture
def get(session: FakeSession, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """The command `get` for this robot."""

    @contextlib.contextmanager
    def one(*_: object) -> Iterator[Link]:
        yield linked(session)

    monkeypatch.setattr(discovery, "linked", one)
    return lambda *words: cli.main(["get", *words])


def test_a_living_stage_that_does_not_answer_is_named(
    session: FakeSession, get: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert get() == 0
    assert capsys.readouterr() == ("mapping c.d=2\nodometry a.b=1\n", "")
    session.rounds[session.config_key("mapping")] = [[]]
    assert get() == 1
    said = capsys.readouterr()
    assert said.out == "odometry a.b=1\n"
    assert "mapping is alive, but did not answer" in said.err
    assert get("odometry") == 0
    # A key of the missing stage may exist.
    assert get("--json", "odometry", "c.d") == 1
    capsys.readouterr()
    assert cli.main(["get", "odometry", "x"]) == 1
    assert "no key x" in capsys.readouterr().err


NAN = float("nan")


@pytest.mark.parametrize(
    ("position", "quaternion"),
    [
        ((NAN, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)),
        ((1e8, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)),
        ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 0.0)),
        ((1.0, 2.0, 3.0), (0.0, 0.0, NAN, 1.0)),
    ],
)
def test_what_can_be_no_pose_is_counted_as_unreadable(
    session: FakeSession, position: tuple[float, ...], quaternion: tuple[float, ...]
) -> None:
    """The stages refuse it, too. One NaN in it would be one in all errors of the run, and makes an
    answer of `zloam web` that no browser can read."""
    hearing = Link(session, session.keys)
    for n, at, turned in ((0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)), (1, position, quaternion)):
        header = HeaderValues(1, n, n)
        session.publish(session.keys.pose, compose.pose("MapPose", header, n, at, turned))
    hearing.poll()
    assert (list(hearing.poses), hearing.garbage) == ([0], 1)


def test_a_covariance_with_nan_is_unknown(session: FakeSession) -> None:
    """Else the chart of the report has no scale, and Rerun draws no pose."""
    hearing = Link(session, session.keys)
    for n, cell in enumerate((0.25, NAN)):
        whole = np.eye(6)
        whole[1, 1] = cell
        upright = (0.0, 0.0, 0.0, 1.0)
        pose = compose.pose(
            "MapPose", HeaderValues(1, n, n), n, (0, 0, 0), upright, 0, whole.ravel()
        )
        session.publish(session.keys.pose, pose)
    hearing.poll()
    assert [len(each.covariance) for each in hearing.poses.values()] == [36, 0]


@pytest.mark.parametrize("mib", [NAN, math.inf, -1.0])
def test_a_memory_that_is_none_is_counted_as_unreadable(session: FakeSession, mib: float) -> None:
    hearing = Link(session, session.keys)
    status = compose.status("mapping", 1, 1, 1, [], {}, rss_mib=mib)
    session.publish(session.keys.below("service/mapping/mapping-1/status"), status)
    hearing.poll()
    assert (hearing.statuses, hearing.garbage) == ({}, 1)


def test_a_tile_with_a_point_that_is_none_is_left_out(session: FakeSession) -> None:
    points = np.zeros(5, MAP_POINT)
    points["z"][3] = NAN
    tile = compose.tile(HeaderValues(1, 0, 0), "plane", (0, 0, 0), points)
    session.rounds = {session.keys.below("map/tile/plane/0/0/0"): [[tile]]}
    asking = linked(session)
    assert (asking.query_tiles(["plane"]), asking.garbage) == ([], 1)


HOUR_NS = 3600 * 10**9


def a_status(stamp_ns: int, instance: str = "mapping-1") -> bytes:
    return compose.status("mapping", stamp_ns, 1, 1, [], {"pose": 1}, instance=instance)


def test_a_robot_whose_clock_is_set_back_is_not_silent(session: FakeSession) -> None:
    """Nor late, and a router's answer from before does not take the place of what is published."""
    hearing = Link(session, session.keys)
    status_key = session.keys.below("service/mapping/mapping-1/status")
    session.rounds[status_key] = [[a_status(HOUR_NS)]]
    for stamp_ns in (HOUR_NS, 10**9, 2 * 10**9):
        session.publish(status_key, a_status(stamp_ns))
        hearing.poll()
        hearing.heard["mapping", "mapping-1"] -= 100.0
        hearing.query_statuses()
    kept = hearing.stage("mapping")
    assert kept is not None
    assert kept.stamp_ns == 2 * 10**9
    session.publish(status_key, a_status(3 * 10**9))
    hearing.poll()
    assert hearing.silent_s(hearing.newest_statuses()["mapping"], time.monotonic()) < 50.0
    assert hearing.late.seconds({("mapping", "mapping-1")}) < 1.0


def test_a_stage_started_after_its_clock_was_set_back_is_the_newest(session: FakeSession) -> None:
    hearing = Link(session, session.keys)
    session.publish(session.keys.below("service/mapping/old/status"), a_status(HOUR_NS, "old"))
    session.publish(session.keys.below("service/mapping/new/status"), a_status(10**9, "new"))
    hearing.poll()
    assert hearing.newest_statuses()["mapping"].instance == "new"


def test_tiles_of_two_maps_are_not_mixed(session: FakeSession) -> None:
    """A new map begins with version 1; the store still answers with the one before, too."""
    points = np.zeros(5, MAP_POINT)
    old, new = (HeaderValues(1, 0, 0, map_id=number) for number in (7, 8))
    session.rounds[session.keys.below("map/tile/plane/0/0/0")] = [
        [
            compose.tile(new, "plane", (0, 0, 0), points, version=1),
            compose.tile(old, "plane", (0, 0, 0), points, version=40),
        ]
    ]
    found = linked(session).query_tiles(["plane"])
    assert [(tile.map_id, tile.version) for tile in found] == [(7, 40), (8, 1)]


def test_instances_that_ended_long_ago_are_forgotten(session: FakeSession) -> None:
    """Each start of a stage has a name of its own. The newest one of each stage stays."""
    hearing = Link(session, session.keys)
    session.publish(session.keys.below("service/driver/driver-1/status"), a_status(1, "driver-1"))
    for number in range(50):
        name = f"mapping-{number}"
        session.publish(session.keys.below(f"service/mapping/{name}/status"), a_status(1, name))
        hearing.poll()
        if number == 20:
            hearing.heard = {who: at - 1000.0 for who, at in hearing.heard.items()}
    assert len(hearing.statuses) == 29
    assert hearing.newest_statuses()["mapping"].instance == "mapping-49"
    assert hearing.late.seconds(set(hearing.statuses)) >= 0.0


def test_a_strangers_instances_are_bounded(session: FakeSession) -> None:
    """Of any stage. Those of the robot stay, as they are heard each second."""
    hearing = Link(session, session.keys)
    for number in range(1000):
        if number % 100 == 0:
            session.publish(session.keys.below("service/driver/mine/status"), a_status(1, "mine"))
        status = compose.status(f"odd-{number}", number, 1, 1, [], {})
        session.publish(session.keys.below(f"service/odd-{number}/a/status"), status)
        hearing.poll()
    kept = (hearing.statuses, hearing.heard, hearing._published, hearing._greatest_ns)
    assert {len(each) for each in kept} == {link.MOST_INSTANCES}
    assert {len(each) for each in vars(hearing.late).values()} == {link.MOST_INSTANCES}
    assert hearing.stage("mapping") is not None
    assert ("odd-999", "odd-999-1") in hearing.statuses


@pytest.mark.parametrize(
    "more",
    [
        {"figures": {f"f{n}": 1.0 for n in range(257)}},
        {"published": {f"k{n}": 1 for n in range(257)}},
        {"figures": {"f" * 513: 1.0}},
        {"stage": "s" * 513},
    ],
    ids=["figures", "keys", "a long figure", "a long stage"],
)
def test_a_strangers_names_are_refused(session: FakeSession, more: dict[str, Any]) -> None:
    """Each would be a time series of its own in Prometheus."""
    given = {"stage": "mapping", "published": {}, **more}
    status = compose.status(stamp_ns=1, run=1, last_sweep=1, inputs=[], **given)
    hearing = Link(session, session.keys)
    session.publish(session.keys.below("service/mapping/mapping-1/status"), status)
    hearing.poll()
    assert (hearing.statuses, hearing.garbage) == ({}, 1)


def test_a_strangers_trace_is_refused(session: FakeSession) -> None:
    trace = tuple((f"s{n}", 1, 2, 3) for n in range(257))
    upright = (0.0, 0.0, 0.0, 1.0)
    pose = compose.pose("MapPose", HeaderValues(1, 1, 1, trace=trace), 1, (0, 0, 0), upright)
    hearing = Link(session, session.keys)
    session.publish(session.keys.pose, pose)
    hearing.poll()
    assert (len(hearing.poses), hearing.garbage) == (0, 1)


def test_of_two_that_only_answer_the_stamp_decides(session: FakeSession) -> None:
    """A router keeps the last status of an instance that has ended."""
    for instance, stamp_ns in (("new", 9), ("old", 8)):
        key = session.keys.below(f"service/mapping/{instance}/status")
        session.rounds[key] = [[a_status(stamp_ns, instance)]]
    asking = linked(session)
    asking.query_statuses()
    assert asking.newest_statuses()["mapping"].instance == "new"


def test_a_published_status_that_waited_for_an_answer_is_older(session: FakeSession) -> None:
    hearing = Link(session, session.keys)
    status_key = session.keys.below("service/mapping/mapping-1/status")
    session.rounds[status_key] = [[a_status(6)]]
    session.publish(status_key, a_status(5))
    hearing.query_statuses()
    hearing.poll()
    assert hearing.newest_statuses()["mapping"].stamp_ns == 6


@pytest.mark.parametrize("before", [[], [4]])
def test_a_published_status_that_an_answer_overtook_is_older(
    session: FakeSession, before: list[int]
) -> None:
    """Answers have a greater priority on the way than what is published."""
    hearing = Link(session, session.keys)
    who = ("mapping", "mapping-1")
    status_key = session.keys.below("service/mapping/mapping-1/status")
    at = {stamp_s: a_status(stamp_s * 10**9) for stamp_s in range(10)}
    for stamp_s in before:
        session.publish(status_key, at[stamp_s])
        hearing.poll()
    session.rounds[status_key] = [[at[6]]]
    hearing.query_statuses()
    late_before = hearing.late.seconds({who})
    session.publish(status_key, at[5])
    hearing.poll()
    assert hearing.newest_statuses()["mapping"].stamp_ns == 6 * 10**9
    assert hearing.late.seconds({who}) == late_before
    session.publish(status_key, at[7])
    hearing.poll()
    assert hearing.newest_statuses()["mapping"].stamp_ns == 7 * 10**9


def test_what_can_not_be_read_is_counted_and_left_out(session: FakeSession) -> None:
    """Every query, of configurations too; a command takes the next reply."""
    points = np.zeros(5, MAP_POINT)
    tile = compose.tile(HeaderValues(1, 0, 0), "plane", (0, 0, 0), points)
    below = session.keys.below
    session.rounds = {
        below("map/tile/plane/0/0/0"): [[GARBAGE, tile, b""]],
        below("path/map"): [[GARBAGE]],
        below("config/mapping"): [[GARBAGE]],
        below("command/mapping/save"): [[GARBAGE, b"short"]],
        below("service/mapping/mapping-1/status"): [[GARBAGE]],
        session.config_key("odometry"): [[GARBAGE, compose.config("odometry", {"a.b": 1})]],
    }
    asking = linked(session)
    asking.query_statuses()
    assert (asking.answering(), asking.garbage) == ([], 2)
    (found,) = asking.query_tiles(["plane"])
    assert (len(found.points), asking.garbage) == (5, 4)
    assert (asking.query_path(), asking.garbage) == (None, 5)
    assert (asking.query_revisions(), asking.garbage) == ([], 6)
    assert (asking.command("mapping", "save", {}), asking.garbage) == (None, 8)
    session.alive = ("odometry",)
    assert (asking.query_configs(), asking.garbage) == ({"odometry": {"a.b": 1}}, 9)
