"""Tests the comparison of two runs, and the file for support."""

from __future__ import annotations

import contextlib
import csv
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fake_session import FakeSession
from zloam_monitor import (
    cli,
    comparison,
    compose,
    discovery,
    html_report,
    messages,
    pose_table,
    support,
    trajectory,
)
from zloam_monitor.link import Link, LinkError
from zloam_monitor.records import HEALTH, PoseRecord
from zloam_monitor.trajectory import Trajectory, TrajectoryError


def drive(count: int = 50, off_m: float = 0.0, begin_ns: int = 10**18) -> Trajectory:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.arange(count) * 0.5
    poses[:, 1, 3] = off_m
    return Trajectory(poses, begin_ns + np.arange(count, dtype=np.int64) * 10**8)


def a_run(folder: Path, poses: Trajectory, **more: Any) -> Path:
    folder.mkdir(parents=True)
    trajectory.write_tum(folder / "trajectory.tum", poses)
    report = {"identities": {"sweeps": 50, "poses": 50, "given_up": {}}, "path_m": 24.5, **more}
    (folder / "report.json").write_text(json.dumps(report))
    return folder


def test_how_far_they_are_apart(tmp_path: Path) -> None:
    first = comparison.read(a_run(tmp_path / "a", drive(), cpu_ms_per_sweep={"mapping": 10.0}))
    second = comparison.read(a_run(tmp_path / "b", drive(40, 0.25), wall_s=3.0))
    said = comparison.lines(comparison.compared(first, second))
    assert said[0] == (
        "trajectories: 0.2500 m apart (rms), at most 0.2500 m and 0.000 deg, "
        "at 40 common instants of 50 and 40 poses"
    )
    assert any(line.split() == ["CPU", "of", "mapping,", "ms", "10.0", "–"] for line in said)
    assert any(line.split() == ["wall", "time,", "s", "–", "3.0"] for line in said)
    assert comparison.lines(comparison.compared(first, first))[0] == "trajectories: the same poses"


def test_recordings_of_different_times_have_nothing_in_common(tmp_path: Path) -> None:
    first = comparison.read(a_run(tmp_path / "a", drive()))
    second = comparison.read(a_run(tmp_path / "b", drive(begin_ns=2 * 10**18)))
    assert "no instant in common" in comparison.lines(comparison.compared(first, second))[0]
    assert cli.main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 1
    assert cli.main(["compare", str(tmp_path / "a"), str(tmp_path / "a")]) == 0


def test_equal_positions_are_not_the_same_poses(tmp_path: Path) -> None:
    """Neither with other headings, nor if the runs overlap in a part of their instants only."""
    first = comparison.read(a_run(tmp_path / "a", drive()))
    turned = drive()
    turned.transforms[:, :3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    late = drive(60)
    assert late.stamps_ns is not None
    late = Trajectory(late.transforms[10:], late.stamps_ns[10:])
    for name, poses, said in (
        ("b", turned, "0.0000 m and 90.000 deg, at 50 common instants of 50 and 50 poses"),
        ("c", late, "0.0000 m and 0.000 deg, at 40 common instants of 50 and 50 poses"),
    ):
        found = comparison.compared(first, comparison.read(a_run(tmp_path / name, poses)))
        assert not found.same_poses
        assert comparison.lines(found)[0].endswith(said)


def test_the_poses_of_the_reported_run_are_compared(tmp_path: Path) -> None:
    """After a second run in one folder, trajectory.tum has the poses of the first."""
    twice = a_run(tmp_path / "a", drive(30, 7.0), trajectory_file="trajectory_2.tum")
    trajectory.write_tum(twice / "trajectory_2.tum", drive(50))
    once = a_run(tmp_path / "b", drive(50))
    found = comparison.compared(comparison.read(twice), comparison.read(once))
    assert found.same_poses


def test_what_is_no_run_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(TrajectoryError, match=r"report\.json: No such file"):
        comparison.read(tmp_path)
    (tmp_path / "report.json").write_text("[1, 2")
    assert cli.main(["compare", str(tmp_path), str(tmp_path)]) == 3
    assert "report.json: cannot be read" in capsys.readouterr().err


def test_a_trajectory_becomes_a_table(tmp_path: Path) -> None:
    trajectory.write_tum(tmp_path / "a.tum", drive(3))
    assert cli.main(["trajectory", str(tmp_path / "a.tum"), str(tmp_path / "a.csv")]) == 0
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "time_s,x_m,y_m,z_m,qx,qy,qz,qw,number"
    assert lines[2].startswith("1000000000.100000000,0.500000000,0.000000000,")
    assert lines[2].endswith(",1")
    assert cli.main(["trajectory", str(tmp_path / "a.tum"), str(tmp_path / "a.kitti")]) == 0
    assert len((tmp_path / "a.kitti").read_text().splitlines()) == 3


def pose_of_sweep(sweep: int, instant_ns: int, covariance: tuple[float, ...]) -> PoseRecord:
    return PoseRecord(
        run=1,
        sweep=sweep,
        instant_ns=instant_ns,
        translation=np.zeros(3),
        quaternion=np.array([0.0, 0.0, 0.0, 1.0]),
        health=HEALTH.index("degenerate"),
        last_packet_ns=0,
        end_of_run=False,
        trace=(),
        covariance=covariance,
    )


def test_a_table_of_a_run_has_covariances_and_is_read_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second of three poses is missing in the run's own table."""
    trajectory.write_tum(tmp_path / "a.tum", drive(3))
    poses = {
        sweep: pose_of_sweep(
            sweep, 1_000_000_000_000_000_000 + sweep * 100_000_000, tuple(range(36))
        )
        for sweep in (0, 2)
    }
    pose_table.write(tmp_path / "poses.csv", poses)
    assert cli.main(["trajectory", str(tmp_path / "a.tum"), str(tmp_path / "a.csv")]) == 0
    assert "3 poses, 2 with covariances of" in capsys.readouterr().out
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["health"] for row in rows] == ["degenerate", "", "degenerate"]
    assert [float(rows[2][f"c{i}{j}"]) for i in range(6) for j in range(6)] == list(range(36))
    trajectory.write_kitti(tmp_path / "b.kitti", drive(3))
    assert cli.main(["trajectory", str(tmp_path / "b.kitti"), str(tmp_path / "b.csv")]) == 0
    # Without instants nothing is found, but each line has all columns.
    assert len({line.count(",") for line in (tmp_path / "b.csv").read_text().splitlines()}) == 1
    back, whole = trajectory.read(tmp_path / "a.csv"), trajectory.read(tmp_path / "a.tum")
    np.testing.assert_array_equal(back.stamps_ns, whole.stamps_ns)
    np.testing.assert_allclose(back.transforms, whole.transforms, atol=2e-9)


def test_an_unknown_covariance_is_no_zero(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A-LOAM's poses have none, and a zero would say that they are exact."""
    trajectory.write_tum(tmp_path / "a.tum", drive(3))
    stamps = trajectory.read(tmp_path / "a.tum").stamps_ns
    assert stamps is not None
    poses = {n: pose_of_sweep(n, int(stamp), ()) for n, stamp in enumerate(stamps)}
    pose_table.write(tmp_path / "poses.csv", poses)
    said = np.genfromtxt(tmp_path / "poses.csv", delimiter=",", names=True)
    assert np.isnan(said["c00"]).all()
    assert np.isnan(said["c55"]).all()
    assert cli.main(["trajectory", str(tmp_path / "a.tum"), str(tmp_path / "a.csv")]) == 0
    assert "3 poses, 0 with covariances of" in capsys.readouterr().out
    assert len(trajectory.read(tmp_path / "a.csv")) == 3
    assert "have no covariance" in html_report.sigma_chart(tmp_path / "poses.csv")


def test_a_table_without_times_is_no_trajectory(tmp_path: Path) -> None:
    """Otherwise its positions would be taken for times."""
    trajectory.write_kitti(tmp_path / "a.kitti", drive(3))
    assert cli.main(["trajectory", str(tmp_path / "a.kitti"), str(tmp_path / "a.csv")]) == 0
    with pytest.raises(TrajectoryError, match="line 2: a cell without a number"):
        trajectory.read(tmp_path / "a.csv")


@pytest.mark.parametrize("to", ["a.txt", "a"])
def test_another_ending_is_refused(
    tmp_path: Path, to: str, capsys: pytest.CaptureFixture[str]
) -> None:
    trajectory.write_tum(tmp_path / "a.tum", drive(3))
    assert cli.main(["trajectory", str(tmp_path / "a.tum"), str(tmp_path / to)]) == 2
    assert ".tum, .kitti, .csv is expected" in capsys.readouterr().err


def test_the_file_for_support_holds_no_geometry(tmp_path: Path) -> None:
    run = a_run(tmp_path / "run", drive(), remarks=["the product byte lies"])
    (run / "map.pcd").write_text("points")
    (run / "logs").mkdir()
    (run / "logs" / "driver.log").write_text("driver: started\n")
    (tmp_path / "my.yaml").write_text("robot: robot\n")
    robots = [{"robot": "robot", "statuses": {}}]
    names = support.write(tmp_path / "s.zip", run, tmp_path / "my.yaml", robots)
    with zipfile.ZipFile(tmp_path / "s.zip") as made:
        assert made.testzip() is None
        assert set(made.namelist()) == set(names) == {
            "machine.json", "report.json", "logs/driver.log", "robot/my.yaml", "live/0.json"
        }  # fmt: skip
        report = json.loads(made.read("report.json"))
        assert report["remarks"] == ["the product byte lies"]
        assert "path_m" not in report
        assert json.loads(made.read("machine.json"))["processors"] >= 1


def test_a_folder_of_nothing_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "s.zip"
    words = ["support", str(tmp_path), "--out", str(out), "--connect", "tcp/127.0.0.1:1"]
    assert cli.main(words) == 3
    assert "neither report.json nor logs" in capsys.readouterr().err
    assert cli.main(["support", str(tmp_path / "none"), "--out", str(out), *words[4:]]) == 3
    assert not out.exists()


def collected(folder: Path, *words: str) -> tuple[int, dict[str, bytes]]:
    """(exit code, contents) of the command's file for the run in this folder."""
    out = folder / "s.zip"
    code = cli.main(["support", str(folder / "run"), "--out", str(out), *words])
    with zipfile.ZipFile(out) as made:
        return code, {name: made.read(name) for name in made.namelist()}


def test_an_address_at_which_nothing_answers_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a_run(tmp_path / "run", drive())
    code, made = collected(tmp_path, "--connect", "tcp/127.0.0.1:1")
    assert code == 1
    assert "nothing answers at tcp/127.0.0.1:1" in capsys.readouterr().err
    assert "nothing answers" in json.loads(made["live/0.json"])["error"]
    assert "report.json" in made


def test_a_robot_that_vanishes_does_not_cost_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))

    def linked_to(found: discovery.Found) -> Any:
        if found.robot == "gone":
            raise LinkError("no link to the stages: it left")
        session: Any = FakeSession()
        if found.robot == "here":
            key = session.keys.below("service/mapping/mapping-1/status")
            session.rounds[key] = [[compose.status("mapping", 1, 1, None, [], {}, False)]]
        return contextlib.nullcontext(Link(session, session.keys, newest=0))

    robots = [discovery.Found(name, "tcp/h:1", ()) for name in ("gone", "mute", "here")]
    monkeypatch.setattr(discovery, "robots", lambda *_: robots)
    monkeypatch.setattr(discovery, "linked_to", linked_to)
    a_run(tmp_path / "run", drive())
    code, made = collected(tmp_path)
    told = [json.loads(made[f"live/{n}.json"]) for n in range(3)]
    assert told[0]["error"] == "no link to the stages: it left"
    assert told[1]["error"] == "it was found, but no stage gave its status"
    assert "error" not in told[2]
    assert list(told[2]["statuses"]) == ["mapping"]
    said = capsys.readouterr().err
    assert (code, "gone: no link" in said, "mute: it was found" in said) == (1, True, True)
    assert "here" not in said


@pytest.mark.parametrize("text", ["[1, 2]", "null", '{"remarks": ["a"],\n"path_m": 3.5,\n'])
def test_a_report_that_is_none_is_included_as_it_is(tmp_path: Path, text: str) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "report.json").write_text(text)
    support.write(tmp_path / "s.zip", tmp_path / "run")
    with zipfile.ZipFile(tmp_path / "s.zip") as made:
        found = made.read("report.json").decode()
    assert found == text.replace('"path_m": 3.5,\n', "")
