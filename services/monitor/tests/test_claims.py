"""A run replaces only files of an earlier run, and never its own inputs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from zloam_monitor import claims, cli
from zloam_monitor.claims import NotOurs, claim

NAMES = ("trajectory.tum", "logs/driver.log")
PATTERNS = ("trajectory_[0-9]*.tum", "logs/*.log")


@pytest.fixture(autouse=True)
def _let_go() -> None:
    claims.let_go()


def a_run(folder: Path, further: tuple[str, ...] = ()) -> None:
    """Claims, writes and records files, as another process would."""
    with claim(folder, NAMES, patterns=PATTERNS) as run:
        run.begin()
        (folder / "logs").mkdir(exist_ok=True)
        for name in (*NAMES, *further):
            (folder / name).write_text("ours")
    claims.let_go()


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of the folder, without this program's own lock."""
    found = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()}
    return {name: path.read_bytes() for name, path in found.items() if name != claims.LOCK}


def test_what_an_earlier_run_made_is_removed(tmp_path: Path) -> None:
    a_run(tmp_path, ("trajectory_2.tum", "logs/mapping-standby.log"))
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "logs/mine.log").write_text("mine")
    with claim(tmp_path, NAMES, patterns=PATTERNS) as run:
        run.begin()
        assert set(contents(tmp_path)) == {"notes.txt", "logs/mine.log", claims.MARKER}


def test_a_run_that_does_not_begin_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    a_run(tmp_path, ("trajectory_2.tum",))
    before = contents(tmp_path)
    with claim(tmp_path, (*NAMES, "map.pcd"), (), PATTERNS):
        assert not (tmp_path / "trajectory.tum").exists()
        for name in ("trajectory.tum", "map.pcd", "logs/mapping-standby.log"):
            (tmp_path / name).write_text("of the attempt")
    assert contents(tmp_path) == before


def test_a_start_that_was_killed_loses_nothing(tmp_path: Path) -> None:
    a_run(tmp_path)
    before = contents(tmp_path)
    claim(tmp_path, NAMES, patterns=PATTERNS)
    (tmp_path / "trajectory.tum").write_text("of the attempt")
    claims.let_go()  # As by SIGKILL: nothing was put back.
    with claim(tmp_path, NAMES, patterns=PATTERNS):
        pass
    assert contents(tmp_path) == before


def test_what_was_set_aside_is_not_deleted_if_its_list_is_spoilt(tmp_path: Path) -> None:
    a_run(tmp_path)
    claim(tmp_path, NAMES, patterns=PATTERNS)
    before = tmp_path / claims.BEFORE
    (before / claims.MARKER).write_bytes(b"")
    claims.let_go()  # As by a power failure.
    for _ in range(2):
        with pytest.raises(NotOurs, match=f"{before}.* can't be read"):
            claim(tmp_path, NAMES, patterns=PATTERNS)
    assert (before / "trajectory.tum").read_text() == "ours"
    shutil.rmtree(before)
    with claim(tmp_path, NAMES, patterns=PATTERNS):
        pass


def test_a_first_start_that_fails_keeps_its_logs(tmp_path: Path) -> None:
    with claim(tmp_path, NAMES):
        (tmp_path / "logs").mkdir()
        (tmp_path / "logs/driver.log").write_text("why")
    assert (tmp_path / "logs/driver.log").read_text() == "why"
    (tmp_path / "trajectory.tum").write_text("mine")
    with pytest.raises(NotOurs, match=r"trajectory\.tum"):
        claim(tmp_path, NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_what_no_run_made_stays(tmp_path: Path, name: str) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / name).write_text("mine")
    with pytest.raises(NotOurs, match=name):
        claim(tmp_path, NAMES)
    assert (tmp_path / name).read_text() == "mine"


def test_what_was_changed_since_is_another_ones(tmp_path: Path) -> None:
    a_run(tmp_path)
    (tmp_path / "trajectory.tum").write_text("mine now")
    with pytest.raises(NotOurs, match=r"trajectory\.tum"):
        claim(tmp_path, NAMES)
    assert (tmp_path / "logs/driver.log").exists(), "refused as a whole"


def test_a_link_is_never_ours(tmp_path: Path) -> None:
    a_run(tmp_path)
    (tmp_path / "trajectory.tum").unlink()
    target = tmp_path / "target"
    target.write_text("mine")
    (tmp_path / "trajectory.tum").symlink_to(target)
    with pytest.raises(NotOurs):
        claim(tmp_path, NAMES)
    assert target.read_text() == "mine"


def test_an_input_is_never_replaced(tmp_path: Path) -> None:
    a_run(tmp_path, ("trajectory_2.tum",))
    with pytest.raises(NotOurs, match="input of this run"):
        claim(tmp_path, NAMES, [tmp_path / "logs" / ".." / "trajectory.tum"])
    claim(tmp_path, NAMES, [tmp_path / "trajectory_2.tum"], PATTERNS)
    assert (tmp_path / "trajectory_2.tum").exists()


def test_a_run_that_was_killed_leaves_files_that_are_ours(tmp_path: Path) -> None:
    claim(tmp_path, NAMES)
    (tmp_path / "trajectory.tum").write_text("half")
    claims.let_go()
    claim(tmp_path, NAMES)
    assert not (tmp_path / "trajectory.tum").exists()


def test_a_spoilt_marker_marks_nothing(tmp_path: Path) -> None:
    a_run(tmp_path)
    for text in ("", "{", "[]", '{"trajectory.tum": 5}', '{"trajectory.tum": ["a"]}', "\0"):
        (tmp_path / claims.MARKER).write_text(text)
        with pytest.raises(NotOurs):
            claim(tmp_path, NAMES)


def test_two_runs_at_a_time_do_not_share_a_folder(tmp_path: Path) -> None:
    claim(tmp_path, NAMES)
    other = (
        "import pathlib, sys; from zloam_monitor.claims import claim; "
        "claim(pathlib.Path(sys.argv[1]), [])"
    )
    done = subprocess.run(
        [sys.executable, "-c", other, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(claims.__file__).parents[1],
    )
    assert "another run writes here" in done.stderr


def test_a_demo_refuses_before_it_starts_anything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ground_truth.tum").write_text("".join(f"{i} {i} 0 0 0 0 0 1\n" for i in range(5)))
    (tmp_path / "drive.pcap").write_text("x")
    arguments = ["demo", "--pcap", f"{tmp_path}/drive.pcap", "--out", str(tmp_path)]
    code = cli.main([*arguments, "--truth", f"{tmp_path}/ground_truth.tum"])
    assert code == 3
    assert "is an input of this run" in capsys.readouterr().err
    assert cli.main(arguments) == 3
    assert "ground_truth.tum" in capsys.readouterr().err
    assert {p.name for p in tmp_path.iterdir()} >= {"ground_truth.tum", "drive.pcap"}
