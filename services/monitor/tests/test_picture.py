"""The picture can be drawn for any run, also for one without data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenes import city_scene
from zloam_monitor import clouds, picture
from zloam_monitor.messages import MAP_POINT

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize("with_truth", [True, False])
def test_picture_of_a_loop(tmp_path: Path, with_truth: bool) -> None:
    picture.draw(tmp_path / "p.png", city_scene(with_truth))
    assert (tmp_path / "p.png").read_bytes().startswith(PNG)
    assert list(tmp_path.iterdir()) == [tmp_path / "p.png"]


def test_picture_of_nothing(tmp_path: Path) -> None:
    empty = picture.Scene("nothing", np.empty(0, MAP_POINT), np.empty((0, 3)), np.empty(0))
    picture.draw(tmp_path / "p.png", empty)
    assert (tmp_path / "p.png").read_bytes().startswith(PNG)


def test_pcd_round_trip_in_the_order_of_tiles(tmp_path: Path) -> None:
    def tile(layer: str, index: tuple[int, int, int], x: float) -> clouds.Tile:
        points = np.zeros(2, MAP_POINT)
        points["x"] = [x, x + 1]
        return clouds.Tile(layer, index, 1, points)

    tiles = [
        tile("plane", (1, 0, 0), 30),
        tile("edge", (1, 0, 0), 20),
        tile("plane", (0, 5, 0), 10),
    ]
    points, layers = clouds.merged(tiles)
    clouds.write_pcd(tmp_path / "m.pcd", points, layers)
    read = clouds.read_pcd(tmp_path / "m.pcd")
    np.testing.assert_array_equal(read["x"], [10, 11, 20, 21, 30, 31])
    np.testing.assert_array_equal(read["layer"], [1, 1, 0, 0, 1, 1])
