"""/dev/shm without room for the stages' pools, or read-only: the replay uses sockets, gives the
same bytes, and reports this in one line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.conftest import ROOT, Capture, digests
from zloam_monitor.stages import STAGES

FILES = ("trajectory.tum", "odometry.tum", "map.pcd")


def demo(build: Path, capture: Capture, out: Path, mount: str) -> str:
    """Output of a demo with its own file system mounted at /dev/shm."""
    program = f"{sys.executable} -m zloam_monitor demo --preset-dir {build} --pcap {capture.pcap}"
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", f"{mount} && exec {program} --out {out}"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT / "services/monitor/src")},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=200,
        check=False,
    )
    if "unshare failed" in done.stdout or "permission denied" in done.stdout:
        pytest.skip("needs the right to mount in a name space of its own")
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.slow
def test_without_room_messages_go_through_sockets(
    build: Path, capture: Capture, tmp_path: Path
) -> None:
    demo(build, capture, tmp_path / "usual", "true")
    reference = digests(tmp_path / "usual", FILES)
    for options in ("size=1m", "ro"):
        out = tmp_path / options
        said = demo(build, capture, out, f"mount -t tmpfs -o {options} tmpfs /dev/shm")
        assert digests(out, FILES) == reference, options
        for log in (out / "logs" / f"{stage}.log" for stage in STAGES):
            lines = log.read_text().splitlines()
            assert sum("messages go through sockets" in line for line in lines) == 1, log.name
            said += log.read_text()
        assert "panic" not in said
        assert "Traceback" not in said
