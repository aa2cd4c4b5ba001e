"""A view's copy of the map, which is got tile by tile."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fake_session import FakeSession, needs_schemas
from zloam_monitor import compose
from zloam_monitor.clouds import Tile
from zloam_monitor.compose import HeaderValues
from zloam_monitor.link import Link
from zloam_monitor.map_copy import MapCopy, lacks, show_past
from zloam_monitor.messages import MAP_POINT, STAMPED_POSE

SECONDS = 60.0


@pytest.fixture(autouse=True)
def built() -> None:
    needs_schemas()


@pytest.fixture
def session() -> FakeSession:
    return FakeSession()


def a_tile(i: int, version: int, points: int, map_id: int = 7) -> bytes:
    header = HeaderValues(1, 0, 0, map_id=map_id)
    return compose.tile(header, "plane", (i, 0, 0), np.zeros(points, MAP_POINT), version=version)


def hold(session: FakeSession, i: int, version: int, points: int, map_id: int = 7) -> None:
    """What mapping answers of one tile."""
    key = session.keys.tile("plane", (i, 0, 0))
    session.heads[key] = [a_tile(i, version, 0, map_id)]
    session.rounds[key] = [[a_tile(i, version, points, map_id)]]


def copy_of(session: FakeSession) -> MapCopy:
    return MapCopy(Link(session, session.keys), ["plane"])


def sizes(copy: MapCopy, seconds: float = SECONDS) -> dict[int, int]:
    return {tile.index[0]: len(tile.points) for tile in copy.update(seconds)}


def test_each_tile_is_got_by_itself_and_only_when_it_has_changed(session: FakeSession) -> None:
    for i in range(3):
        hold(session, i, version=1, points=5)
    copy = copy_of(session)
    assert sizes(copy) == {0: 5, 1: 5, 2: 5}
    hold(session, 1, version=2, points=6)
    session.selectors.clear()
    assert sizes(copy) == {0: 5, 1: 6, 2: 5}
    assert session.selectors == [
        session.keys.tiles_of("plane") + "?heads",
        session.keys.tile("plane", (1, 0, 0)),
    ]
    assert copy.lacking == 0
    assert lacks(copy.lacking) == ""


def test_what_was_dropped_on_the_way_is_told_and_asked_for_again(session: FakeSession) -> None:
    for i in range(3):
        hold(session, i, version=1, points=5)
    lost = session.rounds[session.keys.tile("plane", (1, 0, 0))]
    lost.insert(0, [])
    copy = copy_of(session)
    assert sizes(copy) == {0: 5, 2: 5}
    assert lacks(copy.lacking).startswith("1 tiles of the map did not come")
    assert sizes(copy) == {0: 5, 1: 5, 2: 5}
    assert copy.lacking == 0


def tell_tiles(session: FakeSession, count: int) -> None:
    """What mapping's status says of its map."""
    tell(session, compose.status("mapping", 1, 1, 1, [], {}, figures={"map_tiles": float(count)}))


def tell(session: FakeSession, status: bytes) -> None:
    session.alive = ("mapping",)
    session.rounds[session.keys.below("service/mapping/mapping-1/status")] = [[status]]


def test_a_head_that_was_dropped_is_a_tile_that_lacks(session: FakeSession) -> None:
    for i in range(3):
        hold(session, i, version=1, points=5)
    tell_tiles(session, 4)
    copy = copy_of(session)
    assert len(sizes(copy)) == 3
    assert copy.lacking == 1
    hold(session, 3, version=1, points=5)
    assert len(sizes(copy)) == 4
    assert copy.lacking == 0


def test_all_heads_that_were_dropped_are_no_empty_map(session: FakeSession) -> None:
    tell_tiles(session, 4)
    copy = copy_of(session)
    assert sizes(copy) == {}
    assert copy.lacking == 4


def test_what_an_ended_mapping_said_of_its_map_does_not_lack(session: FakeSession) -> None:
    """A router keeps its status, whose stamp may be greater: the robot's clock was set back."""
    hold(session, 0, version=1, points=5)
    tell_tiles(session, 1)
    ended = compose.status(
        "mapping", 9, 1, 1, [], {}, figures={"map_tiles": 50.0}, instance="mapping-0"
    )
    session.rounds[session.keys.below("service/mapping/mapping-0/status")] = [[ended]]
    copy = copy_of(session)
    assert sizes(copy) == {0: 5}
    assert copy.lacking == 0


def test_the_map_before_is_not_taken_for_that_of_a_living_mapping(session: FakeSession) -> None:
    """A store answers with it, too, and sooner than mapping, all of whose heads were dropped."""
    for i, (map_id, points) in enumerate(((6, 4), (6, 4), (7, 5))):
        key = session.keys.tile("plane", (i, 0, 0))
        session.rounds[key] = [[a_tile(i, 9, points, map_id)]]
    tell_tiles(session, 2)
    copy = copy_of(session)
    assert sizes(copy) == {2: 5}
    assert copy.lacking == 1


class Drawn:
    """What a view shows of the past."""

    def __init__(self) -> None:
        self.tiles: list[int] = []

    def keep_path(self, run: int, poses: NDArray[Any]) -> None: ...

    def keep(self, tile: Tile) -> None:
        self.tiles.append(tile.index[0])


def test_a_view_that_starts_asks_again_for_what_was_dropped(
    session: FakeSession, capsys: pytest.CaptureFixture[str]
) -> None:
    """It looks once: what does not come then is shown only when it changes."""
    for i in range(3):
        hold(session, i, version=1, points=5)
    for i, times in ((0, 1), (1, 2)):
        key = session.keys.tile("plane", (i, 0, 0))
        session.rounds[key] = [[]] * times + session.rounds[key]
    scene = Drawn()
    show_past(Link(session, session.keys), scene)
    assert sorted(scene.tiles) == [0, 1, 2]
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("last_sweep", "poses", "told"),
    [(1, None, True), (None, None, False), (1, 2, False), (1, 0, False)],
    ids=["dropped", "nothing mapped", "there", "after a reset"],
)
def test_a_path_that_did_not_come_is_told(
    session: FakeSession,
    capsys: pytest.CaptureFixture[str],
    last_sweep: int | None,
    poses: int | None,
    told: bool,
) -> None:
    """Else it seems that the robot began where the view did."""
    tell(session, compose.status("mapping", 1, 1, last_sweep, [], {}))
    if poses is not None:
        path = compose.path(HeaderValues(1, 0, 0), np.zeros(poses, STAMPED_POSE))
        session.rounds[session.keys.path_map] = [[path]]
    show_past(Link(session, session.keys), Drawn())
    assert ("the path so far did not come" in capsys.readouterr().out) is told


def test_a_tile_that_never_comes_is_told_and_does_not_hold_the_view_up(
    session: FakeSession, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(3):
        hold(session, i, version=1, points=5)
    key = session.keys.tile("plane", (1, 0, 0))
    session.rounds[key] = [[]]
    scene = Drawn()
    show_past(Link(session, session.keys), scene)
    assert sorted(scene.tiles) == [0, 2]
    assert capsys.readouterr().out.startswith("1 tiles of the map did not come")
    assert session.selectors.count(key) == 2


def test_a_slow_link_ends_the_update_and_the_next_one_goes_on(session: FakeSession) -> None:
    for i in range(3):
        hold(session, i, version=1, points=5)
    copy = copy_of(session)
    assert sizes(copy, seconds=-1.0) == {}
    assert copy.lacking == 3
    assert len(sizes(copy)) == 3


def test_another_map_begins_another_copy(session: FakeSession) -> None:
    """Also one of a lower number: that of a merged map follows from its drives."""
    for i in range(3):
        hold(session, i, version=9, points=5)
    copy = copy_of(session)
    sizes(copy)
    session.heads.clear()
    hold(session, 1, version=1, points=4, map_id=6)
    assert sizes(copy) == {1: 4}


def test_a_replay_that_is_repeated_begins_the_copy_again(session: FakeSession) -> None:
    """Its map has the same number, which follows from the capture."""
    for i in range(3):
        hold(session, i, version=9, points=5)
    copy = copy_of(session)
    assert sizes(copy) == {0: 5, 1: 5, 2: 5}
    session.heads.clear()
    hold(session, 0, version=1, points=2)
    hold(session, 1, version=9, points=3)
    assert sizes(copy) == {0: 2, 1: 3}
    session.selectors.clear()
    assert sizes(copy) == {0: 2, 1: 3}
    assert session.selectors == [session.keys.tiles_of("plane") + "?heads"]
    # Answers with all points, as those of `zloam replay`.
    session.heads = {session.keys.tile("plane", (0, 0, 0)): [a_tile(0, version=0, points=4)]}
    assert sizes(copy) == {0: 4}


def test_the_store_may_still_have_an_older_tile(session: FakeSession) -> None:
    hold(session, 0, version=5, points=5)
    session.rounds[session.keys.tile("plane", (0, 0, 0))][0] += [
        a_tile(0, version=4, points=4),
        a_tile(0, version=40, points=3, map_id=3),
    ]
    assert sizes(copy_of(session)) == {0: 5}


def test_a_store_alone_and_an_older_robot_have_no_heads(session: FakeSession) -> None:
    key = session.keys.tile("plane", (0, 0, 0))
    session.rounds[key] = [[a_tile(0, version=1, points=5)]]
    assert sizes(copy_of(session)) == {0: 5}
    session.heads[key] = [a_tile(0, version=2, points=6)]
    assert sizes(copy_of(session)) == {0: 6}
