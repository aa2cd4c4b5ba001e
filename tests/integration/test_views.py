"""A running robot, seen from elsewhere: Foxglove, Rerun, the web page."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.browser import Browser
from tests.integration.conftest import ROOT, monitor
from tests.integration.views import (
    assert_foxglove_shows_the_drive,
    fetched,
    has_driven,
    rerun_lets_in,
    until,
)
from zloam_monitor.processes import free_port

#: longer than all tests of this file take
DRIVE_SECONDS = 240
#: limit for an expected line of output, on a busy machine
SAID_WITHIN_S = 120.0


class Program:
    """A running `zloam ...`, until it is ended; within `with`, also by a test that fails."""

    def __init__(self, *arguments: object, **environment: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-m", "zloam_monitor", *map(str, arguments)],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT / "services/monitor/src"), **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.said = ""

    def find(self, pattern: str) -> str:
        """First group of the pattern in a line of the output; kills the program if no line matches
        in time."""
        assert self.process.stdout is not None
        too_long = threading.Timer(SAID_WITHIN_S, self.process.kill)
        too_long.start()
        try:
            for line in self.process.stdout:
                self.said += line
                if match := re.search(pattern, line):
                    return match[1]
        finally:
            too_long.cancel()
        raise AssertionError(f"{pattern} was not said:\n{self.said}")

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()

    def end(self) -> tuple[int, str]:
        self.process.send_signal(signal.SIGINT)
        rest, _ = self.process.communicate(timeout=120)
        return self.process.returncode, self.said + rest


@pytest.fixture(scope="module")
def robot(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Endpoint of a robot that drives round a block."""
    out = tmp_path_factory.mktemp("drive")
    with Program(
        *("demo", "--preset-dir", build, "--out", out / "out", "--rate", "realtime"),
        f"--simulate=--duration={DRIVE_SECONDS}",
        ZLOAM_FREE_PORTS="1",
    ) as driving:
        yield driving.find(r"listens on tcp/(\S+)")
        driving.process.terminate()
        driving.process.communicate(timeout=60)


def test_foxglove_shows_it_live(robot: str, page: str) -> None:
    """Over Foxglove's protocol, decoded by the code that Foxglove publishes with its schemas."""
    until(lambda: has_driven(page))
    with Program("foxglove", "--connect", robot, "--port", 0) as server:
        assert_foxglove_shows_the_drive(server.find(r"(ws://127\.0\.0\.1:\d+)"))
        code, said_all = server.end()
    assert code == 0, said_all


def test_rerun_s_file_has_everything(robot: str, tmp_path: Path) -> None:
    file = tmp_path / "a.rrd"
    done = monitor("view", "--connect", robot, "--save", file, "--seconds", 12)
    assert done.code == 0, done.said
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", file],
        env={**os.environ, "XDG_CONFIG_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for entity in (
        "/map/path/",
        "/odom/path/",
        "/map/sureness",
        "/map/tiles/plane/",
        "/map/odom/base_link/sweep",
        "/map/odom/base_link/lidar/features/Sharp",
        "/map/odom/base_link/lidar/rejected",
        "/plots/latency/odometry",
        "/plots/latency/mapping",
        "/log",
    ):
        assert entity in printed, entity


def test_rerun_serves_a_browser_on_this_machine_only(robot: str, tmp_path: Path) -> None:
    """Nor does it write into the user's own settings."""
    port = free_port()
    with Program(
        *("view", "--connect", robot, "--web", "--port", port), XDG_CONFIG_HOME=str(tmp_path)
    ) as viewer:
        page = viewer.find(r"(http://\S+);")
        assert page.startswith(f"http://127.0.0.1:{port}/?url=")
        answer = urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=30)
        assert b"re_viewer" in answer.read()
        listening = Path("/proc/net/tcp").read_text().splitlines()[1:]
        own = [line.split()[1] for line in listening if f":{port:04X}" in line.split()[1]]
        assert own
        assert all(each.startswith("0100007F:") for each in own)
        code, said = viewer.end()
    assert code == 0, said
    assert not (tmp_path / "rerun").exists()


def test_rerun_s_page_is_shown_elsewhere_too(robot: str) -> None:
    """If Rerun listens on another address than the loopback's, pages are allowed from that address,
    or by any host name."""
    for address, host in (("0.0.0.0", "127.0.0.1"), ("127.0.0.2", "127.0.0.2")):
        port = free_port()
        with Program(
            *("view", "--connect", robot, "--web", "--port", port), "--address", address
        ) as viewer:
            assert viewer.find(r"(http://\S+)[ ;]").startswith(f"http://{host}:{port}/?url=")
            assert rerun_lets_in(f"http://{host}:{port + 1}", f"http://robot.lan:{port}")
            assert not rerun_lets_in(f"http://{host}:{port + 1}", "http://robot.lan")
            code, said = viewer.end()
        assert code == 0, said


@pytest.fixture(scope="module")
def page(robot: str) -> Iterator[str]:
    with Program("web", "--connect", robot, "--port", 0) as server:
        yield server.find(r"(http://\S+)/ shows robot")
        code, said = server.end()
    assert code == 0, said


def test_the_page_s_figures_are_the_robot_s(page: str) -> None:
    assert fetched(f"{page}/robots.json")["robots"] == ["robot"]

    def judged_at_the_sensors_pace() -> Any:
        state = fetched(f"{page}/robots/robot/state.json")
        return state.get("judged") and 8.0 < state["rate"] < 12.0 and state

    # On a busy machine poses may come late, then several at once.
    state = until(judged_at_the_sensors_pace)
    assert state["pose"]["health"] == "ok"
    assert [s["name"] for s in state["stages"]] == [
        *("driver", "registration", "odometry", "mapping", "integration")
    ]
    assert {s["health"] for s in state["stages"]} == {"ready"}
    assert state["path"][-1] == pytest.approx(state["pose"]["xyz"][:2], abs=3.0)
    # On a busy machine the robot may rightly be reported as slow.
    assert [f for f in state["findings"] if "slow" not in f["do"]] == []
    drawn = until(lambda: (m := fetched(f"{page}/robots/robot/map.json"))["cells"] and m)
    assert drawn["cell_m"] > 0


def test_nothing_else_is_served(page: str) -> None:
    for path in ("/../robot_view.py", "/robot_view.py", "/robots/nobody/state.json", "/robots/"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(page + path, timeout=30)
        assert refused.value.code == 404
        refused.value.close()


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 844)])
def test_the_page_in_a_browser(page: str, tmp_path: Path, width: int, height: int) -> None:
    with Browser(page, tmp_path / "profile", width, height) as browser:
        browser.wait_for("document.getElementById('health').textContent === 'ok'")
        browser.wait_for("document.querySelectorAll('#stages tr').length === 5")
        browser.wait_for("map.cells.length > 300")
        assert browser.value("document.documentElement.scrollWidth") <= width
        # With the keyboard alone: focus the map, zoom in, pan away from the robot.
        for _ in range(10):
            browser.press("Tab")
            if browser.value("document.activeElement.id") == "map":
                break
        assert browser.value("document.activeElement.id") == "map"
        scale = browser.value("view.scale")
        browser.press("+")
        assert browser.value("view.scale") > scale
        browser.press("f")
        assert browser.value("view.follow") is False
        # The canvas is not empty.
        drawn = "(c => new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size)"
        assert browser.value(f"{drawn}(document.getElementById('map'))") > 3
        assert browser.errors == []


def test_a_page_whose_server_is_gone_says_so(robot: str, tmp_path: Path) -> None:
    with Program("web", "--connect", robot, "--port", 0) as server:
        url = server.find(r"(http://\S+)/ shows robot")
        with Browser(url, tmp_path / "profile", 390, 844) as browser:
            browser.wait_for("document.getElementById('health').textContent === 'ok'")
            assert server.end()[0] == 0
            browser.wait_for("document.getElementById('connection').textContent.includes('is old')")


@pytest.mark.parametrize("command", ["foxglove", "web", "view", "record"])
def test_nobody_there_is_said(command: str, tmp_path: Path) -> None:
    more = [tmp_path / "a.mcap"] if command == "record" else []
    done = monitor(command, *more, "--connect", f"127.0.0.1:{free_port()}")
    assert done.code == 1
    assert "check that stages run there" in done.said
    assert "Traceback" not in done.said
    assert not (tmp_path / "a.mcap").exists()
