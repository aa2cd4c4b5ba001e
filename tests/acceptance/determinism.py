"""The same replay gives the same bytes, whatever else runs on the machine."""

from __future__ import annotations

import hashlib
import subprocess
import sys

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import Demo, Setting

RESULT_FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum", "map.pcd")


def checks(setting: Setting) -> list[Check]:
    command = "make demo PCAP=out/accept/city/capture.pcap, twice"
    return [
        Check(
            "replay-twice",
            "replay twice: trajectory and map",
            "same bytes",
            command,
            lambda: _same_bytes(_replayed(setting, "replay-a"), _replayed(setting, "replay-b")),
        ),
        Check(
            "replay-loaded",
            "replay while another program loads both cores",
            "same bytes",
            command,
            lambda: _under_load(setting),
        ),
    ]


def _digests(demo: Demo) -> dict[str, str]:
    return {
        f: hashlib.sha256((demo.results / f).read_bytes()).hexdigest()[:12] for f in RESULT_FILES
    }


def _same_bytes(first: Demo, second: Demo) -> Measured:
    a, b = _digests(first), _digests(second)
    differing = [f for f in RESULT_FILES if a[f] != b[f]]
    return Measured(
        f"differ: {', '.join(differing)}" if differing else f"same ({', '.join(RESULT_FILES)})",
        not differing,
    )


def _replayed(s: Setting, name: str) -> Demo:
    return s.demo(name, "--pcap", s.capture())


def _under_load(s: Setting) -> Measured:
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        loaded = _replayed(s, "replay-loaded")
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    return _same_bytes(_replayed(s, "replay-a"), loaded)
