"""README.md's statements about a run hold: the files that it leaves, and what it shows to
others."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.integration.conftest import PATIENCE_S, ROOT, monitor
from zloam_monitor import discovery
from zloam_monitor.processes import free_base_port
from zloam_monitor.stages import STAGES

README = (ROOT / "README.md").read_text()


def listed_files() -> set[str]:
    """File names in README.md's table of what a demo leaves."""
    table = README.split("leaves in")[1].split("| file | what |")[1].split("\n\n")[0]
    cells = [row.split("|")[1] for row in table.splitlines() if row.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_the_table_names_every_file_that_a_demo_leaves(build: Path, tmp_path: Path) -> None:
    length = ("--simulate", "--duration", "--simulate", "3")
    out = tmp_path / "out"
    done = monitor("demo", "--preset-dir", build, "--imu", "simulated", *length, "--out", out)
    assert done.code == 0, done.said
    left = {path.name + ("/" if path.is_dir() else "") for path in out.iterdir()}
    assert left == listed_files()


def test_no_listing_is_longer_than_ten_lines() -> None:
    listings = re.findall(r"^```\w*\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
    assert listings
    assert max(len(text.splitlines()) for text in listings) <= 10


@dataclass(frozen=True)
class Live:
    """A demo that runs until all tests of this file have ended."""

    robot: str
    base_port: int
    out: Path

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self.base_port + 4}"


@pytest.fixture(scope="module")
def live(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    out = tmp_path_factory.mktemp("live")
    run = Live(f"readme-{os.getpid()}", free_base_port(), out)
    # At half the sensor's pace: on a busy machine each command takes seconds to start.
    words = ["demo", "--preset-dir", build, "--rate", "0.5", "--out", out / "demo"]
    words += ["--set", f"robot={run.robot}", "--set", f"zenoh.base_port={run.base_port}"]
    words += ["--simulate", "--duration", "--simulate", "60"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with (
        (out / "log").open("w") as log,
        subprocess.Popen(
            [ROOT / "bin/zloam", *map(str, words)], stdout=log, stderr=log, env=environment
        ) as process,
    ):
        try:
            deadline = time.monotonic() + 120
            while "poses/s" not in (out / "log").read_text():
                assert process.poll() is None, (out / "log").read_text()
                assert time.monotonic() < deadline
                time.sleep(0.1)
            yield run
        finally:
            process.terminate()


def test_the_endpoint_is_printed(live: Live) -> None:
    assert f"robot '{live.robot}' listens on {live.endpoint}\n" in (live.out / "log").read_text()


def test_the_subscriber_as_shown(live: Live, build: Path) -> None:
    shown = re.search(r"^PYTHONPATH=(\S+) \S+python (\S+subscribe\.py)$", README, re.MULTILINE)
    assert shown is not None
    assert shown[1] == "build/release/generated/python"
    said = subprocess.run(
        [sys.executable, ROOT / shown[2], live.endpoint, live.robot, "5"],
        env={**os.environ, "PYTHONPATH": str(build / "generated" / "python")},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout
    assert len(said.splitlines()) == 5


def test_without_an_endpoint_the_robots_of_this_machine_are_found(live: Live) -> None:
    (found,) = (each for each in discovery.robots() if each.robot == live.robot)
    assert found.stages == ["driver", "registration", "odometry", "mapping", "integration"]


@pytest.mark.parametrize("words", [("status",), ("watch", "--seconds", "1"), ("get", "odometry")])
def test_looking(live: Live, words: tuple[str, ...]) -> None:
    done = monitor(*words, "--connect", live.endpoint)
    assert done.code == 0, done.said
    assert f"connected to robot '{live.robot}' at {live.endpoint} (driver, " in done.said


def as_json(live: Live, *words: str) -> list[dict[str, Any]]:
    """The JSON lines of a command's output; each line is one whole document."""
    done = subprocess.run(
        [ROOT / "bin/zloam", *words, "--connect", live.endpoint, "--json"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_programs_get_json(live: Live) -> None:
    (listed,) = as_json(live, "robots")
    assert [each["robot"] for each in listed["robots"]] == [live.robot]
    (status,) = as_json(live, "status")
    assert set(status["stages"]) == set(STAGES)
    assert len(as_json(live, "watch", "--seconds", "2.5", "--every", "1")) == 3
    (values,) = as_json(live, "get", "odometry", "odometry.voxel_m")
    assert values["odometry"]["odometry.voxel_m"] > 0.0
    (said,) = as_json(live, "set", "registration", "registration.max_range_m=120")
    assert said["registration"]["ok"]
    assert said["registration"]["results"]["rev"] == 1


def test_the_doctor_finds_no_fault_that_is_not_there(live: Live) -> None:
    done = monitor("doctor", "--seconds", "3", "--connect", live.endpoint)
    # On a busy machine the doctor may rightly report that stages are slow.
    assert (done.code, "all well: 5 stages" in done.said) in ((0, True), (1, False)), done.said
    for word in ("is not there", "instances of", "versions", "differs", "could not be", "no p"):
        assert word not in done.said, done.said


def test_figures_for_prometheus(live: Live) -> None:
    words = [str(ROOT / "bin/zloam"), "metrics", "--connect", live.endpoint, "--port", "0"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            said = ""
            while "/metrics" not in said:
                said = process.stdout.readline()
                assert said, "it ended"
            ends, page = time.monotonic() + PATIENCE_S, ""
            while not has_all(page, live.robot) and time.monotonic() < ends:
                with urllib.request.urlopen(said.split()[-1], timeout=5) as answer:
                    page = answer.read().decode()
                time.sleep(0.2)
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()  # Otherwise it would be waited for without end.
    assert has_all(page, live.robot), page


def has_all(page: str, robot: str) -> bool:
    """Whether the page shows all stages up, packets counted by the driver, and poses."""
    who = f'robot="{robot}"'
    stages = ("driver", "registration", "odometry", "mapping", "integration")
    wanted = [rf'zloam_up{{.*{who},stage="{stage}"}} 1\.0' for stage in stages]
    wanted += [rf'zloam_figure{{.*name="packets_lost",{who},stage="driver"}} 0\.0']
    wanted += [rf"zloam_pose_age_seconds{{{who}}}"]
    return all(re.search(each, page) for each in wanted)


def test_changing_and_saving(live: Live) -> None:
    changed = monitor("set", "odometry", "odometry.kernel_m=0.2", "--connect", live.endpoint)
    assert changed.code == 0, changed.said
    # The change is in force from the sweep that the reply names.
    for _ in range(20):
        shown = monitor("get", "odometry", "odometry.kernel_m", "--connect", live.endpoint)
        if "odometry odometry.kernel_m=0.2" in shown.said:
            break
        time.sleep(0.5)
    assert "odometry odometry.kernel_m=0.2" in shown.said
    saved = monitor("save", "maps/today", "--connect", live.endpoint)
    assert saved.code == 0, saved.said
    names = {path.name for path in (live.out / "demo/maps/today").iterdir()}
    assert names == {"map.pcd", "trajectory.tum", "trajectory.kitti", "odometry.tum"}
    placed = monitor("place", "--x", "1", "--y", "-0.5", "--connect", live.endpoint)
    assert placed.code == 0, placed.said
    assert "searched for around there" in placed.said
    emptied = monitor("reset", "mapping", "--connect", live.endpoint)
    assert (emptied.code, "mapping: map emptied" in emptied.said) == (0, True)


def test_a_second_run_on_the_same_ports_is_refused(live: Live, build: Path) -> None:
    port = f"zenoh.base_port={live.base_port}"
    done = monitor("run", "--preset-dir", build, "--set", port, "--out", live.out / "second")
    assert done.code == 3
    assert f"driver can't listen on 127.0.0.1:{live.base_port}; zloam-driver (process " in done.said
