"""A stage is replaced by a third party's program with the same keys and schemas; the other stages
do not notice."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import ROOT, Capture
from zloam_monitor import evaluation, sources, trajectory
from zloam_monitor.chain import Chain
from zloam_monitor.processes import endpoints
from zloam_monitor.robot_file import names
from zloam_monitor.stages import PORT_ORDER

RUN_SECONDS = 240.0
#: The drive is 60 m long; a wrong frame, order or time would give errors of metres.
ATE_M = 0.5


class Replaced(Chain):
    """The chain with an odometry in Python."""

    def __init__(self, build: Path, robot_file: Path, capture: Capture, logs: Path) -> None:
        self.robot = names(robot_file, [])
        settings = [
            *sources.from_pcap(capture.pcap).driver_settings("max"),
            f"integration.output_dir={logs}",
        ]
        name, sensor = self.robot.robot, self.robot.sensor
        super().__init__(build, robot_file, name, settings, logs, sensor)
        ports = endpoints(self.base_port)
        own = ports[PORT_ORDER.index("odometry")]
        others = ",".join([self._own_endpoint(), *(p for p in ports if p != own)])
        command = [sys.executable, "-m", "tests.integration.kiss_odometry"]
        self._commands["odometry"] = [*command, own, others, name, sensor]


def test_odometry_in_python(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [str(ROOT), str(ROOT / "services/monitor/src"), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    ends = time.monotonic() + RUN_SECONDS
    chain = Replaced(build, robot_file, capture, tmp_path)
    with chain:
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
            assert time.monotonic() < ends, chain.link.statuses
        chain.link.query_statuses()
        assert set(chain.stop().values()) == {0}
    statuses = chain.statuses()
    last = statuses["driver"].last_sweep
    assert last is not None
    assert sorted(chain.link.poses) == list(range(last + 1))
    for stage in ("mapping", "integration"):
        for account in statuses[stage].inputs:
            assert account.balanced(), (stage, account)
            assert account.lost == 0, (stage, account)
    # The trajectory: KISS-ICP's odometry with mapping's corrections.
    estimate = trajectory.read(tmp_path / "trajectory.tum")
    compared = evaluation.compare(estimate, trajectory.read(capture.truth_base))
    assert compared is not None
    assert np.sqrt(np.mean(compared.errors_m() ** 2)) < ATE_M
