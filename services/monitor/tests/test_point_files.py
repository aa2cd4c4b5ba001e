"""A file of points that was cut off anywhere is refused, never read as a smaller one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pytest

from zloam_monitor import cli, clouds
from zloam_monitor.messages import MAP_POINT
from zloam_monitor.point_files import READERS

COUNT = 20
#: Bytes of a record of LAS's point format 6 (LAS 1.4, table 14).
LAS_RECORD = 30


def binary(path: Path) -> int:
    clouds.write_pcd(path, np.zeros(COUNT, MAP_POINT), np.zeros(COUNT, np.uint8))
    return clouds.LAYERED_POINT.itemsize


def ascii_pcd(path: Path, count: int = COUNT) -> int:
    path.write_text(
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA ascii\n"
        + "1 2 3\n"
        * count
    )
    return len("1 2 3\n")


def las(path: Path) -> int:
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.x, cloud.y, cloud.z = np.zeros((3, COUNT))
    cloud.write(path)
    return LAS_RECORD


CUT = (("a.pcd", binary), ("b.pcd", ascii_pcd), ("a.las", las), ("a.laz", las))


@pytest.mark.parametrize(("name", "write"), CUT)
def test_a_file_cut_off_between_two_points(
    tmp_path: Path,
    name: str,
    write: Callable[[Path], int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / name
    record = write(path)
    assert len(READERS[path.suffix](path)[0]) == COUNT
    whole = path.read_bytes()
    for missing in (1, COUNT - 1):
        path.write_bytes(whole[: len(whole) - missing * record])
        assert cli.main(["map", "info", str(path)]) == 3
        assert f"{path}: cannot be read" in (said := capsys.readouterr().err)
        if path.suffix != ".laz":  # Its library finds the end of the compressed data missing.
            assert f"{COUNT - missing} of the {COUNT} points that its header names" in said


def test_one_point_is_a_cloud(tmp_path: Path) -> None:
    ascii_pcd(tmp_path / "a.pcd", 1)
    points, _, _ = READERS[".pcd"](tmp_path / "a.pcd")
    assert points["y"].tolist() == [2.0]


HEAD = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\n"


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        *((f"a{suffix}", "", "is empty") for suffix in READERS),
        # As many lines as no memory holds; the reader once asked for each of them.
        ("a.ply", HEAD.format(10**15) + "end_header\n1\n", f"not {10**15} lines of 1 numbers"),
        ("a.ply", "ply\nformat\nend_header\n", "its header has a line 'format'"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex\n", "a line 'element vertex'"),
        ("a.ply", HEAD.format(1) + "property float\nend_header\n1\n", "a line 'property float'"),
    ],
)
def test_a_header_that_can_not_be(
    tmp_path: Path, name: str, text: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_text(text)
    assert cli.main(["map", "info", str(path)]) == 3
    assert why in capsys.readouterr().err
