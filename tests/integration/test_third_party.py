"""A stranger's view: PyPI's eclipse-zenoh, the generated code, and nothing else of the project."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.integration.conftest import CAPTURE_SECONDS, ROOT, Capture
from zloam_monitor import messages, sources
from zloam_monitor.chain import Chain
from zloam_monitor.processes import PORT_ORDER, endpoints
from zloam_monitor.robot_file import names


def test_the_example_sees_every_pose(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    robot = names(robot_file, [])
    chain = Chain(
        build,
        robot_file,
        robot.robot,
        sources.from_pcap(capture.pcap).driver_settings("realtime"),
        tmp_path / "logs",
        robot.sensor,
    )
    wanted = CAPTURE_SECONDS * 5
    example = ROOT / "services" / "monitor" / "examples" / "subscribe.py"
    endpoint = endpoints(chain.base_port)[PORT_ORDER.index("integration")]
    with (
        chain,
        subprocess.Popen(
            [sys.executable, example, endpoint, robot.robot, str(wanted)],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(messages.schemas_path())},
        ) as stranger,
    ):
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
        poses = chain.link.trajectory()
        said, _ = stranger.communicate(timeout=20)
    rows = [line.split() for line in said.splitlines()]
    assert len(rows) == wanted
    at = {
        int(s): (int(t), p)
        for s, t, p in zip(poses.sweeps, poses.stamps_ns, poses.positions, strict=True)
    }
    for sweep, instant_ns, *xyz in rows:
        instant, position = at[int(sweep)]
        assert int(instant_ns) == instant
        assert [float(v) for v in xyz] == position.tolist()
