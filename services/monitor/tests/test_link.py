"""A link asks until all living stages have answered, and counts what can not be read."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

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
    assert (len(asking.query_path()[1]), asking.garbage) == (0, 5)
    assert (asking.query_revisions(), asking.garbage) == ([], 6)
    assert (asking.command("mapping", "save", {}), asking.garbage) == (None, 8)
    session.alive = ("odometry",)
    assert (asking.query_configs(), asking.garbage) == ({"odometry": {"a.b": 1}}, 9)
