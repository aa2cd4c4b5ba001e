"""One look at a robot whose stages are reached one after another."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fake_session import FakeSession, needs_schemas
from zloam_monitor import compose, link, watch
from zloam_monitor.compose import HeaderValues
from zloam_monitor.kept_poses import KeptPoses
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link
from zloam_monitor.records import PoseRecord, StatusRecord
from zloam_monitor.stages import STAGES
from zloam_monitor.traffic import Published, Rate, Taken


def a_pose() -> PoseRecord:
    return PoseRecord(1, 7, 0, np.array([1.0, 2.0, 3.0]), np.array([0, 0, 0, 1.0]), 0, 0, False, ())


def a_status(stamp_ns: int) -> StatusRecord:
    status = SimpleNamespace(
        stage="mapping", instance="mapping-1", stamp_ns=stamp_ns, published_bytes={}
    )
    return cast(StatusRecord, status)


class Linking:
    """A stand-in for a link that hears one more stage with each query."""

    keys = Keys("robot")
    garbage = 0

    def __init__(self, reachable: int) -> None:
        self._reachable, self._heard, self._looks = reachable, 0, 0
        self.poses = KeptPoses()
        self.published, self.taken, self.posed = Published(), Taken(), Rate()
        #: Stages whose instance was killed.
        self.killed: set[str] = set()
        self.statuses: dict[str, Any] = {}
        self.health = "ready"

    def query_statuses(self) -> None:
        self._heard = min(self._heard + 1, self._reachable)
        self._looks += 1
        if self._looks > len(STAGES) + 1:  # The pose comes after the last stage.
            self.poses.add(a_pose())

    def poll(self, _seconds: float = 0.0) -> None: ...

    def newest_statuses(self) -> dict[str, Any]:
        heard = {stage: self.stage(stage) for stage in STAGES}
        return {stage: status for stage, status in heard.items() if status is not None}

    def stage(self, stage: str) -> Any:
        if stage not in STAGES[: self._heard]:
            return None
        return SimpleNamespace(
            stage=stage,
            instance=f"{stage}-1",
            inputs=[],
            published={"loam/robot/lidar/lidar/sweep": 42},
            health=self.health,
            rss_mib={"end": 1.0},
            cpu_ms=1.0,
            reason="",
        )

    def living_instances(self) -> set[tuple[str, str]]:
        heard = STAGES[: self._heard]
        return {(stage, f"{stage}-1") for stage in heard if stage not in self.killed}

    def silent_s(self, _status: object, _now: float) -> float:
        return 0.0


def test_stages_behind_slow_links_are_waited_for(capsys: pytest.CaptureFixture[str]) -> None:
    link: Any = Linking(len(STAGES))
    assert watch.look(link) == 0
    said = capsys.readouterr().out
    assert "nothing heard" not in said
    # It also waited for a pose. The time is too short for a rate.
    assert "sweep 7, at 1.00 2.00 3.00 m" in said


def test_a_watch_begins_with_all_stages_and_a_pose(capsys: pytest.CaptureFixture[str]) -> None:
    link: Any = Linking(len(STAGES))
    assert watch.watch(link, seconds=0.1, every_s=2.0) in (0, 1)
    first = capsys.readouterr().out
    assert "no pose yet" not in first
    assert "nothing heard" not in first


def test_a_source_is_said_to_send(capsys: pytest.CaptureFixture[str]) -> None:
    """It receives no message, so `received 0` looked like a fault."""
    assert watch.look(cast(Any, Linking(len(STAGES)))) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert "sent          42  queued" in lines["driver"]
    assert "received       0  queued" in lines["mapping"]


def test_a_silent_one_is_told_after_a_while(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch, "ALL_SECONDS", 0.1)
    link: Any = Linking(len(STAGES) - 1)
    assert watch.look(link) == 1
    assert f"{STAGES[-1]:<13}nothing heard" in capsys.readouterr().out


@pytest.mark.parametrize(("health", "code"), [("ready", 1), ("starting", 1), ("stopping", 0)])
def test_a_status_that_a_router_keeps_is_no_sign_of_life(
    health: str,
    code: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(watch, "ALL_SECONDS", 0.1)
    link: Any = Linking(len(STAGES))
    link._heard = len(STAGES)
    link.poses.add(a_pose())
    link.killed, link.health = {"odometry"}, health
    assert watch.look(link) == code
    said = capsys.readouterr().err
    assert ("odometry: odometry-1 is not alive" in said) == bool(code)
    assert "mapping" not in said


def test_an_ended_instance_is_not_taken_for_its_successor(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A router keeps the status of the one that ended, whose stamp is greater: the robot's clock
    was set back before the stage was started again."""
    needs_schemas()
    monkeypatch.setattr(watch, "ALL_SECONDS", 0.1)
    session = FakeSession(alive=STAGES)

    def said(stage: str, instance: str, stamp_ns: int) -> tuple[str, bytes]:
        made = compose.status(stage, stamp_ns, 1, 0, [], {}, instance=instance)
        return session.keys.below(f"service/{stage}/{instance}/status"), made

    of_all = [said(stage, f"{stage}-1", 10) for stage in STAGES]
    for key, status in [*of_all, said("mapping", "mapping-0", 20)]:
        session.rounds[key] = [[status]]
    hearing = Link(session, session.keys)
    hearing.poses.add(a_pose())
    assert watch.look(hearing) == 1
    assert "mapping: mapping-0 is not alive" in capsys.readouterr().err
    # The successor publishes each second.
    session.publish(*said("mapping", "mapping-1", 11))
    assert watch.look(hearing) == 0


def test_a_status_asked_for_again_is_not_heard_anew() -> None:
    """A status with a newer stamp is."""
    link = Link(SimpleNamespace(), Keys("robot"), newest=0)
    who = ("mapping", "mapping-1")
    link._take_answer(a_status(stamp_ns=10))
    first_s = link.heard[who] = link.heard[who] - 100.0
    link._take_answer(a_status(stamp_ns=10))
    assert link.heard[who] == first_s
    link._take_answer(a_status(stamp_ns=11))
    assert link.heard[who] > first_s


@pytest.mark.parametrize("kept", [6000, None])
def test_the_rate_of_poses_is_that_of_now(
    kept: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An hour after the begin too, though a view keeps the poses of ten minutes, and a run that
    began again those of its newest part."""
    needs_schemas()
    session, now_s = FakeSession(), 0.0
    monkeypatch.setattr(link, "time", SimpleNamespace(monotonic=lambda: now_s))
    hearing = Link(session, session.keys, kept)
    for number in [0, *range(36_000, 36_100)]:
        now_s = 0.1 * number
        run = 1 if number < 36_080 else 2
        at_ns, head = number * 10**8, HeaderValues(run, number, number)
        payload = compose.pose("MapPose", head, at_ns, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
        session.publish(session.keys.pose, payload)
        hearing.poll()
    assert watch.state_line(hearing, now_s) == "sweep 36099, 10.0 poses/s, at 1.00 2.00 3.00 m"
    assert watch.looked(hearing, now_s)["poses_per_s"] == pytest.approx(10.0)
    # None come any more.
    assert "sweep 36099, 0.0 poses/s" in watch.state_line(hearing, now_s + 60.0)


def test_what_subscribers_take_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    link: Any = Linking(len(STAGES))
    for second in range(3):
        counts = {"loam/robot/map/tile/**": 400_000 * second, "loam/robot/pose": 5_000 * second}
        link.published.take(
            SimpleNamespace(
                stage="a", instance="a-1", stamp_ns=second * 10**9, published_bytes=counts
            )
        )
    link.taken.take(3000, 0.0)
    assert list(watch.traffic_lines(link, 10.0)) == [
        "a subscriber takes, kB/s: map/tile/** 400, pose 5.0",
        "this view takes 0.0 kB/s",
    ]
    assert watch.look(link) == 0
    assert "map/tile/** 400" in capsys.readouterr().out
