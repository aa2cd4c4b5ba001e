"""Who follows a run in containers lets the others end, and speaks last."""

from __future__ import annotations

import dataclasses
import socket
import threading
import time
from pathlib import Path
from typing import Any, ClassVar

import pytest

from zloam_monitor import follow, report
from zloam_monitor.chain import ChainError
from zloam_monitor.keys import Keys
from zloam_monitor.terminal import ProgressLine

REPORT: dict[str, Any] = {"poses": 1}


class Stage:
    """Listens until some time after the file is there, as a stage that saves."""

    def __init__(self, ended_file: Path, saves_s: float) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self.ended = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(ended_file, saves_s), daemon=True)
        self._thread.start()

    def _run(self, ended_file: Path, saves_s: float) -> None:
        while not ended_file.exists():
            time.sleep(0.01)
        time.sleep(saves_s)
        self.ended.set()
        self._listener.close()


def options(tmp_path: Path, connect: list[str], ended_file: Path | None) -> follow.FollowOptions:
    return follow.FollowOptions(Keys("robot"), connect, tmp_path, "run", ended_file=ended_file)


def test_the_table_comes_after_the_end_of_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ended_file = tmp_path / "ended"
    stages = [Stage(ended_file, saves_s) for saves_s in (0.0, 0.5)]
    ended_before_table = []

    def table(_: object) -> str:
        ended_before_table.append(all(stage.ended.is_set() for stage in stages))
        return "the table"

    monkeypatch.setattr(follow, "_follow", lambda _: REPORT)
    monkeypatch.setattr(report, "table", table)
    found = follow.follow(options(tmp_path, [stage.endpoint for stage in stages], ended_file))
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
        follow.follow(options(tmp_path, [], tmp_path / "ended"))
    # The same time for all, which the last has read by then.
    assert int((tmp_path / "ended").read_text()) >= time.time() - follow.GONE_SECONDS


def test_an_interrupt_ends_nobody_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: object) -> dict[str, Any]:
        raise KeyboardInterrupt

    monkeypatch.setattr(follow, "_follow", interrupted)
    with pytest.raises(KeyboardInterrupt):
        follow.follow(options(tmp_path, [], tmp_path / "ended"))
    assert not (tmp_path / "ended").exists()


class Silent:
    """A link on which all stages are heard, and no pose."""

    poses: ClassVar[dict[int, object]] = {}

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
        options(tmp_path, [], None), ready_file=tmp_path / "ready", patience_s=0.2
    )
    link: Any = Silent()
    with pytest.raises(ChainError, match="no pose within 0 s after all stages were ready"):
        follow._wait(link, wanted, ProgressLine())
    assert (tmp_path / "ready").exists()
    assert link.polls > 1


def test_who_does_not_end_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        follow._let_end(options(tmp_path, [endpoint], tmp_path / "ended"), seconds=0.3)
    assert capsys.readouterr().out == f"not ended within 0 s: {endpoint}\n"


def test_without_a_file_nobody_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follow, "_follow", lambda _: REPORT)
    monkeypatch.setattr(report, "table", lambda _: "the table")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        assert follow.follow(options(tmp_path, [endpoint], None)) == REPORT
    assert not list(tmp_path.iterdir())
