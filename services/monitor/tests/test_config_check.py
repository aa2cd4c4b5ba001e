"""`zloam config check` refuses what the stages or `zloam run` refuse, whatever is in the file."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from zloam_monitor import cli, config_check

LATIN_1 = "robot: caf\xe9\n".encode("latin-1")


def stage(path: Path, script: str) -> Path:
    """A program that answers instead of a stage."""
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.yaml"
    path.write_bytes(LATIN_1)
    return path


@pytest.mark.parametrize(
    ("script", "refusal"),
    [
        ("printf 'robot.yaml:1: caf\\351: unknown key' >&2; exit 2", "robot.yaml:1: caf"),
        ("echo {}", "robot.yaml: is not UTF-8 text"),
    ],
)
def test_a_file_in_latin_1(
    file: Path,
    script: str,
    refusal: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A stage quotes its bytes, or takes them for a name that no other program could write."""
    made = stage(file.with_name("stage"), script)
    monkeypatch.setattr(config_check, "readers", lambda build: {"odometry": made})
    assert cli.main(["config", "check", str(file), "--preset-dir", "nowhere"]) == 2
    assert refusal in capsys.readouterr().err


def test_what_several_stages_refuse_is_listed_once_with_what_is_allowed(tmp_path: Path) -> None:
    log = "2026-12-01T05:42:03.233852Z error   "
    refused = "--set-at 5: odometri.k: value 1 is refused: unknown key; allowed: "
    programs = {
        "driver": stage(tmp_path / "driver", f'echo "{log}driver: {refused}nothing" >&2; exit 2'),
        "odometry": stage(
            tmp_path / "odometry",
            f'echo "{log}odometry: {refused}odometry.a, odometry.b" >&2; exit 2',
        ),
        "mapping": stage(tmp_path / "mapping", "echo {}"),
    }
    found = config_check.refusals(programs, tmp_path / "robot.yaml", [], ["5:odometri.k=1"])
    assert found == [f"{refused}odometry.a, odometry.b"]
