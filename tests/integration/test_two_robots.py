"""Two robots at once on one machine and in one network: neither affects the other."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.integration.conftest import Capture, digests, simulate
from zloam_monitor import sources
from zloam_monitor.chain import Chain
from zloam_monitor.robot_file import names

FILES = ("trajectory.tum", "odometry.tum", "map.pcd")
RUN_SECONDS = 240.0
WORLDS = {"first": "city", "second": "indoor"}


class Robot(Chain):
    """A chain under a robot's name; with `neighbour`, connected to that robot's network."""

    def __init__(
        self,
        build: Path,
        robot_file: Path,
        name: str,
        capture: Capture,
        logs: Path,
        neighbour: Robot | None = None,
    ) -> None:
        self.logs = logs
        settings = [
            f"robot={name}",
            *sources.from_pcap(capture.pcap).driver_settings("max"),
            f"integration.output_dir={logs}",
            f"mapping.map_path={logs / 'map.pcd'}",
        ]
        super().__init__(build, robot_file, name, settings, logs, names(robot_file, []).sensor)
        if neighbour is not None:
            both = f"zenoh.connect=[{self._own_endpoint()},{neighbour._own_endpoint()}]"
            for command in self._commands.values():
                command += ["--set", both]

    def step(self) -> bool:
        self.link.poll(0.1)
        self.check()
        return self.finished()

    def digests(self) -> dict[str, str]:
        self.link.query_statuses()
        assert set(self.stop().values()) == {0}
        for (stage, instance), status in self.link.statuses.items():
            for account in status.inputs:
                assert account.balanced(), (stage, instance, account)
                assert account.lost == 0, (stage, instance, account)
                assert set(account.dropped) <= {"duplicate"}, (stage, instance, account)
        return digests(self.logs, FILES)


def until(true: Callable[[], bool]) -> None:
    ends = time.monotonic() + RUN_SECONDS
    while not true():
        assert time.monotonic() < ends


@pytest.fixture(scope="module")
def captures(build: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Capture]:
    made = {}
    for name, world in WORLDS.items():
        folder = tmp_path_factory.mktemp(name)
        made[name] = simulate(build, folder, "--world", world, "--seed", "5", "--duration", "4")
    return made


@pytest.fixture(scope="module")
def alone(
    build: Path,
    robot_file: Path,
    captures: dict[str, Capture],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, dict[str, str]]:
    """Digests of each robot's run without the other."""
    files = {}
    for name, capture in captures.items():
        with Robot(build, robot_file, name, capture, tmp_path_factory.mktemp(name)) as robot:
            until(robot.step)
            files[name] = robot.digests()
    assert files["first"] != files["second"]
    return files


def test_each_gives_the_bytes_of_its_run_alone(
    build: Path,
    robot_file: Path,
    captures: dict[str, Capture],
    alone: dict[str, dict[str, str]],
    tmp_path: Path,
) -> None:
    first = Robot(build, robot_file, "first", captures["first"], tmp_path / "first")
    with first:
        second = Robot(build, robot_file, "second", captures["second"], tmp_path / "second", first)
        with second:
            until(lambda: all([first.step(), second.step()]))
            # Both were in one network: each robot's link could hear the other.
            tokens = second.link.session.liveliness().get("loam/**")
            robots = {str(reply.ok.key_expr).split("/")[1] for reply in tokens}
            assert robots == set(WORLDS)
            found = {"second": second.digests(), "first": first.digests()}
    assert found == alone
