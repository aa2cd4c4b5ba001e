"""Which folders --map accepts: new ones for a map, and those with one for --localize, --extend."""

from __future__ import annotations

from pathlib import Path

import pytest

from zloam_monitor import cli
from zloam_monitor.beside_stages import Beside, BesideError

#: Kind of a folder -> its files.
NO_MAPS = {
    "results": {"map.pcd": b"x", "report.json": b"{}", "logs/00000001.log": b"x"},
    "opened store": {"lock": b"", "00000001.log": b""},
    "other files": {"readme.log": b"x", "2026-11-01.log": b"x", "notes.base": b"x"},
}
MAPS = {"log": {"lock": b"", "00000003.log": b"x"}, "base": {"00000002.base": b"x"}}


def made(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


@pytest.mark.parametrize("files", NO_MAPS.values(), ids=NO_MAPS)
@pytest.mark.parametrize("option", ["--localize", "--extend"])
def test_a_folder_without_a_map_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], files: dict[str, bytes], option: str
) -> None:
    folder = made(tmp_path / "map", files)
    words = ["demo", "--map", str(folder), option, "--out", str(tmp_path / "out")]
    assert cli.main(words) != 0
    assert f"{folder} holds no map" in capsys.readouterr().err
    left = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert left == files
    with pytest.raises(BesideError, match="is not empty, but holds no map"):
        Beside(False, folder)


@pytest.mark.parametrize("files", MAPS.values(), ids=MAPS)
def test_a_folder_with_a_map_is_used_but_not_overwritten(
    tmp_path: Path, files: dict[str, bytes]
) -> None:
    folder = made(tmp_path / "map", files)
    assert Beside(False, folder, localize=True).mode == "localize"
    assert Beside(False, folder, extend=True).mode == "extend"
    with pytest.raises(BesideError, match="holds a map already"):
        Beside(False, folder)


def test_a_new_or_empty_folder_is_for_a_new_map(tmp_path: Path) -> None:
    assert Beside(False, tmp_path).mode == "map"
    assert Beside(False, tmp_path / "new").mode == "map"
