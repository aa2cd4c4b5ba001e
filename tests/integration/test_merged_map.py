"""A merged map is used like the map of a run: a robot is localized in it where either drive was,
and it is extended, exported and merged again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.integration.conftest import Capture, Done, digests, monitor, simulate
from zloam_monitor import clouds, se3, trajectory

#: Corners of the block, in the order of the drives.
SOUTH_WEST, SOUTH_EAST, NORTH_EAST, NORTH_WEST = (-60, -35), (60, -35), (60, 35), (-60, 35)
#: What the drives share is the street in the east.
MONDAY = [(-25, -35), SOUTH_EAST, (60, 40)]
TUESDAY = [(60, -40), NORTH_EAST, NORTH_WEST, (-60, -5)]
#: Begins where only Tuesday's drive was, and ends where only Monday's was.
WEDNESDAY = [(-60, 12), NORTH_WEST, NORTH_EAST, SOUTH_EAST, (5, -35)]
#: A car drives along the southern street on Monday, 3 m beside the robot's way.
CAR_Y_M = -32.0
#: Results of a merge, besides the submaps' poses.
FILES = ("00000001.log", "map.pcd", "graph.g2o", "sessions.json")


def beside_the_way(centre: np.ndarray, reach_m: float) -> bool:
    """No part of a house stands in a street."""
    ring = np.array([SOUTH_WEST, SOUTH_EAST, NORTH_EAST, NORTH_WEST, SOUTH_WEST], dtype=float)
    for begin, end in pairwise(ring):
        way = end - begin
        share = np.clip((centre - begin) @ way / (way @ way), -0.2, 1.2)
        if np.linalg.norm(centre - begin - share * way) < reach_m + 4.5:
            return False
    return True


def houses() -> Iterator[dict[str, Any]]:
    """Along all streets, none like another."""
    random = np.random.default_rng(7)
    while True:
        centre = random.uniform((-90, -65), (90, 65))
        size = random.uniform((3.0, 3.0, 5.0), (11.0, 9.0, 14.0))
        yaw_deg = random.uniform(-20.0, 20.0)
        if not beside_the_way(centre, 0.5 * float(np.hypot(size[0], size[1]))):
            continue
        yield {
            "kind": "box",
            "centre": [*centre.round(3).tolist(), 2.0],
            "size": size.round(3).tolist(),
            "rpy_deg": [0, 0, round(yaw_deg, 2)],
            "reflectivity": 60,
        }


def write_world(folder: Path, way: Sequence[tuple[int, int]]) -> Path:
    """The town with a drive along this way."""
    stream = houses()
    ground = {"kind": "box", "centre": [0, 0, -0.5], "size": [260, 200, 1], "reflectivity": 25}
    body = {"kind": "box", "centre": [0, 0, 0.8], "size": [4.2, 1.7, 1.2], "reflectivity": 50}
    world: dict[str, Any] = {
        "path": {"points": [list(p) for p in way], "corner_radius_m": 8, "smoothing_m": 3},
        "drive": {"max_speed_m_s": 7, "height_m": 1.9, "roll_deg": 0.5, "pitch_deg": 0.5},
        "shapes": [ground, *(next(stream) for _ in range(90))],
    }
    if way is MONDAY:
        track = [[85, CAR_Y_M], [-85, CAR_Y_M]]
        world["movers"] = [{"points": track, "speed_m_s": 12, "shapes": [body]}]
    file = folder / "town.yaml"
    file.write_text(yaml.safe_dump(world), encoding="utf-8")
    return file


@dataclass(frozen=True)
class Week:
    """Three drives, the maps of the first two, and the merged one."""

    monday: Capture
    tuesday: Capture
    wednesday: Capture
    maps: tuple[Path, Path]
    merged: Path
    said: str


def drive(build: Path, folder: Path, way: Sequence[tuple[int, int]], *more: str) -> Capture:
    folder.mkdir()
    return simulate(build, folder, "--world", str(write_world(folder, way)), *more)


def demo(build: Path, capture: Capture, out: Path, *more: object) -> Done:
    where = ("--pcap", capture.pcap, "--out", out)
    done = monitor("demo", "--preset-dir", build, *where, *more)
    assert done.code == 0, done.said
    return done


def map_command(build: Path, command: str, *arguments: object) -> Done:
    return monitor("map", command, "--preset-dir", build, *arguments)


@pytest.fixture(scope="module")
def week(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Week:
    root = tmp_path_factory.mktemp("week")
    monday = drive(build, root / "monday", MONDAY, "--seed", "1")
    tuesday = drive(build, root / "tuesday", TUESDAY, "--seed", "2", "--heading-deg", "40")
    wednesday = drive(build, root / "wednesday", WEDNESDAY, "--seed", "3")
    for name, capture in (("monday", monday), ("tuesday", tuesday)):
        demo(build, capture, root / name / "out", "--map", root / name / "map")
    maps = (root / "monday" / "map", root / "tuesday" / "map")
    done = map_command(build, "merge", *maps, "--out", root / "merged")
    assert done.code == 0, done.said
    return Week(monday, tuesday, wednesday, maps, root / "merged", done.said)


@dataclass(frozen=True)
class Localized:
    """Poses of a run in a map, compared with the simulator's truth in the frame of that map,
    without any alignment: its origin is the first pose of Monday's drive."""

    truth: np.ndarray
    off_m: np.ndarray
    ok: np.ndarray

    def rms_m(self) -> float:
        return float(np.sqrt((self.off_m[self.ok] ** 2).mean()))


def judged(week: Week, driven: Capture, out: Path) -> Localized:
    poses = trajectory.read(out / "trajectory.tum")
    assert poses.stamps_ns is not None
    truth, inside = trajectory.interpolate(trajectory.read(driven.truth_base), poses.stamps_ns)
    origin = trajectory.read(week.monday.truth_base).transforms[0]
    in_map = se3.inverse(origin[None])[0] @ truth.transforms
    off_m = np.linalg.norm(poses.positions[inside] - in_map[:, :3, 3], axis=1)
    rows = (out / "poses.csv").read_text().splitlines()[1:]
    ok = np.array([row.split(",")[2] == "0" for row in rows])[inside]
    return Localized(truth.positions, off_m, ok)


def judged_in(week: Week, build: Path, driven: Capture, folder: Path, out: Path) -> Localized:
    demo(build, driven, out, "--map", folder, "--localize")
    return judged(week, driven, out)


def in_the_car(week: Week, points: np.ndarray) -> int:
    """Number of map points where the car drove, above the street and beside no house."""
    origin = trajectory.read(week.monday.truth_base).transforms[0]
    at = np.stack([points["x"], points["y"], points["z"]], axis=1).astype(float)
    world = at @ origin[:3, :3].T + origin[:3, 3]
    swept = np.abs(world[:, 1] - CAR_Y_M) < 1.2
    return int((swept & (np.abs(world[:, 0]) < 70) & (world[:, 2] > 0.5)).sum())


def test_a_robot_is_localized_where_either_drive_was(
    build: Path, week: Week, tmp_path: Path
) -> None:
    """Without a pose to begin with: Tuesday's drive ended elsewhere."""
    found = judged_in(week, build, week.wednesday, week.merged, tmp_path / "merged")
    north_west = (found.truth[:, 0] < 0) & (found.truth[:, 1] > 0)
    south = found.truth[:, 1] < -30
    assert north_west.sum() > 50
    assert south.sum() > 50
    print(f"ATE {found.rms_m():.4f} m, max {found.off_m[found.ok].max():.4f} m")
    assert found.ok[north_west].mean() > 0.7
    assert found.ok[south].mean() > 0.98
    assert found.rms_m() < 0.05
    assert found.off_m[found.ok].max() < 0.15
    # Only Tuesday's drive has been there.
    alone = judged_in(week, build, week.wednesday, week.maps[0], tmp_path / "alone")
    assert alone.ok[north_west].mean() < 0.3
    # Most of the car is in Monday's own map only. What is left was hit as often as seen through.
    own = in_the_car(week, clouds.read_pcd(tmp_path / "alone" / "map.pcd"))
    both = in_the_car(week, clouds.read_pcd(tmp_path / "merged" / "map.pcd"))
    print(f"points of the car: {both} in the merged map, {own} in Monday's")
    assert own > 200
    assert both < own / 3


def test_the_same_maps_give_the_same_files(build: Path, week: Week, tmp_path: Path) -> None:
    done = map_command(build, "merge", *week.maps, "--out", tmp_path / "again")
    assert done.code == 0, done.said
    assert digests(tmp_path / "again", FILES) == digests(week.merged, FILES)


def test_it_is_extended_exported_and_merged_again(build: Path, week: Week, tmp_path: Path) -> None:
    folder = tmp_path / "map"
    shutil.copytree(week.merged, folder)
    before = json.loads((folder / "sessions.json").read_text())["sessions"]
    info = map_command(build, "info", folder, "--json")
    assert info.code == 0, info.said
    (told,) = json.loads(info.said.strip().splitlines()[-1])["sessions"]
    assert told["submaps"] == sum(each["submaps"] for each in before)
    exported = map_command(build, "export", folder, tmp_path / "town.laz")
    assert exported.code == 0, exported.said
    for one in week.maps:
        twice = map_command(build, "merge", folder, one, "--out", tmp_path / "twice")
        assert twice.code == 3, twice.said
        assert "hold the same drive" in twice.said
    demo(build, week.wednesday, tmp_path / "out", "--map", folder, "--extend")
    found = judged(week, week.wednesday, tmp_path / "out")
    assert found.ok.mean() > 0.7
    assert found.rms_m() < 0.05
    grown = map_command(build, "info", folder, "--json")
    assert grown.code == 0, grown.said
    (after,) = json.loads(grown.said.strip().splitlines()[-1])["sessions"]
    assert after["submaps"] > told["submaps"]
    # A drive that is in neither.
    other = drive(build, tmp_path / "other", MONDAY, "--seed", "4", "--heading-deg", "90")
    demo(build, other, tmp_path / "other" / "out", "--map", tmp_path / "other" / "map")
    both = (week.merged, tmp_path / "other" / "map")
    more = map_command(build, "merge", *both, "--out", tmp_path / "more")
    assert more.code == 0, more.said
    report = json.loads((tmp_path / "more" / "sessions.json").read_text())
    assert [each["joined"] for each in report["sessions"]] == [True, True]


def test_a_map_that_is_not_joined_is_not_in_it(build: Path, week: Week, tmp_path: Path) -> None:
    """What is left is a map of one drive, in which it is localized."""
    elsewhere = ("--world", "indoor", "--seed", "2", "--duration", "25")
    (tmp_path / "indoor").mkdir()
    other = simulate(build, tmp_path / "indoor", *elsewhere)
    demo(build, other, tmp_path / "indoor" / "out", "--map", tmp_path / "indoor" / "map")
    maps = (week.maps[0], tmp_path / "indoor" / "map")
    done = map_command(build, "merge", *maps, "--out", tmp_path / "both")
    assert done.code == 1, done.said
    submaps = json.loads((tmp_path / "both" / "sessions.json").read_text())["sessions"]
    info = map_command(build, "info", tmp_path / "both", "--json")
    (told,) = json.loads(info.said.strip().splitlines()[-1])["sessions"]
    assert told["submaps"] == submaps[0]["submaps"]
    found = judged_in(week, build, week.monday, tmp_path / "both", tmp_path / "out")
    assert found.ok.mean() > 0.7
    assert found.rms_m() < 0.05
