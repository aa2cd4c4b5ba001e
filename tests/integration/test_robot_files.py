"""The robots' files are accepted by every stage, and their comments are what the stages say."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.integration.conftest import ROOT
from zloam_monitor import robot_files
from zloam_monitor.keys import STAGES

ROBOTS = ROOT / "deploy" / "robots"


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_stage_accepts_it(build: Path, path: Path) -> None:
    # scans have no network to come from, so the file of a replay needs a path
    path_set = ["--set", "driver.path=somewhere"]
    for stage in STAGES:
        done = subprocess.run(
            [build / "bin" / f"zloam-{stage}", "--config", path, "--check-config", *path_set],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr


def test_comments_are_up_to_date(build: Path) -> None:
    stale = robot_files.refresh(build, ROBOTS, check=True)
    assert not stale, "run: make reference"
