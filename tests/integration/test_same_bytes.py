"""Replay is deterministic: the same packets and configuration give the same bytes."""

import hashlib
import subprocess
import sys

from tests.integration.conftest import monitor

FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum", "map.pcd")


def run(build, capture, out):
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, "--out", out)
    assert done.code == 0, done.said
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in FILES}


def test_replay_twice_and_under_load(build, capture, tmp_path):
    first = run(build, capture, tmp_path / "a")
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        second = run(build, capture, tmp_path / "b")
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    assert second == first
