"""A robot in the map of an earlier run is localized, and the map stays unchanged."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.integration.conftest import Capture, digests, monitor, simulate
from tests.integration.live_run import LOST, LiveRun, beside_command, one_quick, store_command
from zloam_monitor import clouds, se3, trajectory
from zloam_monitor.records import HEALTH

CITY = ("--world", "city", "--seed", "5", "--speed-factor", "1.6")
#: the same streets at a lower speed, and about half of the round
AGAIN = ("--world", "city", "--seed", "5", "--speed-factor", "0.9", "--duration", "40")


@pytest.fixture(scope="module")
def first(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """One round of the block, back to its start."""
    return simulate(build, tmp_path_factory.mktemp("first"), *CITY)


@pytest.fixture(scope="module")
def again(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return simulate(build, tmp_path_factory.mktemp("again"), *AGAIN)


@pytest.fixture(scope="module")
def mapped(build: Path, first: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of the first run, with the stored map in `map`."""
    out = tmp_path_factory.mktemp("mapped")
    where = ("--map", out / "map", "--out", out)
    done = monitor("demo", "--preset-dir", build, "--pcap", first.pcap, *where)
    assert done.code == 0, done.said
    return out


def errors_m(written: Path, driven: Capture, mapped: Capture) -> np.ndarray:
    """Position errors without any alignment: the map's origin is the first pose of the run that
    created it."""
    poses = trajectory.read(written)
    assert poses.stamps_ns is not None
    truth, inside = trajectory.interpolate(trajectory.read(driven.truth_base), poses.stamps_ns)
    origin = trajectory.read(mapped.truth_base).transforms[0]
    in_map = se3.inverse(origin[None])[0] @ truth.transforms
    return np.linalg.norm(poses.positions[inside] - in_map[:, :3, 3], axis=1)


def map_points(folder: Path) -> set[tuple[float, ...]]:
    points = clouds.read_pcd(folder / "map.pcd")
    return {tuple(point) for point in points[["x", "y", "z"]].tolist()}


def localized(build: Path, capture: Capture, mapped: Path, out: Path, *more: str) -> str:
    where = ("--map", mapped / "map", "--localize", "--out", out)
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, *where, *more)
    assert done.code == 0, done.said
    return done.said


def test_it_is_found_where_the_map_was_left_and_the_map_stays(
    build: Path, first: Capture, again: Capture, mapped: Path, tmp_path: Path
) -> None:
    said = localized(build, again, mapped, tmp_path)
    off = errors_m(tmp_path / "trajectory.tum", again, first)
    assert np.sqrt((off[5:] ** 2).mean()) < 0.03, said
    assert off[5:].max() < 0.15, said
    before, after = map_points(mapped), map_points(tmp_path)
    # A mean on the edge of its voxel may be stored in the neighbouring voxel when it is loaded
    # again.
    assert len(before ^ after) < 0.001 * len(before)


@pytest.mark.slow
def test_a_second_time_gives_the_same_bytes(
    build: Path, again: Capture, mapped: Path, tmp_path: Path
) -> None:
    localized(build, again, mapped, tmp_path / "a")
    localized(build, again, mapped, tmp_path / "b")
    files = ("trajectory.tum", "map.pcd")
    assert digests(tmp_path / "a", files) == digests(tmp_path / "b", files)


def test_it_is_found_without_a_hint(
    build: Path, first: Capture, mapped: Path, tmp_path: Path
) -> None:
    """The robot starts with another heading than that with which the map was left."""
    seconds = ("--speed-factor", "0.9", "--duration", "30", "--heading-deg", "130")
    turned = simulate(build, tmp_path, *CITY[:4], *seconds)
    said = localized(build, turned, mapped, tmp_path / "out")
    off = errors_m(tmp_path / "out" / "trajectory.tum", turned, first)
    rows = (tmp_path / "out" / "poses.csv").read_text().splitlines()[1:]
    ok = np.array([row.split(",")[2] == "0" for row in rows])
    # The last pose may lie after the end of the truth.
    assert 0 <= len(ok) - len(off) <= 1
    ok = ok[: len(off)]
    assert not ok[0]
    assert ok.mean() > 0.7, said
    assert off[ok].max() < 0.15, said


@pytest.mark.slow
def test_another_world_is_not_the_map(build: Path, mapped: Path, tmp_path: Path) -> None:
    other = simulate(build, tmp_path, "--world", "indoor", "--seed", "2", "--duration", "20")
    said = localized(build, other, mapped, tmp_path / "out")
    # The line lists lost poses even if there are none.
    assert re.search(r"\b[1-9]\d* lost\b", said), said
    poses = (tmp_path / "out" / "poses.csv").read_text().splitlines()[1:]
    ok = sum(line.split(",")[2] == "0" for line in poses)
    assert ok <= 2, said


def test_maps_are_neither_overwritten_nor_invented(
    build: Path, first: Capture, mapped: Path, tmp_path: Path
) -> None:
    given = ("demo", "--preset-dir", build, "--pcap", first.pcap, "--out", tmp_path / "out")
    over = monitor(*given, "--map", mapped / "map")
    assert over.code == 2
    assert "holds a map already" in over.said
    nothing = monitor(*given, "--map", tmp_path / "none", "--localize")
    assert nothing.code == 2
    assert "holds no map" in nothing.said
    nowhere = monitor(*given, "--localize")
    assert nowhere.code == 2
    assert "--map FOLDER" in nowhere.said


def test_without_a_store_every_pose_is_lost(build: Path, first: Capture, tmp_path: Path) -> None:
    given = ("--pcap", first.pcap, "--set", "mapping.mode=localize", "--out", tmp_path)
    done = monitor("demo", "--preset-dir", build, *given)
    assert "no tile store has a map" in done.said
    poses = (tmp_path / "poses.csv").read_text().splitlines()[1:]
    health = [line.split(",")[2] for line in poses]
    assert set(health[2:]) == {"9"}


def map_info(build: Path, folder: Path) -> dict[str, Any]:
    done = monitor("map", "info", "--preset-dir", build, folder, "--json")
    assert done.code == 0, done.said
    session: dict[str, Any] = json.loads(done.said.strip().splitlines()[-1])["sessions"][0]
    return session


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["localize", "extend"])
def test_a_store_that_comes_late_keeps_its_map(
    build: Path, robot_file: Path, again: Capture, mapped: Path, tmp_path: Path, mode: str
) -> None:
    """As at the boot of a robot whose store reads a large map for longer than mapping waits."""
    folder = shutil.copytree(mapped / "map", tmp_path / "map")
    before = map_info(build, folder)
    out = tmp_path / "out"
    out.mkdir()
    more = (f"mapping.mode={mode}",)
    run = LiveRun(build, robot_file, again, out, store=False, seconds=30.0, more=more)
    graph = beside_command(build, robot_file, run.chain, "graph", f"graph.output_dir={out}")
    run.chain.processes.start("graph", graph, out / "graph.log")

    def says_so() -> bool:
        return any("no tile store has a map" in reason for reason in run.reasons())

    with run:
        run._until(says_so)
        run._until(lambda: any(pose.health == LOST for pose in run.poses.values()))
        command = store_command(build, robot_file, run.chain, folder)
        run.chain.processes.start("store", command, out / "store.log")
        run._until(lambda: list(run.poses.values())[-1].health == HEALTH.index("ok"))
        run._until(lambda: not says_so())
        run.end()
    # The poses before the map came are of no map: the drive has the good name.
    assert len(trajectory.read(out / "trajectory_world.tum")) > 0
    assert not (out / "trajectory_world_2.tum").exists()
    after = map_info(build, folder)
    # Nothing was lost; only an extension may add submaps.
    assert after["submaps"] >= before["submaps"] > 10
    assert after["points"] >= before["points"]
    assert (after["submaps"] == before["submaps"]) or mode == "extend"


@pytest.mark.parametrize("mode", one_quick(("localize", "extend"), "extend"))
def test_a_store_without_a_map_is_named_as_long_as_it_has_none(
    build: Path, robot_file: Path, again: Capture, tmp_path: Path, mode: str
) -> None:
    """Mapping asks it again each second, as with a wrong store.path."""
    run = LiveRun(build, robot_file, again, tmp_path, seconds=12.0, more=(f"mapping.mode={mode}",))

    def says_so() -> bool:
        return any("no tile store has a map" in reason for reason in run.reasons())

    with run:
        run._until(says_so)
        run.wait(4.0)
        assert says_so(), run.reasons()
        run.end()


@pytest.mark.slow
def test_a_map_is_extended_from_where_the_robot_is_found(
    build: Path, first: Capture, mapped: Path, tmp_path: Path
) -> None:
    """The first run drives half of the round, the second all of it and maps what is missing."""
    half = simulate(build, tmp_path, *CITY, "--duration", "25")
    where = ("--map", tmp_path / "map")
    begun = ("demo", "--preset-dir", build, "--pcap", half.pcap, *where, "--out", tmp_path / "a")
    assert monitor(*begun).code == 0
    on = ("demo", "--preset-dir", build, "--pcap", first.pcap, *where, "--out", tmp_path / "b")
    # The robot starts where the first drive began, not where it ended, so it has to be searched
    # for.
    extended = monitor(*on, "--extend")
    assert extended.code == 0, extended.said
    off = errors_m(tmp_path / "b" / "trajectory.tum", first, first)
    assert np.sqrt((off[50:] ** 2).mean()) < 0.05, extended.said
    points = clouds.read_pcd(tmp_path / "b" / "map.pcd")
    before, whole = map_points(tmp_path / "a"), map_points(mapped)
    assert len(points) > 1.3 * len(before)
    assert len(points) > 0.9 * len(whole)
    # The extension was stored, too.
    again = monitor(*on, "--localize")
    assert again.code == 0, again.said
    kept = clouds.read_pcd(tmp_path / "b" / "map.pcd")
    assert abs(len(kept) - len(points)) < 0.01 * len(points)
    # The stored pose is that of the first extension, which has the same run as this one.
    once_more = monitor(*on, "--extend")
    assert once_more.code == 0, once_more.said
    off = errors_m(tmp_path / "b" / "trajectory.tum", first, first)
    assert np.sqrt((off[50:] ** 2).mean()) < 0.05, once_more.said


def test_a_map_is_either_extended_or_left_as_it_is(
    build: Path, first: Capture, mapped: Path, tmp_path: Path
) -> None:
    given = ("demo", "--preset-dir", build, "--pcap", first.pcap, "--out", tmp_path / "out")
    both = monitor(*given, "--map", mapped / "map", "--localize", "--extend")
    assert both.code == 2
    assert "choose one" in both.said
    nothing = monitor(*given, "--map", tmp_path / "none", "--extend")
    assert nothing.code == 2
    assert "holds no map" in nothing.said
