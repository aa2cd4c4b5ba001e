"""The follower of a run in containers lets the other processes end, and prints last."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from fake_session import FakeSession
from zloam_monitor import cli, compose, follow, link, messages, outputs, references, report
from zloam_monitor.chain import ChainError
from zloam_monitor.kept_poses import KeptPoses
from zloam_monitor.keys import Keys
from zloam_monitor.link import LinkError
from zloam_monitor.records import PoseRecord
from zloam_monitor.terminal import ProgressLine
from zloam_monitor.trajectory import TrajectoryError

#: The original, as `ended` replaces it.
WAIT = follow._wait
REPORT: dict[str, Any] = {"poses": 1}
WITH_RUN = Path(__file__).resolve().parents[3] / "deploy/docker/with-run"
SAVING = """
import signal, sys, time
def save(*_):
    time.sleep(float(sys.argv[1]))
    sys.exit(0)
signal.signal(signal.SIGTERM, save)
print("ready", flush=True)
time.sleep(60)
"""


class Stage:
    """A process that ends with the run, after a delay like that of a stage that saves."""

    def __init__(self, ended_file: Path, saves_s: float) -> None:
        self.process = subprocess.Popen(
            [WITH_RUN, sys.executable, "-c", SAVING, str(saves_s)],
            env={**os.environ, "ZLOAM_AFTER": "end", "ZLOAM_ENDED_FILE": str(ended_file)},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def ended(self) -> bool:
        return self.process.poll() is not None


@pytest.fixture
def start() -> Iterator[Callable[[Path, float], Stage]]:
    started: list[Stage] = []

    def start_one(ended_file: Path, saves_s: float) -> Stage:
        started.append(Stage(ended_file, saves_s))
        return started[-1]

    yield start_one
    for stage in started:
        stage.process.kill()
        # wait() before the output ends: with-run's watcher holds the output until the process is
        # waited for.
        stage.process.wait()
        assert stage.process.stdout is not None
        stage.process.stdout.close()


def options(tmp_path: Path, ended_file: Path | None) -> follow.FollowOptions:
    return follow.FollowOptions(Keys("robot"), [], tmp_path, "run", ended_file=ended_file)


def test_the_table_comes_after_the_end_of_the_others(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    start: Callable[[Path, float], Stage],
) -> None:
    ended_file = tmp_path / "ended"
    # The second ends seconds after the first, later than the pause added for Docker.
    stages = [start(ended_file, saves_s) for saves_s in (0.0, 3.0)]
    ended_before_table = []

    def table(_: object) -> str:
        ended_before_table.append(all(stage.ended() for stage in stages))
        return "the table"

    monkeypatch.setattr(follow, "_follow", lambda _: REPORT)
    monkeypatch.setattr(report, "table", table)
    found = follow.follow(options(tmp_path, ended_file))
    assert found == REPORT
    assert ended_before_table == [True]
    assert capsys.readouterr().out == "the table\n"


def test_they_end_also_where_the_run_can_not_be_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: object) -> dict[str, Any]:
        raise RuntimeError("the folder is taken")

    monkeypatch.setattr(follow, "_follow", refuse)
    with pytest.raises(RuntimeError, match="the folder is taken"):
        follow.follow(options(tmp_path, tmp_path / "ended"))
    # One time of ending for all, NOTICE_SECONDS after the file was written.
    assert int((tmp_path / "ended").read_text()) >= time.time() - follow.SAID_SECONDS


@pytest.mark.parametrize(
    "words",
    [
        ("--config", "none.yaml"),
        ("--set", "zenoh.base_port=many"),
        ("--connect", "tcp//"),
    ],
)
def test_they_end_also_where_a_setting_is_refused(tmp_path: Path, words: tuple[str, str]) -> None:
    ended_file = tmp_path / "ended"
    where = ("--out", str(tmp_path / "out"), "--ended-file", str(ended_file))
    assert cli.main(["follow", *words, *where]) in (2, 3)
    assert ended_file.exists()


def test_an_interrupt_ends_nobody_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: object) -> dict[str, Any]:
        raise KeyboardInterrupt

    monkeypatch.setattr(follow, "_follow", interrupted)
    with pytest.raises(KeyboardInterrupt):
        follow.follow(options(tmp_path, tmp_path / "ended"))
    assert not (tmp_path / "ended").exists()


class Silent:
    """A link that hears all stages, but no pose."""

    poses: ClassVar[KeptPoses] = KeptPoses()

    def __init__(self) -> None:
        self.polls = 0

    def poll(self, _seconds: float) -> None:
        self.polls += 1

    def stage(self, stage: str) -> object:
        class Status:
            end_of_run = False

        return Status if stage in follow.CONSUMERS and self.polls > 1 else None


def test_a_source_that_never_begins_is_not_waited_for(tmp_path: Path) -> None:
    wanted = dataclasses.replace(
        options(tmp_path, None), ready_file=tmp_path / "ready", patience_s=0.2
    )
    link: Any = Silent()
    with pytest.raises(ChainError, match="no pose within 0 s after all stages were ready"):
        follow._wait(link, wanted, ProgressLine(), outputs.claim_own(tmp_path))
    assert (tmp_path / "ready").exists()
    assert link.polls > 1


def test_the_end_of_the_run_before_is_not_the_end() -> None:
    """Stages that stay say it until their first status in the next run."""
    ends: dict[str, Any] = {}
    link: Any = types.SimpleNamespace(poses={0: "a pose"}, run=2, stage=ends.get)
    for of_run, ended, finished in ((1, True, False), (2, False, False), (2, True, True)):
        said = types.SimpleNamespace(run=of_run, end_of_run=ended)
        ends.update(dict.fromkeys(follow.SINKS, said))
        assert follow._finished(link) == finished
    link.poses = {}
    assert not follow._finished(link)


def test_who_does_not_end_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], start: Callable[[Path, float], Stage]
) -> None:
    start(tmp_path / "ended", 60.0)
    follow._let_end(tmp_path / "ended", seconds=0.3)
    assert capsys.readouterr().out.startswith("not all of the run have ended within 0 s")


def test_without_a_file_nobody_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, start: Callable[[Path, float], Stage]
) -> None:
    monkeypatch.setattr(follow, "_follow", lambda _: REPORT)
    monkeypatch.setattr(report, "table", lambda _: "the table")
    others = tmp_path / "others"
    others.mkdir()
    stage = start(others / "ended", 0.0)
    assert follow.follow(options(tmp_path, None)) == REPORT
    assert [each.name for each in tmp_path.iterdir()] == ["others"]
    assert not stage.ended()


MOUNTED = {"mounting.xyz_m": [0, 0, 1.5], "mounting.rpy_deg": [0, 0, 0]}
TUM = "1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n"


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> FakeSession:
    """A run that ended without a pose; its stages still answer."""
    try:
        messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))
    session = FakeSession(alive=("mapping",))
    session.rounds[session.config_key("mapping")] = [[compose.config("mapping", MOUNTED)]]
    monkeypatch.setattr(follow, "open_session", lambda _: session)
    monkeypatch.setattr(follow, "_wait", lambda *_: 1.0)
    monkeypatch.setattr(follow, "SETTLE_SECONDS", 0.0)
    monkeypatch.setattr(link, "BUSY_SECONDS", 0.2)
    return session


@pytest.mark.usefixtures("ended")
def test_a_reference_that_is_not_there_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there, typo = tmp_path / "truth.tum", tmp_path / "typo.tum"
    there.write_text(TUM)
    wanted = dataclasses.replace(options(tmp_path / "out", None), truth=[there, typo])
    found = follow.follow(wanted)
    assert list(found["references"]) == ["truth.tum"]
    said = f"{typo}: does not exist; no error against this reference"
    assert found["no_reference"] == [said]
    out = capsys.readouterr().out
    assert said in out
    assert "no truth was given" not in out
    assert said in (tmp_path / "out" / "report.html").read_text()


def test_without_references_nothing_needs_a_mounting(
    tmp_path: Path, ended: FakeSession, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stages may have ended before they are asked."""
    ended.alive, ended.rounds = (), {}
    assert follow.follow(options(tmp_path, None))["no_reference"] == []
    assert "no truth was given" in capsys.readouterr().out


def test_a_reference_without_a_mounting_is_told(tmp_path: Path, ended: FakeSession) -> None:
    ended.alive, ended.rounds = (), {}
    (tmp_path / "truth.tum").write_text(TUM)
    wanted = dataclasses.replace(options(tmp_path, None), truth=[tmp_path / "truth.tum"])
    (said,) = follow.follow(wanted)["no_reference"]
    assert said == "no stage said its mounting: no error against truth.tum"


@pytest.mark.usefixtures("ended")
def test_a_bad_reference_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = tmp_path / "truth.tum"
    wanted = dataclasses.replace(options(tmp_path, None), truth=[truth])

    def waits(*_: object) -> float:
        truth.write_text("no trajectory\n")
        return 1.0

    # A run that is over is not lost by one that was damaged meanwhile.
    monkeypatch.setattr(follow, "_wait", waits)
    (said,) = follow.follow(wanted)["no_reference"]
    assert said.startswith(f"{truth}: can't be read (")
    with pytest.raises(TrajectoryError):
        follow.follow(wanted)


class BreaksOff(Silent):
    """A link that hears one pose, or none, before its robot is lost."""

    def __init__(self, poses: int) -> None:
        super().__init__()
        self.poses = KeptPoses()  # type: ignore[misc]
        self._first = [
            PoseRecord(1, n, 0, np.zeros(3), np.array([0, 0, 0, 1.0]), 0, 0, False, ())
            for n in range(poses)
        ]

    def poll(self, seconds: float) -> None:
        super().poll(seconds)
        if self.polls > 1:
            raise LinkError("the robot is lost")
        for pose in self._first:
            self.poses.add(pose)

    def close(self) -> None: ...


@pytest.mark.usefixtures("ended")
@pytest.mark.parametrize("poses", [0, 1])
def test_no_earlier_report_stands_for_a_run_that_has_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, poses: int
) -> None:
    wanted = options(tmp_path, None)
    follow.follow(wanted)
    earlier = (tmp_path / "report.json").read_bytes()
    monkeypatch.setattr(follow, "_wait", WAIT)
    monkeypatch.setattr(follow, "Link", lambda *_: BreaksOff(poses))
    with pytest.raises(LinkError):
        follow.follow(wanted)
    left = [path.read_bytes() for path in tmp_path.glob("report.json")]
    assert left == ([] if poses else [earlier])


def test_references_of_one_name_are_both_kept(tmp_path: Path) -> None:
    paths = [tmp_path / folder / "truth.tum" for folder in "ab"]
    for path in paths:
        path.parent.mkdir()
        path.write_text(TUM)
    found, lacks = references.of_base(paths, {"mapping": MOUNTED})
    assert (list(found), lacks) == (["truth.tum", str(paths[1])], [])
    # 1.5 m below the sensor.
    assert found["truth.tum"].positions[1].tolist() == [1.0, 0.0, -1.5]
