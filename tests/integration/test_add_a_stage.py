"""docs/add-a-stage.md: the example stage is put into a copy of the checkout as the page describes,
built, and run beside the other stages."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import ROOT, Capture
from zloam_monitor.trajectory import read

#: files that a build without tests needs
PARTS = ("CMakeLists.txt", "CMakePresets.json", "LICENSE", "THIRD_PARTY.md")
FOLDERS = ("cmake", "services", "schemas", "deploy")
STAGE = "odometer"


def entry() -> dict[str, object]:
    page = (ROOT / "docs/add-a-stage.md").read_text()
    found = re.search(r"^```json\n(.*?)^```$", page, re.S | re.M)
    assert found is not None
    return dict(json.loads(found[1]))


@pytest.fixture(scope="module")
def checkout(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout with the example's folder and its entry in the list of stages."""
    copy = tmp_path_factory.mktemp("checkout")
    for name in PARTS:
        shutil.copy(ROOT / name, copy)
    ignored = shutil.ignore_patterns("__pycache__", "target")
    for name in FOLDERS:
        shutil.copytree(ROOT / name, copy / name, ignore=ignored)
    shutil.copytree(ROOT / "examples" / STAGE, copy / "services" / STAGE)
    listed = copy / "services/stages.json"
    listed.write_text(json.dumps([*json.loads(listed.read_text()), entry()]))
    library = build / "lib/libzloam_zenoh.so"
    options = [
        "-DZLOAM_TESTS=OFF",
        "-DZLOAM_ALOAM=OFF",
        "-DZLOAM_GRAPH=OFF",
        f"-DZLOAM_ZENOH_LIBRARY={library}",
    ]
    # Lets ccache reuse the objects of the original build: only the list of stages differs.
    environment = {**os.environ, "CCACHE_BASEDIR": str(copy), "CCACHE_NOHASHDIR": "1"}
    for words in (
        ["cmake", "--preset", "release", *options],
        ["cmake", "--build", "build/release", "--target", "programs", "-j", "2"],
    ):
        done = subprocess.run(
            words, cwd=copy, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    return copy


def test_the_stage_runs_beside_the_others(checkout: Path, capture: Capture, tmp_path: Path) -> None:
    """Uses the copy's own monitor, which has the stage in its list."""
    words = ["demo", "--preset-dir", "build/release", "--pcap", capture.pcap, "--out", tmp_path]
    done = subprocess.run(
        [sys.executable, "-m", "zloam_monitor", *map(str, words)],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout / "services/monitor/src")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads((tmp_path / "report.json").read_text())
    poses = read(tmp_path / "trajectory.tum")
    assert report["identities"]["complaints"] == []
    assert report["sweeps"][STAGE]["in"] == len(poses)
    length_m = np.linalg.norm(np.diff(poses.transforms[:, :3, 3], axis=0), axis=1).sum()
    assert length_m > 5.0
    said = re.findall(r"driven_m=([0-9.]+)", (tmp_path / f"logs/{STAGE}.log").read_text())
    assert [float(each) for each in said] == [pytest.approx(length_m, rel=0.02)]


def test_its_section_is_its_own(checkout: Path) -> None:
    """The stage checks its own section of a robot's file; the other stages ignore it."""
    robot = checkout / "deploy/robots/vlp16-outdoor.yaml"

    def checked(stage: str, setting: str) -> subprocess.CompletedProcess[str]:
        program = checkout / f"build/release/bin/zloam-{stage}"
        words: list[str | Path] = [
            program,
            "--config",
            robot,
            "--check-config",
            "--set",
            f"{STAGE}.{setting}",
        ]
        return subprocess.run(words, capture_output=True, text=True, check=False)

    assert checked(STAGE, "min_step_m=0.5").returncode == 0
    refused = checked(STAGE, "min_step=0.5")
    assert refused.returncode == 2
    assert f"{STAGE}.min_step" in refused.stderr
    assert checked("odometry", "min_step_m=0.5").returncode == 0
