"""A row of the acceptance is held only by what was run for it, to its end."""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from tests.acceptance import accuracy, benches, consistency, doctor, flags, framework, worlds
from tests.acceptance.framework import Check, Result, Skip
from tests.acceptance.runs import Setting, is_newer
from tests.acceptance.seen import Seen
from tests.integration.robot_faults import FAULTS
from zloam_monitor import trajectory
from zloam_monitor.trajectory import Trajectory

RIGHT = 1.0
TESTCASE = {
    "held": '<testcase name="{0}"/>',
    "failed": '<testcase name="{0}"><failure message="wrong"/></testcase>',
    "skipped": '<testcase name="{0}"><skipped message="no tool"/></testcase>',
}


def path(factor: float, poses: int = 400) -> Trajectory:
    """A bend of 400 poses, scaled."""
    angle = np.linspace(0.0, 2.0, 400)[:poses]
    transforms = np.tile(np.eye(4), (poses, 1, 1))
    transforms[:, 0, 3] = 50.0 * factor * np.sin(angle)
    transforms[:, 1, 3] = 50.0 * factor * (1.0 - np.cos(angle))
    stamps_ns = 10**18 + np.arange(poses) * 10**8
    return Trajectory(transforms, stamps_ns, np.arange(poses))


def write_results(out: Path, poses: Trajectory, matched: int = 400) -> None:
    """The files of a demo, with poses that hold each limit; so many of them have a truth."""
    out.mkdir(parents=True, exist_ok=True)
    trajectory.write_tum(out / "trajectory.tum", poses)
    cells = [f"c{i}{j}" for i in range(6) for j in range(6)]
    columns = ["sweep", "instant_ns", "health", "degenerate", "weak_x", "weak_y", "weak_z"]
    covariance = ["1" if cell[1] == cell[2] else "0" for cell in cells]
    assert poses.stamps_ns is not None
    rows = [[*map(str, (n, t, 0, 0, 0, 0, 0)), *covariance] for n, t in enumerate(poses.stamps_ns)]
    lines = [",".join(row) for row in [[*columns, *cells], *rows]]
    (out / "poses.csv").write_text("\n".join(lines) + "\n")
    errors = {"ate_rmse_m": 0.0, "drift_percent": 0.0, "poses": len(poses), "matched": matched}
    references = {"gt_dense.tum": {"pose": errors}}
    (out / "report.json").write_text(json.dumps({"references": references}))


@dataclass
class Fake(Setting):
    """A setting whose programs are stand-ins: `zloam demo` ends with `code` after `poses` poses;
    with None it is refused before it writes anything."""

    code: int = 0
    poses: int | None = 400
    #: poses of the truth
    known: int = 400
    calls: list[str] = field(default_factory=list)

    def python(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        words = [str(word) for word in arguments]
        self.calls.append(" ".join(words))
        if self.poses is not None:
            out = Path(words[words.index("--out") + 1])
            write_results(out, path(RIGHT, self.poses), self.known)
        return subprocess.CompletedProcess(words, self.code, "a stage has died\n")

    def simulated(self, world: str, seed: int) -> tuple[Path, Path]:
        capture, truth = self.out / "world.pcap", self.out / "world.tum"
        trajectory.write_tum(truth, path(RIGHT, self.known))
        trajectory.write_tum(capture.with_suffix(".kiss.tum"), path(1.01))
        return capture, truth

    def synth_folder(self, scene: str = "city") -> Path:
        return self.out / scene


ROWS = ("kiss-city-1", "step-moving-4", "flat-z-flat-1", "flags-city-1", "nees-position-city")
ROWS_OF_REPORT = ("world-city-1", "synth-ate-city")


def result_of(setting: Setting, name: str) -> Result:
    made: list[Check] = [
        check for part in (accuracy, worlds, flags, consistency) for check in part.checks(setting)
    ]
    return framework.run(next(check for check in made if check.name == name))


@pytest.mark.parametrize("name", [*ROWS, *ROWS_OF_REPORT])
@pytest.mark.parametrize("poses", [30, None])
def test_a_demo_that_failed_holds_no_row(tmp_path: Path, name: str, poses: int | None) -> None:
    """Neither by the poses until it failed, nor by those of an earlier session."""
    for world in ("world-city-1", "world-flat-1", "world-moving-4", "synth-city"):
        write_results(tmp_path / "accept" / world, path(RIGHT))
    for seed in consistency.SEEDS:
        write_results(tmp_path / "accept" / f"world-city-{seed}", path(RIGHT))
    found = result_of(Fake(tmp_path, tmp_path, tmp_path, code=1, poses=poses), name)
    assert (found.verdict, "exit code 1" in found.figure) == (framework.NOT_HELD, True)


@pytest.mark.parametrize("name", [row for row in (*ROWS, *ROWS_OF_REPORT) if "nees" not in row])
def test_a_demo_that_ended_well_holds_them(tmp_path: Path, name: str) -> None:
    assert result_of(Fake(tmp_path, tmp_path, tmp_path), name).verdict == framework.HELD


@pytest.mark.parametrize("name", [row for row in (*ROWS, *ROWS_OF_REPORT) if "flags" not in row])
def test_an_error_of_a_part_of_the_poses_holds_no_row(tmp_path: Path, name: str) -> None:
    """As of poses with wrong stamps, of which only a few lie within the truth."""
    found = result_of(Fake(tmp_path, tmp_path, tmp_path, known=350), name)
    assert found.verdict == framework.NOT_HELD
    assert "only 350 of 400 poses have a truth" in found.figure


@dataclass
class Peer(Setting):
    """A KISS-ICP that ends with 1 after these words."""

    said: str = ""

    def python(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess([], 1, self.said)


def test_a_peer_is_passed_over_only_where_it_is_not_installed(tmp_path: Path) -> None:
    missing = "ModuleNotFoundError: No module named 'kiss_icp'\n"
    with pytest.raises(Skip, match="kiss_icp"):
        Peer(tmp_path, tmp_path, tmp_path, said=missing).kiss(tmp_path)
    with pytest.raises(RuntimeError, match="no numbers"):
        Peer(tmp_path, tmp_path, tmp_path, said="ValueError: no numbers\n").kiss(tmp_path)


def test_what_an_older_program_made_is_made_again(tmp_path: Path) -> None:
    program, made = tmp_path / "program", tmp_path / "made"
    program.touch()
    assert not is_newer(made, program)
    made.touch()
    assert is_newer(made, program)
    os.utime(program, ns=(2 * made.stat().st_mtime_ns,) * 2)
    assert not is_newer(made, program)


def test_no_file_of_an_earlier_demo_is_left(tmp_path: Path) -> None:
    write_results(tmp_path / "accept" / "drive", path(RIGHT))
    demo = Fake(tmp_path, tmp_path, tmp_path, code=2, poses=None).demo("drive")
    assert [each.name for each in demo.out.iterdir()] == ["demo.log"]


@dataclass
class Bench(Setting):
    """A benchmark that ends with `code` and leaves these rows, or no report."""

    code: int = 0
    rows: tuple[str, ...] | None = None

    def python(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        if self.rows is not None:
            write_bench(Path(str(arguments[-1])), self.rows)
        return subprocess.CompletedProcess([], self.code, "ImportError: velodyne_decoder\n")


def write_bench(out: Path, names: tuple[str, ...]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    rows = [{"name": name, "figure": "3 ms", "verdict": "held"} for name in names]
    (out / "report.json").write_text(json.dumps({"benchmarks": rows}))


@pytest.mark.parametrize(
    ("code", "rows"),
    [(1, None), (0, ()), (0, ("decode-pcap",)), (-9, ("transport-shm",)), (2, None)],
)
def test_a_benchmark_that_did_not_run_holds_nothing(
    tmp_path: Path, code: int, rows: tuple[str, ...] | None
) -> None:
    write_bench(tmp_path / "accept/bench/transport-shm", ("transport-shm",))
    with pytest.raises(RuntimeError, match="ImportError"):
        benches._measure(Bench(tmp_path, tmp_path, tmp_path, code=code, rows=rows), "transport-shm")


def test_a_benchmark_that_ran_is_taken_over(tmp_path: Path) -> None:
    setting = Bench(tmp_path, tmp_path, tmp_path, rows=("transport-shm",))
    assert benches._measure(setting, "transport-shm").held


def seen(folder: Path, *kinds: str) -> Seen:
    cases = "".join(TESTCASE[kind].format(f"{kind}_{n}") for n, kind in enumerate(kinds))
    (folder / "pytest.xml").write_text(f"<testsuites><testsuite>{cases}</testsuite></testsuites>")
    found = Seen()
    found.read(folder / "pytest.xml")
    return found


def test_a_skipped_test_holds_no_row(tmp_path: Path) -> None:
    with pytest.raises(Skip, match="skipped_1: no tool"):
        seen(tmp_path, "held", "skipped").judged("1 of 2")
    assert not seen(tmp_path, "held", "skipped", "failed").judged("1 of 3").held
    assert "skipped: skipped_1: no tool" in seen(tmp_path, "held", "skipped", "failed").words()
    assert seen(tmp_path, "held", "held").judged("2 of 2").held


def test_each_part_of_a_filter_chooses_a_test(tmp_path: Path) -> None:
    cases = '<testcase classname="Gate" name="Opens" status="run"/>'
    (tmp_path / "unit.xml").write_text(f"<testsuites>{cases}</testsuites>")
    Seen().read_gtest(tmp_path / "unit.xml", 0, "Gate.*:Gate.Opens")
    with pytest.raises(RuntimeError, match=r"unit: no test Gate\.Shuts"):
        Seen().read_gtest(tmp_path / "unit.xml", 0, "Gate.*:Gate.Shuts*")


@pytest.mark.parametrize(("kind", "code"), [("held", 2), ("held", 1), ("held", -11), ("failed", 3)])
def test_tests_that_ended_otherwise_hold_no_row(tmp_path: Path, kind: str, code: int) -> None:
    with pytest.raises(RuntimeError, match=f"pytest ended with {code}"):
        Seen().read_pytest(Doctor(tmp_path, tmp_path, tmp_path, kinds=(kind,), code=code))


def test_a_disabled_test_holds_no_row(tmp_path: Path) -> None:
    case = '<testcase classname="Gate" name="DISABLED_Opens" status="notrun"/>'
    (tmp_path / "unit.xml").write_text(f"<testsuites>{case}</testsuites>")
    found = Seen()
    found.read_gtest(tmp_path / "unit.xml", 0, "Gate.*")
    with pytest.raises(Skip, match="DISABLED_Opens: disabled"):
        found.judged("")


@dataclass
class Doctor(Setting):
    """A doctor's tests of which these end in these ways."""

    kinds: tuple[str, ...] = ()
    code: int | None = None

    def python(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        option = next(str(word) for word in arguments if str(word).startswith("--junitxml="))
        seen(Path(option.partition("=")[2]).parent, *self.kinds)
        failed = int("failed" in self.kinds)
        code = failed if self.code is None else self.code
        return subprocess.CompletedProcess([], code, "2 passed\n")


def test_faults_that_were_not_made_are_named(tmp_path: Path) -> None:
    faults = dict.fromkeys(("a", "b"), next(iter(FAULTS.values())))
    for last in ("held", "failed"):
        found = doctor._live(Doctor(tmp_path, tmp_path, tmp_path, kinds=("held", last)), faults, 3)
        assert found.held == (last == "held")
        assert found.figure == ("6 of 6" if last == "held" else "3 of 6; failed_1: 3 not named")
    found = doctor._live(Doctor(tmp_path, tmp_path, tmp_path, kinds=("held",)), faults, 3)
    assert (found.figure, found.held) == ("3 of 6", False)
    with pytest.raises(Skip, match="skipped_1: no tool"):
        doctor._live(Doctor(tmp_path, tmp_path, tmp_path, kinds=("held", "skipped")), faults, 3)
