"""An incomplete map is not written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zloam_monitor import map_saving, maps
from zloam_monitor.clouds import Tile
from zloam_monitor.keys import Keys
from zloam_monitor.messages import MAP_POINT


def tile(index: int, points: int, map_id: int = 7) -> Tile:
    return Tile("plane", (index, 0, 0), 1, np.zeros(points, MAP_POINT), map_id)


@dataclass
class Robot:
    """A stand-in for the link to a robot with these answers."""

    answers: list[list[Tile]]
    map_points: int
    lives: bool = True
    #: Number of queries for tokens before mapping is among them.
    lives_after: int = 0
    #: Number of queries for statuses that mapping does not answer.
    mute_for: int = 0
    last_sweep: int | None = 41
    #: Number of answers in each query for tiles that can't be read.
    unreadable: int = 0
    garbage: int = 0
    keys: Keys = field(default_factory=lambda: Keys("carol"))

    def query_statuses(self) -> None:
        self.mute_for -= 1

    def stage(self, _stage: str) -> Any:
        if self.mute_for >= 0:
            return None
        known = self.last_sweep is not None
        figures = {"map_points": float(self.map_points)} if known else {}
        return SimpleNamespace(
            stage="mapping",
            instance="mapping-1",
            reason="",
            stamp_ns=0,
            last_sweep=self.last_sweep,
            figures=figures,
        )

    def living(self) -> set[str]:
        self.lives_after -= 1
        return {"mapping"} if self.lives and self.lives_after < 0 else set()

    #: Number of tiles that are dropped on the way.
    dropped: int = 0
    #: Index of a tile that never comes.
    loses: int | None = None
    now: list[Tile] = field(default_factory=list)

    def living_instances(self) -> set[tuple[str, str]]:
        return {("mapping", "mapping-1")} if self.lives else set()

    def answering(self) -> list[Any]:
        status = self.stage("mapping")
        return [] if status is None else [status]

    def query_tiles(self, _layers: Sequence[str]) -> list[Tile]:
        self.garbage += self.unreadable
        self.now = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        return self.now

    def tiles_at(self, selector: str) -> list[Tile]:
        """The plane tiles without their points, or one tile."""
        key, _, heads = selector.partition("?")
        if heads:
            of_layer = self.query_tiles([]) if key == self.keys.tiles_of("plane") else []
            return [replace(tile, points=tile.points[:0]) for tile in of_layer]
        found = [tile for tile in self.now if self.keys.tile(tile.layer, tile.index) == key]
        if any(tile.index[0] == self.loses for tile in found):
            return []
        if found and self.dropped > 0:
            self.dropped -= 1
            return []
        return found

    def query_configs(self) -> dict[str, dict[str, Any]]:
        return {"mapping": {"mapping.leaf_plane_m": 0.4, "mapping.every": 1}}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_saving, "BUSY_SECONDS", 1.0)
    monkeypatch.setattr(map_saving, "PATIENCE_SECONDS", 0.3)


def save(robot: Any, to: Path) -> map_saving.Saved:
    return map_saving.save(robot, to, None)


def test_an_answer_that_was_lost_is_asked_for_again(tmp_path: Path) -> None:
    to = tmp_path / "town.pcd"
    saved = save(Robot([[tile(0, 5)], [tile(0, 5), tile(1, 3)]], 8), to)
    assert (saved.points, saved.tiles, saved.map_id, saved.sweep) == (8, 2, 7, 41)
    assert saved.points_of_map == 8
    assert len(saved.lines()) == 1
    assert len(maps.read(to)) == 8
    assert b"# mapping.leaf_plane_m: 0.4\n" in to.read_bytes()
    assert b"mapping.every" not in to.read_bytes()


def test_a_tile_that_was_dropped_is_asked_for_again(tmp_path: Path) -> None:
    robot = Robot([[tile(0, 5), tile(1, 3)]], 8, dropped=1)
    assert save(robot, tmp_path / "town.pcd").points == 8


def test_a_tile_that_cannot_be_read_is_missing_in_no_saved_map(tmp_path: Path) -> None:
    to = tmp_path / "town.pcd"
    with pytest.raises(maps.MapError, match="1 tiles of the map can't be read"):
        save(Robot([[tile(0, 5)]], 5, unreadable=1), to)
    assert not to.exists()


@pytest.mark.parametrize(("suffix", "losses"), [(".laz", 1), (".pcd", 0)])
def test_intensities_that_las_does_not_hold_are_named(
    suffix: str, losses: int, tmp_path: Path
) -> None:
    points = np.zeros(5, MAP_POINT)
    points["intensity"] = np.linspace(0.0, 1.0, 5)
    robot = Robot([[Tile("plane", (0, 0, 0), 1, points, 7)]], 5)
    saved = save(robot, tmp_path / f"town{suffix}")
    assert len(saved.losses) == losses
    assert ["intensities of 0 to 1 are rounded" in line for line in saved.lines()[1:]] == [
        True
    ] * losses


def test_a_stage_whose_link_comes_up_late_is_waited_for(tmp_path: Path) -> None:
    robot = Robot([[], [], [tile(0, 5)]], 5)
    robot.lives_after = 2
    saved = save(robot, tmp_path / "town.pcd")
    assert (saved.points, saved.sweep) == (5, 41)


def test_a_mapping_without_points_is_not_waited_for(tmp_path: Path) -> None:
    robot = Robot([[], [tile(0, 5)]], 0)
    with pytest.raises(maps.MapError, match="there is no map yet"):
        save(robot, tmp_path / "town.pcd")
    assert len(robot.answers) == 1


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        (Robot([[tile(0, 5)]], 8), "only 5 of 8 points came"),
        (Robot([[]], 0), "there is no map yet"),
        (Robot([[]], 0, lives=False), "there is no map yet"),
        # The new map's points came, those of the one before do not count.
        (Robot([[tile(1, 5, map_id=8), tile(0, 5)]], 8), "only 5 of 8 points came"),
        (Robot([[tile(0, 5), tile(1, 3)]], 5, dropped=10**6), "2 tiles of the map did not come"),
        # One tile that has grown does not come.
        (Robot([[tile(0, 5), tile(1, 3)]], 5, loses=1), "1 tiles of the map did not come"),
        # One of two layers, of a mapping whose statuses do not come.
        (Robot([[tile(0, 5)]], 8, mute_for=10**6), "lives but does not say how many points"),
    ],
)
def test_otherwise_nothing_is_written(robot: Robot, said: str, tmp_path: Path) -> None:
    with pytest.raises(maps.MapError, match=said):
        save(robot, tmp_path / "town.pcd")
    assert not list(tmp_path.iterdir())


def test_a_store_answers_for_a_mapping_that_is_gone(tmp_path: Path) -> None:
    saved = save(Robot([[tile(0, 5)]], 0, lives=False), tmp_path / "town.ply")
    assert (saved.points, saved.sweep, saved.points_of_map) == (5, None, None)
    assert "mapping did not say how many points" in saved.lines()[-1]


def test_a_status_that_comes_late_is_waited_for(tmp_path: Path) -> None:
    robot = Robot([[tile(0, 5)], [tile(0, 5), tile(1, 3)]], 8, mute_for=3)
    assert save(robot, tmp_path / "town.ply").points == 8


def test_a_mapping_before_its_first_sweep_says_no_number(tmp_path: Path) -> None:
    """It may have resumed a stored map."""
    saved = save(Robot([[tile(0, 5)]], 0, last_sweep=None), tmp_path / "town.ply")
    assert (saved.points, saved.points_of_map) == (5, None)
    assert "mapping did not say how many points" in saved.lines()[-1]
