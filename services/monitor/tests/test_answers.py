"""Answers as JSON are one line on standard output, with the contents of the text for a person."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from PIL import Image

from test_support import a_run, drive
from zloam_monitor import answers, cli, maps, trajectory
from zloam_monitor.maps import PointMap
from zloam_monitor.messages import MAP_POINT


def asked(
    capsys: pytest.CaptureFixture[str], *words: str | Path
) -> tuple[int, dict[str, Any], str]:
    """(exit code, answer, standard error) of a command that prints exactly one line of JSON."""
    code = cli.main([*map(str, words), "--json"])
    said = capsys.readouterr()
    (line,) = said.out.splitlines()
    return code, json.loads(line), said.err


@dataclass(frozen=True)
class Part:
    where: Path
    far_m: float


def test_what_json_does_not_know() -> None:
    data = {"a": Part(Path("x/y"), float("nan")), "b": np.array([1.5, np.inf]), 3: (np.int64(4),)}
    assert json.loads(answers.text(data)) == {
        "a": {"where": "x/y", "far_m": None},
        "b": [1.5, None],
        "3": [4],
    }


def test_errors_of_a_trajectory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    estimate, truth, picture = (tmp_path / name for name in ("e.tum", "t.tum", "errors.png"))
    swaying = drive(60)
    swaying.transforms[:, 2, 3] += np.where(np.arange(60) % 2, 0.1, -0.1)
    trajectory.write_tum(estimate, swaying)
    trajectory.write_tum(truth, drive(60))
    code, said, aside = asked(capsys, "evaluate", estimate, truth, "--plot", picture)
    assert code == 0
    assert said["matched"] == 60
    assert said["ate_rmse_m"] == pytest.approx(0.1, abs=1e-3)
    assert f"{picture}: written" in aside
    with Image.open(picture) as drawn:
        assert drawn.width > 1000
        assert len(set(np.asarray(drawn.convert("L")).ravel().tolist())) > 50


def test_no_errors_no_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    estimate, truth, picture = (tmp_path / name for name in ("e.tum", "t.tum", "errors.png"))
    trajectory.write_tum(estimate, drive(60))
    trajectory.write_tum(truth, drive(60, begin_ns=2 * 10**18))
    code, said, _ = asked(capsys, "evaluate", estimate, truth, "--plot", picture)
    assert (code, said["ate_rmse_m"]) == (1, None)
    assert "fewer than 3 poses" in said["remark"]
    assert not picture.exists()


def test_what_a_picture_can_not_be_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A PDF would be a PNG by another name, and numbers that are none have no errors."""
    path = tmp_path / "e.tum"
    trajectory.write_tum(path, drive(10))
    mounting = ["--mounting", "nan", "0", "0", "0", "0", "0"]
    for more, said in (
        (["--plot", str(tmp_path / "e.pdf")], "e.pdf: .png is expected"),
        (mounting, "--mounting: finite numbers are expected"),
    ):
        assert cli.main(["evaluate", str(path), str(path), *more]) == 2
        assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [path]


def test_any_name_is_a_picture_s_title(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, name in enumerate((b"a$\\x$.tum", b"stra\xdfe.tum")):
        path, picture = tmp_path / os.fsdecode(name), tmp_path / f"{number}.png"
        trajectory.write_tum(path, drive(10))
        assert asked(capsys, "evaluate", path, path, "--plot", picture)[0] == 0
        assert picture.is_file()


def test_two_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [a_run(tmp_path / name, drive(50, off)) for name, off in (("a", 0.0), ("b", 0.25))]
    code, said, _ = asked(capsys, "compare", *runs)
    assert (code, said["same_poses"], said["instants"]) == (0, False, 50)
    assert said["rms_m"] == pytest.approx(0.25)
    assert said["figures"]["sweeps"] == [50.0, 50.0]


def test_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = np.zeros(4, MAP_POINT)
    points["x"] = [0.0, 1.0, 2.0, 3.0]
    file = tmp_path / "map.ply"
    maps.write(file, PointMap(points, np.array([0, 1, 1, 1], np.uint8)))
    code, said, _ = asked(capsys, "map", "info", file)
    assert (code, said["points"], said["layers"]) == (0, 4, {"edge": 1, "plane": 3})
    assert said["limits"]["x_m"] == [0.0, 3.0]
    assert cli.main(["map", "info", str(file)]) == 0
    assert "x: 0.00 to 3.00 m" in capsys.readouterr().out


def test_a_mistake_is_told_beside_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compare", str(tmp_path), str(tmp_path), "--json"]) == 3
    said = capsys.readouterr()
    assert said.out == ""
    assert "No such file" in said.err


def with_json(group: Any, before: str = "") -> set[str]:
    """Commands with the option --json, from the whole tree."""
    found = set()
    for name, each in group.commands.items():
        if hasattr(each, "commands"):
            found |= with_json(each, f"{name} ")
        elif any("--json" in parameter.opts for parameter in each.params):
            found.add(before + name)
    return found


def test_the_readme_lists_the_commands_that_answer_so() -> None:
    text = (Path(__file__).parents[1] / "README.md").read_text()
    listed = text.split("one per update:")[1].split(". Names")[0]
    assert set(re.findall(r"`([^`]+)`", listed)) == with_json(typer.main.get_command(cli.app))


@pytest.mark.parametrize(
    ("report", "code"),
    [
        ("[" * 200_000, 3),
        ('{"cpu_ms_per_sweep": null, "health": {"counts": {"ok": "x"}}}', 0),
        ('{"identities": {"given_up": {"a": "b"}}, "health": {"counts": {"ok": [1]}}}', 0),
        ('\ufeff{"path_m": 3}', 0),
    ],
)
def test_a_damaged_report_is_compared_or_named(
    tmp_path: Path, report: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, other = (a_run(tmp_path / name, drive(50)) for name in ("a", "b"))
    (other / "report.json").write_text(report, encoding="utf-8")
    for runs in ((whole, other), (other, whole)):
        assert cli.main(["compare", *map(str, runs)]) == code
        said = capsys.readouterr()
        named = f"{other / 'report.json'}: "
        assert named in said.err if code else "the same poses" in said.out
