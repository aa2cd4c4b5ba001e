"""Maps of several runs are joined by the places that they share, and exported for other
programs."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from graphslam.load import load_g2o

from tests.integration.conftest import Capture, Done, monitor, simulate
from tests.integration.store_records import append_unknown
from zloam_monitor import clouds, se3, trajectory

CITY = ("--world", "city", "--seed", "5")
#: the same streets with another heading and speed, and only a part of them
AGAIN = (*CITY, "--speed-factor", "1.2", "--heading-deg", "130", "--duration", "25")
ELSEWHERE = ("--world", "indoor", "--seed", "2", "--duration", "25")


def mapped(build: Path, capture: Capture, folder: Path) -> Path:
    """Runs a drive and returns the folder of its map."""
    where = ("--map", folder / "map", "--out", folder / "out")
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, *where)
    assert done.code == 0, done.said
    return folder / "map"


@pytest.fixture(scope="module")
def captures(build: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Capture]:
    root = tmp_path_factory.mktemp("captures")
    drives = {
        "monday": (*CITY, "--speed-factor", "1.6", "--duration", "25"),
        "tuesday": AGAIN,
        "indoor": ELSEWHERE,
    }
    for name in drives:
        (root / name).mkdir()
    return [simulate(build, root / name, *how) for name, how in drives.items()]


@pytest.fixture(scope="module")
def folders(
    build: Path, captures: Sequence[Capture], tmp_path_factory: pytest.TempPathFactory
) -> list[Path]:
    root = tmp_path_factory.mktemp("sessions")
    return [mapped(build, each, root / each.pcap.parent.name) for each in captures]


def map_command(build: Path, *arguments: object) -> Done:
    command, *rest = arguments
    return monitor("map", command, "--preset-dir", build, *rest)


def map_info(build: Path, folder: Path) -> tuple[int, dict[str, Any]]:
    """Exit code, and what `zloam map info --json` says of the only map."""
    done = map_command(build, "info", folder, "--json")
    return done.code, json.loads(done.said.strip().splitlines()[-1])["sessions"][0]


def in_first_map(capture: Capture, first: Capture, stamps_ns: np.ndarray) -> np.ndarray:
    """Truth in the first map's frame: a map's origin is the first pose of its run."""
    truth, inside = trajectory.interpolate(trajectory.read(capture.truth_base), stamps_ns)
    assert inside.all()
    origin = trajectory.read(first.truth_base).transforms[0]
    return se3.inverse(origin[None])[0] @ truth.transforms


def test_two_maps_of_the_same_streets_are_joined(
    build: Path, captures: Sequence[Capture], folders: Sequence[Path], tmp_path: Path
) -> None:
    out = tmp_path / "week"
    done = map_command(build, "merge", folders[0], folders[1], "--out", out)
    assert done.code == 0, done.said
    assert "between two maps" in done.said
    report = json.loads((out / "sessions.json").read_text())
    assert [each["joined"] for each in report["sessions"]] == [True, True]
    assert sum(each["from_session"] != each["to_session"] for each in report["loops"]) >= 3
    for number, capture in enumerate(captures[:2], 1):
        poses = trajectory.read(out / f"submaps_{number}.tum")
        assert poses.stamps_ns is not None
        truth = in_first_map(capture, captures[0], poses.stamps_ns)
        off = np.linalg.norm(poses.positions - truth[:, :3, 3], axis=1)
        assert off.max() < 0.05, (number, off.max())
    single = monitor("map", "export", "--preset-dir", build, folders[0], tmp_path / "one.pcd")
    assert single.code == 0, single.said
    # Both runs saw the same walls: the joined map has few new voxels.
    both, one = (clouds.read_pcd(p) for p in (out / "map.pcd", tmp_path / "one.pcd"))
    assert len(both) > len(one) > 1000


def test_a_map_of_another_place_is_left_out_and_said_so(
    build: Path, folders: Sequence[Path], tmp_path: Path
) -> None:
    out = tmp_path / "both"
    done = map_command(build, "merge", folders[0], folders[2], "--out", out)
    assert done.code == 1
    assert "shares too little with the other maps" in done.said
    report = json.loads((out / "sessions.json").read_text())
    assert [each["joined"] for each in report["sessions"]] == [True, False]
    assert len(clouds.read_pcd(out / "map.pcd")) == report["sessions"][0]["points"]


def test_what_is_exported_others_can_read(
    build: Path, folders: Sequence[Path], tmp_path: Path
) -> None:
    said = map_command(build, "info", folders[0])
    assert said.code == 0, said.said
    assert "submaps" in said.said
    for name in ("town.laz", "town.g2o", "town.tum"):
        done = map_command(build, "export", folders[0], tmp_path / name)
        assert done.code == 0, done.said
    assert len(laspy.read(tmp_path / "town.laz").points) > 1000
    graph = load_g2o(str(tmp_path / "town.g2o"))
    poses = trajectory.read(tmp_path / "town.tum")
    assert len(graph._vertices) == len(poses)
    assert len(graph._edges) >= len(poses) - 1
    # The poses fit the factors, also by another library's computation.
    assert graph.calc_chi2() < 6.0 * len(graph._edges)


def test_a_damaged_map_is_told_and_what_is_left_of_it_is_used(
    build: Path, folders: Sequence[Path], tmp_path: Path
) -> None:
    code, whole = map_info(build, folders[0])
    assert code == 0
    damaged = tmp_path / "map"
    shutil.copytree(folders[0], damaged)
    log = max(damaged.iterdir(), key=lambda path: path.stat().st_size)
    with log.open("r+b") as file:
        file.seek(log.stat().st_size * 3 // 4)
        (byte,) = file.read(1)
        file.seek(-1, os.SEEK_CUR)
        file.write(bytes([byte ^ 1]))
    code, left = map_info(build, damaged)
    assert code == 1
    assert 0 < left["submaps"] < whole["submaps"]
    assert left["unread_bytes"] > 0
    assert (left["damaged"], whole["damaged"]) == (True, False)
    merged = map_command(build, "merge", folders[1], damaged, "--out", tmp_path / "both")
    assert merged.code == 1, merged.said
    told = f"{left['unread_bytes']} bytes and {left['unread_files']} files"
    assert f"{damaged} is damaged: {told}" in merged.said


def test_a_record_of_a_later_version_is_told(
    build: Path, folders: Sequence[Path], tmp_path: Path
) -> None:
    copy = tmp_path / "map"
    shutil.copytree(folders[0], copy)
    append_unknown(copy)
    code, left = map_info(build, copy)
    assert code == 1
    assert (left["unread_bytes"], left["unread_records"], left["damaged"]) == (0, 1, True)
    done = map_command(build, "info", copy)
    assert "records of an unknown format: 1" in done.said


def test_a_file_that_is_missing_is_named(
    build: Path, folders: Sequence[Path], tmp_path: Path
) -> None:
    """A copy that broke off: the newest files are there, the first one is not."""
    copy = tmp_path / "map"
    copy.mkdir()
    (copy / "00000002.log").write_bytes((folders[0] / "00000001.log").read_bytes())
    done = map_command(build, "info", copy)
    assert done.code == 1
    assert "00000001.base" in done.said


def test_a_map_without_submaps_leads_to_no_key_that_does_not_exist(
    build: Path, tmp_path: Path
) -> None:
    (tmp_path / "00000001.log").touch()
    done = map_command(build, "info", tmp_path)
    assert done.code == 3
    assert "has no submaps" in done.said
    command = [str(build / "bin" / "zloam-mapping"), "--describe-config"]
    described = subprocess.run(command, capture_output=True, text=True, check=True)
    assert all(key in described.stdout for key in re.findall(r"mapping\.\w+", done.said))


def test_nothing_is_left_of_a_merge_that_could_not_be_written(
    build: Path, folders: Sequence[Path], tmp_path: Path
) -> None:
    """A limit of 64 KiB per file, which only the points exceed, is like a full disk."""
    out = tmp_path / "merged"
    limited = ["bash", "-c", 'trap "" XFSZ; ulimit -f 64; exec "$@"', "-"]
    merge = [build / "bin" / "zloam-sessions", folders[0], "--out", out]
    command = [*limited, *map(str, merge)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert "map.pcd" in done.stderr
    assert not out.exists()


def test_a_folder_may_have_a_name_that_is_no_utf8(
    build: Path, folders: Sequence[Path], tmp_path: Path
) -> None:
    odd, out = tmp_path / os.fsdecode(b"stra\xdfe"), tmp_path / "out"
    shutil.copytree(folders[0], odd)
    command = [build / "bin" / "zloam-sessions", odd, "--quiet", "--out", out]
    done = subprocess.run(list(map(str, command)), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads((out / "sessions.json").read_text(encoding="utf-8"))
    assert report["sessions"][0]["folder"].endswith("stra\ufffde")


def test_mistakes_are_told(build: Path, folders: Sequence[Path], tmp_path: Path) -> None:
    none = map_command(build, "info", tmp_path)
    assert none.code == 3
    assert "holds no map" in none.said
    unknown = map_command(build, "export", folders[0], tmp_path / "map.xyz")
    assert unknown.code == 2
    assert ".g2o or .tum is expected" in unknown.said
    taken = map_command(build, "merge", folders[0], folders[1], "--out", folders[0])
    assert taken.code == 3
    assert "name a new folder" in taken.said
    shutil.copytree(folders[0], tmp_path / "copy")
    for same in (folders[0], tmp_path / "copy"):
        twice = map_command(build, "merge", folders[0], same, "--out", tmp_path / "twice")
        assert twice.code == 3
        assert f"{folders[0]} and {same} are one map" in twice.said
        assert not (tmp_path / "twice").exists()
