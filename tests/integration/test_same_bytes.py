"""Replay is deterministic: the same packets and configuration give the same bytes."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

from tests.integration.conftest import Capture, monitor

FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum", "map.pcd")


def run(build: Path, capture: Capture, out: Path) -> dict[str, str]:
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, "--out", out)
    assert done.code == 0, done.said
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in FILES}


def test_replay_twice_and_under_load(build: Path, capture: Capture, tmp_path: Path) -> None:
    first = run(build, capture, tmp_path / "a")
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        second = run(build, capture, tmp_path / "b")
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    assert second == first
