"""The page's figures are of now, also while the robot does not answer."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zenoh

from fake_session import FakeSession, needs_schemas
from zloam_monitor import compose, discovery, records
from zloam_monitor.compose import HeaderValues
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, LinkError
from zloam_monitor.messages import MAP_POINT
from zloam_monitor.records import PoseRecord
from zloam_monitor.web import robot_view
from zloam_monitor.web.robot_view import RobotView
from zloam_monitor.web.server import Robots

PATIENCE_S = 20.0


class Hanging(FakeSession):
    """A robot of which nobody answers queries for tiles until `answers` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.answers = threading.Event()
        self.asked = threading.Event()
        self.failure: Exception | None = None
        #: The query for tiles has ended.
        self.done = threading.Event()
        self.selectors: list[str] = []

    def get(self, selector: str, handler: Any = None, **more: Any) -> list[Any]:
        self.selectors.append(selector)
        if "/map/tile/" in selector:
            self.asked.set()
            self.answers.wait(PATIENCE_S)
            self.done.set()
            if self.failure is not None:
                raise self.failure
        return super().get(selector, handler, **more)


def until(holds: Callable[[], Any]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def pass_30_s(monkeypatch: pytest.MonkeyPatch) -> None:
    real = time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: real() + 30.0)


@pytest.fixture
def session() -> Iterator[Hanging]:
    needs_schemas()
    made = Hanging()
    yield made
    made.answers.set()


@pytest.fixture
def view(session: Hanging, monkeypatch: pytest.MonkeyPatch) -> Iterator[RobotView]:
    monkeypatch.setattr(robot_view, "LISTEN_SECONDS", 0.1)
    made = RobotView(Link(session, session.keys, 100))
    yield made
    session.answers.set()
    made.close()


def drive(session: Hanging, sweep: int) -> None:
    """Publishes a pose and a status."""
    position, upright = (float(sweep), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    head = HeaderValues(1, sweep, sweep)
    session.publish(
        session.keys.pose, compose.pose("MapPose", head, sweep * 10**8, position, upright)
    )
    status = compose.status("driver", sweep * 10**8, 1, sweep, [], {}, reason=f"sweep {sweep}")
    session.publish(session.keys.below("service/driver/driver-1/status"), status)


def driver(state: dict[str, Any]) -> dict[str, Any]:
    return next(stage for stage in state["stages"] if stage["name"] == "driver")


def test_the_robot_is_followed_while_nobody_answers(session: Hanging, view: RobotView) -> None:
    assert session.asked.wait(PATIENCE_S)
    for sweep in (1, 2):
        drive(session, sweep)
        until(lambda: (view.state()["pose"] or {}).get("sweep") == sweep)  # noqa: B023
        until(lambda: driver(view.state())["reason"] == f"sweep {sweep}")  # noqa: B023
    assert not session.answers.is_set()
    session.answers.set()
    until(lambda: view.state()["judged"])


def publish_mapped(session: Hanging, sweep: int, map_id: int) -> None:
    head = HeaderValues(1, sweep, sweep, map_id=map_id)
    at = ((float(sweep), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    session.publish(session.keys.map_odometry, compose.pose("MapPose", head, sweep * 10**8, *at))


def test_the_path_ends_with_its_map(session: Hanging, view: RobotView) -> None:
    """As after `zloam reset`: the same run goes on, and only mapped poses name the map."""
    for sweep in (1, 2):
        drive(session, sweep)
        publish_mapped(session, sweep, map_id=7)
    until(lambda: view.state()["path"] == [[1.0, 0.0], [2.0, 0.0]])
    publish_mapped(session, 3, map_id=8)
    until(lambda: view.state()["path"] == [])
    # The pose of that sweep came late: it was fused with a correction of the old map.
    for sweep in (3, 4, 5):
        drive(session, sweep)
    until(lambda: view.state()["pose"]["sweep"] == 5)
    assert view.state()["path"] == [[4.0, 0.0], [5.0, 0.0]]


def test_what_no_longer_moves_is_seen_to_be_old(
    session: Hanging, view: RobotView, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if the thread that follows the robot has ended."""
    drive(session, 1)
    until(lambda: view.state()["pose"] and driver(view.state())["health"] == "ready")
    session.answers.set()
    view.close()
    pass_30_s(monkeypatch)
    state = view.state()
    assert state["age_s"] >= 30.0
    assert driver(state)["health"] == "silent"
    assert state["rate"] == 0.0


def test_without_poses_there_is_no_latency(
    session: Hanging, view: RobotView, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The chart ends where the poses do, and does not go on with the last one's."""
    sweeps = itertools.count(1)

    def is_charted() -> bool:
        # Again and again, as a pose of which the thread hears late is charted no more.
        sweep = next(sweeps)
        head = HeaderValues(1, sweep, sweep, trace=(("driver", 1, 2, 3_000_001),))
        pose = compose.pose("MapPose", head, 10**8, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        session.publish(session.keys.pose, pose)
        return any(each["stages"] == {"driver": 3.0} for each in view.state()["history"])

    until(is_charted)
    pass_30_s(monkeypatch)
    until(lambda: view.state()["history"][-1]["stages"] == {})


def test_the_time_of_mapping_is_that_of_the_newest_mapped_pose() -> None:
    """Fused poses do not pass mapping. Of a mapping that stands still none is charted."""
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    step = records.TraceStep

    def posed(sweep: int, *trace: records.TraceStep) -> PoseRecord:
        return PoseRecord(1, sweep, sweep * 10**8, np.zeros(3), upright, 0, 0, False, trace)

    driven = step("driver", 1, 2, 3_000_001)
    fused = posed(50, driven, step("integration", 5_000_000, 5_000_000, 6_000_000))
    mapped = posed(48, driven, step("mapping", 4_000_000, 6_000_000, 12_000_000))
    fine = {"driver": 3.0, "integration": 1.0}
    assert robot_view._latency(fused, mapped) == {**fine, "mapping": 8.0}
    assert robot_view._latency(fused, None) == fine
    assert robot_view._latency(fused, replace(mapped, instant_ns=20 * 10**8)) == fine
    assert robot_view._latency(fused, replace(mapped, run=2)) == fine
    assert robot_view._latency(None, mapped) == {}


@pytest.mark.parametrize(("cells", "sigma_m"), [(36, 0.2), (9, None), (0, None)])
def test_the_sigma_is_that_of_the_worst_direction(cells: int, sigma_m: float | None) -> None:
    """0.2 m along a corridor at 45 degrees to the robot; along its axes it is 0.14 m. A covariance
    of another size is a stranger's."""
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = 0.02
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    pose = PoseRecord(1, 1, 0, np.zeros(3), upright, 0, 0, False, ())
    found = replace(pose, covariance=tuple(covariance.ravel()[:cells]))
    assert robot_view._pose(found)["sigma_m"] == sigma_m


def test_the_view_ends_while_nobody_answers(
    session: Hanging, view: RobotView, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_view, "CLOSE_SECONDS", 0.5)
    assert session.asked.wait(PATIENCE_S)
    view.close()
    assert not session.done.is_set()
    before = len(session.selectors)
    session.answers.set()
    assert view._asker is not None
    view._asker.join(PATIENCE_S)
    # Only the other layers of the map, of which it had begun to ask.
    assert all("/map/tile/" in each for each in session.selectors[before:])


@pytest.mark.parametrize(
    ("failure", "words"),
    [(zenoh.ZError("closed"), "no query can be sent"), (KeyError("x"), "can't be judged: KeyErr")],
)
def test_a_query_that_fails_is_a_finding(
    session: Hanging, view: RobotView, failure: Exception, words: str
) -> None:
    session.failure = failure
    session.answers.set()
    until(lambda: any(words in each["what"] for each in view.state()["findings"]))
    drive(session, 1)
    until(lambda: view.state()["pose"])


def test_a_map_that_lacks_tiles_is_told(session: Hanging, view: RobotView) -> None:
    key = session.keys.tile("plane", (0, 0, 0))
    head = compose.tile(HeaderValues(1, 0, 0, map_id=7), "plane", (0, 0, 0), np.zeros(0, MAP_POINT))
    session.heads[key], session.rounds[key] = [head], [[]]
    session.answers.set()
    until(lambda: view.state()["judged"])
    told = [each for each in view.state()["findings"] if "tiles of the map" in each["what"]]
    assert [(each["what"][:7], each["fault"]) for each in told] == [("1 tiles", False)]


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Hanging]]:
    """Endpoint -> the robot there; a search finds them all."""
    needs_schemas()
    there: dict[str, Hanging] = {}

    @contextmanager
    def linked_to(each: discovery.Found, *_: Any) -> Iterator[Link]:
        if each.endpoint not in there:
            raise LinkError("no link to the stages")
        yield Link(there[each.endpoint], Keys(each.robot), 100)

    monkeypatch.setattr(discovery, "linked_to", linked_to)
    monkeypatch.setattr(robot_view, "LISTEN_SECONDS", 0.1)
    yield there
    for session in there.values():
        session.answers.set()


def test_a_robot_that_answers_elsewhere_is_followed_there(
    found: dict[str, Hanging], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that was started again while another robot had its ports; not while it is heard."""
    found["tcp/a:1"], found["tcp/a:2"] = Hanging(), Hanging()
    here, there = (discovery.Found("robot", endpoint, ()) for endpoint in found)
    monkeypatch.setattr(discovery, "present", lambda _: [here])
    monkeypatch.setattr(discovery, "robots", lambda _: [there])
    # A busy machine may stand still for the five seconds after which a robot is gone.
    monkeypatch.setattr(robot_view, "STALE_SECONDS", PATIENCE_S)
    with closing(Robots([])) as robots:
        first = robots.view("robot")
        assert first is not None
        drive(found["tcp/a:1"], 1)
        until(lambda: first.state()["pose"])
        robots.search()
        assert robots.view("robot") is first
        for session in found.values():
            session.answers.set()
        pass_30_s(monkeypatch)
        robots.search()
        second = robots.view("robot")
        assert second is not None
        assert second is not first
        assert second.state()["map_version"] != first.state()["map_version"]
        drive(found["tcp/a:2"], 7)
        until(lambda: (second.state()["pose"] or {}).get("sweep") == 7)


def test_a_robot_that_vanished_after_it_was_found_ends_nothing(
    found: dict[str, Hanging], monkeypatch: pytest.MonkeyPatch
) -> None:
    found["tcp/a:1"], found["tcp/a:3"] = Hanging(), Hanging()
    names = {"a": "tcp/a:1", "b": "tcp/a:2", "c": "tcp/a:3"}
    all_three = [discovery.Found(name, endpoint, ()) for name, endpoint in names.items()]
    monkeypatch.setattr(discovery, "present", lambda _: all_three[:1])
    monkeypatch.setattr(discovery, "robots", lambda _: all_three)
    with closing(Robots([])) as robots:
        robots.search()
        assert robots.names() == ["a", "c"]
        for session in found.values():
            session.answers.set()
