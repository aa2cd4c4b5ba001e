"""Checks grids and tiles like their readers: map_server's formula on an image read by Pillow; YAML
and PCD read by other libraries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image
from pypcd4 import PointCloud

from zloam_monitor import cli, map_exports, maps
from zloam_monitor.maps import MapError, PointMap
from zloam_monitor.messages import MAP_POINT

Array = NDArray[np.float64]


def map_of(xyz: Array) -> PointMap:
    points = np.zeros(len(xyz), MAP_POINT)
    points["x"], points["y"], points["z"] = xyz.T
    return PointMap(points, np.ones(len(xyz), np.uint8))


def hill(x: Array, y: Array) -> Array:
    return np.asarray(0.06 * x - 0.03 * y + 5.0)


@pytest.fixture
def yard() -> PointMap:
    """A slope from (-20, 100) to (20, 140), a wall along x = 4, and a roof 3 m above a corner."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-20, 20, 0.4), np.arange(100, 140, 0.4)))
    ground = np.column_stack([x, y, hill(x, y)])
    wy, wz = (a.ravel() for a in np.meshgrid(np.arange(105, 135, 0.2), np.arange(0.1, 2.5, 0.2)))
    wall = np.column_stack([np.full(len(wy), 4.05), wy, hill(np.full(len(wy), 4.05), wy) + wz])
    roof = ground[(x < -10) & (y < 110)] + [0.0, 0.0, 3.0]
    return map_of(np.concatenate([ground, wall, roof]))


def seen_at(path: Path, x: float, y: float) -> int:
    """Value of the cell in map_server's mode trinary: 100 occupied, 0 free, -1 unknown."""
    described = yaml.safe_load(path.read_text())
    image = np.asarray(Image.open(path.parent / described["image"]).convert("L"), float)
    left, low, turn = described["origin"]
    assert turn == 0.0
    column = int((x - left) / described["resolution"])
    row = image.shape[0] - 1 - int((y - low) / described["resolution"])
    occupied = (255.0 - image[row, column]) / 255.0
    if occupied > described["occupied_thresh"]:
        return 100
    return 0 if occupied < described["free_thresh"] else -1


def test_a_grid_is_what_map_server_reads(yard: PointMap, tmp_path: Path) -> None:
    maps.write(tmp_path / "map.pcd", yard)
    grid = tmp_path / "grid.yaml"
    assert cli.main(["map", "grid", str(tmp_path / "map.pcd"), str(grid)]) == 0
    for y in np.arange(106.0, 134.0, 0.7):
        assert seen_at(grid, 4.05, y) == 100, y
        assert seen_at(grid, 6.0, y) == 0, y
        assert seen_at(grid, 2.0, y) == 0, y
    # The robot can drive under a roof.
    assert seen_at(grid, -15.0, 105.0) == 0


def test_what_was_not_seen_is_unknown(yard: PointMap, tmp_path: Path) -> None:
    apart = yard.kept(np.hypot(yard.points["x"] - 10.0, yard.points["y"] - 120.0) > 3.0)
    grid = map_exports.occupancy(apart, 0.2, (0.2, 2.0))
    map_exports.write_grid(tmp_path / "grid.yaml", grid)
    assert seen_at(tmp_path / "grid.yaml", 10.0, 120.0) == -1
    assert seen_at(tmp_path / "grid.yaml", 15.0, 120.0) == 0


def test_a_stray_point_below_the_ground_is_no_ground(yard: PointMap, tmp_path: Path) -> None:
    stray = map_of(np.array([[10.0, 120.0, hill(np.array(10.0), np.array(120.0)) - 4.0]]))
    both = PointMap(
        np.concatenate([yard.points, stray.points]), np.concatenate([yard.layers, stray.layers])
    )
    map_exports.write_grid(tmp_path / "g.yaml", map_exports.occupancy(both, 0.2, (0.2, 2.0)))
    assert seen_at(tmp_path / "g.yaml", 10.3, 120.3) == 0


def test_tiles_are_what_autoware_reads(yard: PointMap, tmp_path: Path) -> None:
    maps.write(tmp_path / "map.pcd", yard)
    out = tmp_path / "autoware"
    assert cli.main(["map", "autoware", str(tmp_path / "map.pcd"), str(out)]) == 0
    assert yaml.safe_load((out / "map_projector_info.yaml").read_text()) == {
        "projector_type": "Local"
    }
    described = yaml.safe_load((out / "pointcloud_map_metadata.yaml").read_text())
    wide, high = described.pop("x_resolution"), described.pop("y_resolution")
    files = {p.name for p in (out / "pointcloud_map.pcd").iterdir()}
    assert files == set(described)
    total = 0
    for name, (x, y) in described.items():
        tile = PointCloud.from_path(out / "pointcloud_map.pcd" / name).pc_data
        assert len(tile) > 0
        assert ((tile["x"] >= x) & (tile["x"] < x + wide)).all()
        assert ((tile["y"] >= y) & (tile["y"] < y + high)).all()
        total += len(tile)
    assert total == len(yard)


def test_what_cannot_be_is_said(yard: PointMap, tmp_path: Path) -> None:
    with pytest.raises(MapError, match="--cell: 0 m"):
        map_exports.occupancy(yard, 0.0, (0.2, 2.0))
    with pytest.raises(MapError, match="a larger --cell"):
        map_exports.occupancy(yard, 1e-3, (0.2, 2.0))
    with pytest.raises(MapError, match="--height: 2 to 1 m"):
        map_exports.occupancy(yard, 0.2, (2.0, 1.0))
    grid = map_exports.occupancy(yard, 0.2, (0.2, 2.0))
    with pytest.raises(MapError, match=r"\.yaml is expected"):
        map_exports.write_grid(tmp_path / "grid.png", grid)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.txt").write_text("mine")
    with pytest.raises(MapError, match="exists already"):
        map_exports.write_autoware(tmp_path / "there", yard, 20.0)
    with pytest.raises(MapError, match="no points"):
        map_exports.write_autoware(tmp_path / "none", yard.kept(np.array([], np.int64)), 20.0)


@pytest.mark.parametrize("edge", ["inf", "nan", "-1", "1e-12", "1e-300"])
@pytest.mark.parametrize("command", ["grid grid.yaml --cell", "autoware town --tile"])
def test_no_edge_of_a_cell_ends_in_a_stack_trace(
    yard: PointMap,
    tmp_path: Path,
    command: str,
    edge: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nor in a map of other tiles: numbers of cells have 64 bits."""
    maps.write(source := tmp_path / "map.pcd", yard)
    verb, to, option = command.split()
    assert cli.main(["map", verb, str(source), str(tmp_path / to), option, edge]) == 2
    assert f"{option}: " in (said := capsys.readouterr().err) or "larger --cell" in said
    assert "RuntimeWarning" not in said
    assert list(tmp_path.iterdir()) == [source]


def test_no_cube_is_too_small_to_be_counted(yard: PointMap) -> None:
    assert len(maps.thinned(yard, 1e-6)) == len(np.unique(yard.xyz, axis=0))
    with pytest.raises(MapError, match="--voxel: 1e-20 m is too small"):
        maps.thinned(yard, 1e-20)


def test_a_folder_for_autoware_is_whole_or_not_there(
    yard: PointMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupted command can be repeated: nothing is left that it would refuse to replace."""
    written: list[Path] = []

    def interrupted(path: Path, found: PointMap) -> None:
        written.append(path)
        if len(written) == 3:
            raise KeyboardInterrupt
        maps.write(path, found)

    monkeypatch.setattr(map_exports, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        map_exports.write_autoware(tmp_path / "town", yard, 20.0)
    assert not list(tmp_path.iterdir())
    (tmp_path / "town").mkdir()
    assert map_exports.write_autoware(tmp_path / "town", yard, 20.0) > 1
    assert sorted(path.name for path in (tmp_path / "town").iterdir()) == [
        "map_projector_info.yaml",
        "pointcloud_map.pcd",
        "pointcloud_map_metadata.yaml",
    ]
