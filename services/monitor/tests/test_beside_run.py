"""A run with --view tells if its page or its file for Rerun failed."""

from __future__ import annotations

import importlib.util
import time
from pathlib import Path

import pytest

from zloam_monitor import beside_run, places

#: A stand-in for the command: `web` ends with an error, `view` well when it is told to.
COMMAND = """#!/bin/sh
[ "$1" = web ] && echo "can't listen" >&2 && exit 3
trap 'exit 0' TERM
touch "$5.ready"
while :; do sleep 0.05; done
"""


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    command = tmp_path / "zloam"
    command.write_text(COMMAND)
    command.chmod(0o755)
    monkeypatch.setattr(places, "command", lambda: command)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: object())
    return tmp_path / "out"


def wait_for(path: Path) -> None:
    deadline = time.monotonic() + 60.0
    while not path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_view_that_fails_is_told(out: Path) -> None:
    out.mkdir()
    log = out / "logs" / "web.log"
    with beside_run.shown("tcp/127.0.0.1:1", out, wanted=True) as lacks:
        wait_for(out / "run.rrd.ready")
        while not (log.exists() and log.read_text()):
            time.sleep(0.02)
        assert lacks == []
    (lack,) = lacks
    assert lack.startswith("http://127.0.0.1:")
    assert lack.endswith(f"/ by web: exit code 3 (file or port), see {log}")


def test_without_views_nothing_is_told(out: Path) -> None:
    with beside_run.shown("tcp/127.0.0.1:1", out, wanted=False) as lacks:
        pass
    assert lacks == []
    assert not out.exists()
