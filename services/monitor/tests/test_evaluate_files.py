"""`zloam evaluate` joins files line by line only where the lines belong together; what is left out
of a file is reported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from test_evaluation import loop
from zloam_monitor import cli, evaluation, trajectory
from zloam_monitor.trajectory import Trajectory


def part(of: Trajectory, rows: np.ndarray) -> Trajectory:
    assert of.stamps_ns is not None
    return Trajectory(of.transforms[rows], of.stamps_ns[rows], np.arange(len(rows)))


def files(folder: Path, estimate: Trajectory, truth: Trajectory) -> dict[str, Path]:
    """Both as TUM and as KITTI."""
    found = {}
    for name, poses in (("estimate", estimate), ("truth", truth)):
        for suffix, write in (("tum", trajectory.write_tum), ("kitti", trajectory.write_kitti)):
            found[f"{name}.{suffix}"] = folder / f"{name}.{suffix}"
            write(found[f"{name}.{suffix}"], poses)
    return found


def run(*words: object) -> int:
    return cli.main([str(word) for word in words])


FORMS = [("tum", "kitti"), ("kitti", "tum"), ("kitti", "kitti")]


@pytest.mark.parametrize(("of_estimate", "of_truth"), FORMS)
def test_another_rate_is_refused_without_times(
    tmp_path: Path, of_estimate: str, of_truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    fine = loop(1001)
    made = files(tmp_path, part(fine, np.arange(0, 1001, 10)), fine)
    estimate, truth = made[f"estimate.{of_estimate}"], made[f"truth.{of_truth}"]
    assert run("evaluate", estimate, truth) == 1
    said = capsys.readouterr()
    assert (said.out, f"{estimate}, {truth}: " in said.err) == ("", True)
    assert "they have 101 and 1001 poses: give both with times (TUM)" in said.err
    # With times the same files have no error.
    assert run("evaluate", made["estimate.tum"], made["truth.tum"], "--json") == 0
    assert json.loads(capsys.readouterr().out)["ate_rmse_m"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("of_estimate", "of_truth"), [("tum", "kitti"), ("kitti", "tum")])
def test_a_hole_is_refused_even_if_the_numbers_are_equal(
    tmp_path: Path, of_estimate: str, of_truth: str, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = loop(1001)
    holed, shorter = part(whole, np.r_[0:400, 401:1001]), part(whole, np.arange(1000))
    pair = (holed, shorter) if of_estimate == "tum" else (shorter, holed)
    made = files(tmp_path, *pair)
    assert run("evaluate", made[f"estimate.{of_estimate}"], made[f"truth.{of_truth}"]) == 1
    assert "a step of 0.04 s where 0.02 s are usual" in capsys.readouterr().err


@pytest.mark.parametrize(("of_estimate", "of_truth"), FORMS)
def test_files_of_the_same_sweeps_are_joined(
    tmp_path: Path, of_estimate: str, of_truth: str
) -> None:
    made = files(tmp_path, loop(1001), loop(1001))
    assert run("evaluate", made[f"estimate.{of_estimate}"], made[f"truth.{of_truth}"]) == 0


def test_lines_with_a_stamp_of_another_line_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, whole = tmp_path / "twice.tum", tmp_path / "once.tum"
    trajectory.write_tum(whole, loop(50))
    lines = whole.read_text().splitlines()
    path.write_text("\n".join([*lines, *lines[:3]]) + "\n")
    reported = f"{path}: 3 lines with a stamp that another line has were left out"
    for words in (
        ("evaluate", path, whole),
        ("evaluate", whole, path),
        ("trajectory", path, tmp_path / "new.csv"),
    ):
        assert run(*words) == 0
        assert reported in capsys.readouterr().err
    assert run("evaluate", whole, whole) == 0
    assert capsys.readouterr().err == ""


def test_a_plot_is_drawn_of_what_the_figures_are_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files of a long drive are joined and aligned once."""
    aligned: list[int] = []
    align = evaluation._alignment

    def counted(positions: evaluation.Array, onto: evaluation.Array) -> evaluation.Array | None:
        aligned.append(len(positions))
        return align(positions, onto)

    monkeypatch.setattr(evaluation, "_alignment", counted)
    drive = loop(101)
    made = files(tmp_path, drive, drive)
    plot = tmp_path / "errors.png"
    assert run("evaluate", made["estimate.tum"], made["truth.tum"], "--plot", plot) == 0
    assert plot.is_file()
    assert aligned == [101]
