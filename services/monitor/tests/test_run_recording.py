"""A recording beside a run reports at its end what is missing, and keeps no run waiting."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from fake_session import FakeSession, linked, needs_schemas, one_misses_a_query
from zloam_monitor import link, run_recording
from zloam_monitor.recorder import Options

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
