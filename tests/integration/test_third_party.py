"""A third party's view: PyPI's eclipse-zenoh, the generated code, and nothing else of the
project."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import CAPTURE_SECONDS, PATIENCE_S, ROOT, Capture, WithoutDriver
from zloam_monitor import messages, sources
from zloam_monitor.chain import Chain
from zloam_monitor.processes import endpoints
from zloam_monitor.robot_file import names
from zloam_monitor.stages import PORT_ORDER

#: pace of the replay relative to real time: on a busy machine, the example starts in seconds
SLOW = "0.3"


def test_the_example_sees_every_pose(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    robot = names(robot_file, [])
    chain = Chain(
        build,
        robot_file,
        robot.robot,
        sources.from_pcap(capture.pcap).driver_settings(SLOW),
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
        try:
            while stranger.poll() is None and not chain.finished():
                chain.link.poll(0.2)
                chain.check()
            said, _ = stranger.communicate(timeout=PATIENCE_S)
        finally:
            stranger.kill()
        rows = [line.split() for line in said.splitlines()]
        deadline = time.monotonic() + PATIENCE_S
        # A pose may come here later than there.
        while int(rows[-1][0]) not in chain.link.poses and time.monotonic() < deadline:
            chain.link.poll(0.1)
        poses = chain.link.trajectory()
    assert len(rows) == wanted
    at = {
        int(s): (int(t), p)
        for s, t, p in zip(poses.sweeps, poses.stamps_ns, poses.positions, strict=True)
    }
    for sweep, instant_ns, *xyz in rows:
        instant, position = at[int(sweep)]
        assert int(instant_ns) == instant
        # The example prints millimetres.
        assert [float(v) for v in xyz] == pytest.approx(position.tolist(), abs=5.01e-4)


SWEEPS, SPEED_MPS, PERIOD_S = 40, 0.3, 0.1


def example_command(language: str, build: Path) -> list[str]:
    if language == "c++":
        return [str(build / "tests" / "zloam-example-sweeps")]
    return [sys.executable, str(ROOT / "services" / "monitor" / "examples" / "publish_sweeps.py")]


@pytest.mark.parametrize("language", ["python", "c++"])
def test_sweeps_from_a_program_of_your_own(
    build: Path, robot_file: Path, tmp_path: Path, language: str
) -> None:
    command = example_command(language, build)
    assert Path(command[-1]).is_file(), f"not built: {command[-1]}"
    robot = names(robot_file, [])
    settings = ["driver.source=udp", f"integration.output_dir={tmp_path}"]
    chain = WithoutDriver(build, robot_file, robot.robot, settings, tmp_path, robot.sensor)
    endpoint = endpoints(chain.base_port)[PORT_ORDER.index("registration")]
    environment = {**os.environ, "PYTHONPATH": str(messages.schemas_path())}
    with chain:
        given = [endpoint, robot.robot, robot.sensor, str(SWEEPS)]
        with subprocess.Popen([*command, *given], env=environment) as stranger:
            try:
                deadline = time.monotonic() + PATIENCE_S
                while len(chain.link.poses) < SWEEPS and time.monotonic() < deadline:
                    chain.link.poll(0.2)
                    chain.check()
                assert stranger.wait(PATIENCE_S) == 0
            finally:
                stranger.kill()
        poses = list(chain.link.poses.values())
    assert [pose.sweep for pose in poses] == list(range(SWEEPS))
    driven_m = np.array([pose.translation[0] for pose in poses])
    # A pose refers to the end of its sweep.
    expected_m = SPEED_MPS * PERIOD_S * (np.arange(SWEEPS) + 1)
    assert np.abs(driven_m - driven_m[0] - (expected_m - expected_m[0])).max() < 0.03
