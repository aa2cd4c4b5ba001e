"""Files that appear whole, and failures that name them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from zloam_monitor import cli, clouds, files, sessions
from zloam_monitor.failures import Misuse
from zloam_monitor.maps import MapError
from zloam_monitor.messages import MAP_POINT


@pytest.fixture
def merged(tmp_path: Path) -> sessions.Merged:
    folder = tmp_path / "merged"
    folder.mkdir()
    for name in sessions.COPIED.values():
        (folder / name).write_text(f"contents of {name}\n")
    return sessions.Merged(folder, {"sessions": [{"submaps": 3}]}, complete=True)


def full_disk(path: Path) -> Path:
    """A file whose temporary file is on a full disk."""
    path.with_name(path.name + ".part").symlink_to("/dev/full")
    return path


def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    path = full_disk(tmp_path / "map.pcd")
    told = pytest.raises(OSError, match=rf"No space left on device: '{path}'")
    with told, files.written_whole(path, "wb") as out:
        out.write(b"points")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", sessions.COPIED)
def test_what_zloam_sessions_wrote_is_copied_whole(
    merged: sessions.Merged, tmp_path: Path, suffix: str
) -> None:
    to = tmp_path / "new" / f"town{suffix}"
    assert sessions.export(merged, to, 0.2) == "3 poses"
    assert to.read_text() == f"contents of {sessions.COPIED[suffix]}\n"
    full = full_disk(tmp_path / f"full{suffix}")
    with pytest.raises(OSError, match=f"full{suffix}"):
        sessions.export(merged, full, 0.2)
    assert not full.exists()


def test_a_merge_that_was_killed_is_told_with_its_signal(tmp_path: Path) -> None:
    """As where memory ran out, of which zloam-sessions itself says nothing."""
    program = tmp_path / "bin" / "zloam-sessions"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\nkill -KILL $$\n")
    program.chmod(0o755)
    with pytest.raises(sessions.SessionsError, match="signal SIGKILL: no map was written") as told:
        sessions.merge(tmp_path, [tmp_path], tmp_path / "week", quiet=True)
    assert told.value.exit_code == 1


def test_intensities_that_las_does_not_hold_are_named(
    merged: sessions.Merged, tmp_path: Path
) -> None:
    points = np.zeros(2, MAP_POINT)
    points["x"], points["intensity"] = [0.0, 5.0], [0.25, 1.0]
    clouds.write_pcd(merged.folder / sessions.POINTS, points, np.ones(2, np.uint8))
    assert "are rounded to whole numbers" in sessions.export(merged, tmp_path / "town.las", 0.2)
    assert sessions.export(merged, tmp_path / "town.ply", 0.2) == "2 points"


def test_what_can_not_be_exported_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("zloam-sessions was started")

    monkeypatch.setattr(sessions, "opened", never)
    for to, more, said in (
        ("town.xyz", (), "town.xyz: .pcd, .ply, .las, .laz, .g2o or .tum is expected"),
        ("town.pcd", ("--voxel", "0"), "--voxel: 0 m is no edge of a cube"),
    ):
        assert cli.main(["map", "export", str(tmp_path), str(tmp_path / to), *more]) == 2
        assert said in capsys.readouterr().err
    with pytest.raises(Misuse):
        sessions.exportable(Path("town"), 0.2)
    with pytest.raises(MapError):
        sessions.exportable(Path("town.las"), float("nan"))
    with pytest.raises(Misuse, match=r"--voxel: town\.g2o gets poses"):
        sessions.exportable(Path("town.g2o"), 0.5)


@pytest.mark.parametrize("kind", ["folder", "device", "pipe"])
def test_only_files_are_replaced(tmp_path: Path, kind: str) -> None:
    """A command of root would put a file in the place of /dev/null."""
    path = tmp_path / "x.csv"
    if kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/null")
    else:
        os.mkfifo(path)
    refused = pytest.raises(FileExistsError, match=f"There already, .*'{path}'")
    with refused, files.written_whole(path) as out:
        out.write("x")
    assert list(tmp_path.iterdir()) == [path]
    assert not path.is_file()


def test_a_file_behind_a_link_stays(tmp_path: Path) -> None:
    path, other = tmp_path / "x.csv", tmp_path / "other.csv"
    other.write_text("of somebody")
    path.symlink_to(other)
    with files.written_whole(path) as out:
        out.write("x")
    assert (path.read_text(), other.read_text()) == ("x", "of somebody")


def test_a_name_that_is_no_text_is_escaped(tmp_path: Path) -> None:
    """A report names the recording, which may have any name."""
    with files.written_whole(tmp_path / "report.html") as out:
        out.write(os.fsdecode(b"stra\xdfe") + " ß")
    assert (tmp_path / "report.html").read_bytes() == "stra\\udcdfe ß".encode()
