"""Tests which keys a thin view uses, and what it shows."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zloam_monitor import compose, messages, thin
from zloam_monitor.compose import HeaderValues
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link
from zloam_monitor.web.robot_view import RobotView

PATIENCE_S = 20.0


class Session:
    """A stand-in for a Zenoh session that cannot send queries."""

    def __init__(self) -> None:
        self.readers: dict[str, Callable[[Any], None]] = {}

    def declare_subscriber(self, key: str, read: Callable[[Any], None]) -> Any:
        self.readers[key] = read
        return SimpleNamespace(undeclare=lambda: None)

    def put(self, key: str, payload: bytes) -> None:
        self.readers[key](SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: payload)))


@pytest.fixture
def link() -> Link:
    try:
        messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))
    return Link(Session(), Keys("robot"), 100, thin=True)


def a_preview(sweep: int, blocks: int = 1, epoch: int = 1, map_id: int = 5) -> bytes:
    """A preview with at most one full block of 8 m that has 2^1 cells along an edge."""
    rows = np.array([(0, 0, 0, 1, 1, 0)], messages.PREVIEW_BLOCK)[:blocks]
    head = HeaderValues(5, sweep, sweep, map_id=map_id, stamp_ns=sweep * 10**8)
    return compose.preview(head, epoch, (float(sweep), 2.0, 0.0), 8.0, rows, b"\xff"[:blocks])


def until(holds: Callable[[], Any]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_it_takes_the_preview_and_statuses_alone(link: Link) -> None:
    """It sends no queries: this session has no function for them."""
    session: Any = link.session
    assert set(session.readers) == set(thin.expressions(link.keys))
    view = RobotView(link)
    try:
        sent = 0
        for sweep in (3, 4):
            session.put(link.keys.preview, a_preview(sweep))
            sent += len(a_preview(sweep))
        status = compose.status("driver", 10**9, 5, 4, [], {})
        session.put(link.keys.every_status, status)
        until(lambda: view.map_view()["cells"])
        until(lambda: any("not there" in each["what"] for each in view.state()["findings"]))
        state = view.state()
        assert state["thin"]
        assert state["pose"]["xyz"] == [4.0, 2.0, 0.0]
        assert state["path"] == [[3.0, 2.0], [4.0, 2.0]]
        assert {s["name"]: s["health"] for s in state["stages"]}["driver"] == "ready"
        assert not any("driver is not there" in each["what"] for each in state["findings"])
        assert link.taken.total == sent + len(status)
        assert state["kb_s"] is not None
    finally:
        view.close()


def test_a_map_that_was_emptied_is_no_longer_shown(link: Link) -> None:
    session: Any = link.session
    view = RobotView(link)
    try:
        session.put(link.keys.preview, a_preview(3))
        until(lambda: view.map_view()["cells"])
        session.put(link.keys.preview, a_preview(4, blocks=0, epoch=2))
        until(lambda: not view.map_view()["cells"])
        session.put(link.keys.preview, a_preview(5, blocks=0, epoch=3, map_id=6))
        session.put(link.keys.preview, a_preview(6, blocks=0, epoch=3, map_id=6))
        until(lambda: view.state()["pose"]["sweep"] == 6)
        until(lambda: view.state()["path"] == [[6.0, 2.0]])
    finally:
        view.close()


def test_it_says_what_to_start(link: Link, monkeypatch: pytest.MonkeyPatch) -> None:
    assert thin.silence(link) is None
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + 3.0)
    said = thin.silence(link)
    assert said is not None
    assert "loam/robot/preview" in said
    assert "zloam preview --config" in said
    session: Any = link.session
    session.put(link.keys.preview, a_preview(1))
    link.poll()
    assert thin.silence(link) is None
