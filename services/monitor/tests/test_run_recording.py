"""A recording beside a run reports at its end what is missing, and keeps no run waiting."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fake_session import FakeSession, linked, needs_schemas, one_misses_a_query
from zloam_monitor import compose, link, messages, run_recording
from zloam_monitor.recorder import Options, Recorder

MIB = 1 << 20


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    needs_schemas()
    monkeypatch.setattr(link, "BUSY_SECONDS", 0.3)


@pytest.fixture
def session() -> FakeSession:
    return one_misses_a_query()


def test_a_run_beside_it_is_told_at_its_end(session: FakeSession, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with run_recording.beside(linked(session), path) as beside:
        assert beside is not None
        beside._recorder.options = Options(path, scene=False, split_bytes=MIB)
        (tmp_path / "run_2.mcap").write_text("precious")
        beside.begin()
        session.publish_long_pose(1)
        while beside._thread.is_alive():
            beside._thread.join(0.1)
        (lack,) = beside.end()
    assert "run_2.mcap is there already" in lack
    assert beside.end() == [lack]


def tiles_held(session: FakeSession, count: int) -> None:
    head = compose.HeaderValues(1, 0, 0, map_id=7)
    for i in range(count):
        key = session.keys.tile("plane", (i, 0, 0))
        empty, whole = (
            compose.tile(head, "plane", (i, 0, 0), np.zeros(points, messages.MAP_POINT), 2)
            for points in (0, 5)
        )
        session.heads[key], session.rounds[key] = [empty], [[whole]]


def slowed(session: FakeSession, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each tile takes a while."""
    get = session.get

    def slow(selector: str, *more: Any, **named: Any) -> list[Any]:
        time.sleep(0.1 if "/plane/" in selector and "?" not in selector else 0.0)
        return get(selector, *more, **named)

    monkeypatch.setattr(session, "get", slow)


def test_the_map_from_before_the_run_is_waited_for(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a short demo with --localize: its stages end next."""
    tiles_held(session, 6)
    slowed(session, monkeypatch)
    with run_recording.beside(linked(session), tmp_path / "run.mcap") as beside:
        assert beside is not None
        beside.begin()
        beside.catch_up()
        assert beside.end() == []


def test_a_mapping_that_hangs_keeps_no_run_waiting(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_recording, "TILES_SECONDS", 0.0)
    tiles_held(session, 100)
    slowed(session, monkeypatch)
    with run_recording.beside(linked(session), tmp_path / "run.mcap") as beside:
        assert beside is not None
        beside.begin()
        beside.catch_up()
        assert beside._recorder.asks()
        (lack,) = beside.end()
    assert "tiles that the map had before are missing" in lack


def test_a_recording_that_gave_up_asks_for_no_more_tiles(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would fill the memory until the end of the run."""
    tiles_held(session, 100)
    slowed(session, monkeypatch)
    made = Recorder(linked(session), Options(tmp_path / "run.mcap"))
    made.settle()
    made.give_up()
    assert not made.asks()
    made.close()


def test_statuses_keep_no_run_waiting(session: FakeSession, tmp_path: Path) -> None:
    """Several stages' may always come at intervals of less than 0.2 s."""
    ends, waited = threading.Event(), threading.Event()

    def speak() -> None:
        while not ends.wait(0.02):
            session.publish_status("odometry", health="stopping")

    with run_recording.beside(linked(session), tmp_path / "run.mcap") as beside:
        assert beside is not None
        beside.begin()

        def catch_up() -> None:
            beside.catch_up()
            waited.set()

        threads = [threading.Thread(target=each) for each in (speak, catch_up)]
        for each in threads:
            each.start()
        has_ended = waited.wait(20.0)
        ends.set()
        for each in threads:
            each.join()
        beside.end()
    assert has_ended
