"""The page of `zloam web` in a browser, served robots whose answers a test holds back."""

from __future__ import annotations

import base64
import threading
from collections.abc import Iterator
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.integration.browser import Browser
from tests.integration.conftest import PATIENCE_S
from zloam_monitor.web.server import _Handler


class Robot:
    """A robot at rest, with a map of some cells."""

    def __init__(self, cells: int) -> None:
        self._cells = np.ones((cells, 3), "<i2")
        self.pose: dict[str, Any] | None = None
        self._lock = threading.Lock()
        self.answers = threading.Event()
        self.answers.set()
        self.says = threading.Event()
        self.says.set()
        #: Requests for the map that wait, and the most that did at once.
        self.open = self.most_open = 0

    def state(self) -> dict[str, Any]:
        self.says.wait(PATIENCE_S)
        return {"pose": self.pose, "kb_s": None, "map_version": 1, "age_s": 0.0, "rate": 10.0}

    def map_view(self) -> dict[str, Any]:
        with self._lock:
            self.open += 1
            self.most_open = max(self.most_open, self.open)
        self.answers.wait(PATIENCE_S)
        with self._lock:
            self.open -= 1
        packed = base64.b64encode(self._cells.tobytes()).decode()
        return {"version": 1, "cells": packed, "cell_m": 1.0, "origin": [0, 0]}


class Robots:
    def __init__(self) -> None:
        self.all = {"a": Robot(cells=1), "b": Robot(cells=2)}

    def names(self) -> list[str]:
        return sorted(self.all)

    def view(self, name: str) -> Robot | None:
        return self.all.get(name)


@pytest.fixture
def robots() -> Robots:
    return Robots()


@pytest.fixture
def url(robots: Robots) -> Iterator[str]:
    handler = type("Handler", (_Handler,), {"robots": robots})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/"
    for robot in robots.all.values():
        robot.answers.set()
        robot.says.set()
    server.shutdown()
    server.server_close()
    thread.join()


def test_another_robot_s_map_is_not_drawn(robots: Robots, url: str, tmp_path: Path) -> None:
    """The map of the robot that was chosen before comes after that of the one that is chosen now;
    both are the first version."""
    first = robots.all["a"]
    first.answers.clear()
    with Browser(url, tmp_path / "profile", 800, 600) as browser:
        browser.wait_for("state !== null")
        browser.value("document.querySelectorAll('#robots button')[1].click()")
        browser.wait_for("chosen === 'b' && map.cells.length === 6")
        first.answers.set()
        # Longer than an answer takes, and several looks.
        browser.value("window.since = performance.now()")
        browser.wait_for("performance.now() - window.since > 3000")
        assert first.open == 0
        assert browser.value("map.cells.length") == 6
        browser.value("document.querySelectorAll('#robots button')[0].click()")
        browser.wait_for("chosen === 'a' && map.cells.length === 3")


def test_a_slow_map_is_asked_for_once_and_holds_nothing_back(
    robots: Robots, url: str, tmp_path: Path
) -> None:
    slow = robots.all["a"]
    slow.answers.clear()
    with Browser(url, tmp_path / "profile", 800, 600) as browser:
        browser.wait_for("state !== null")
        for _ in range(3):
            browser.value("state = null")
            browser.wait_for("state !== null")
        assert slow.most_open == 1
        slow.answers.set()
        browser.wait_for("map.cells.length === 3")


def test_of_a_robot_that_does_not_answer_nothing_is_shown(
    robots: Robots, url: str, tmp_path: Path
) -> None:
    """Not the state of the robot that was chosen before, as if it were of this one."""
    pose = {"xyz": [1, 2, 3], "yaw_deg": 0, "sigma_m": None, "sweep": 7}
    robots.all["a"].pose = {**pose, "health": "ok", "degenerate": False}
    robots.all["b"].says.clear()
    with Browser(url, tmp_path / "profile", 800, 600) as browser:
        browser.wait_for("byId('health').textContent === 'ok' && map.cells.length === 3")
        browser.value("document.querySelectorAll('#robots button')[1].click()")
        browser.wait_for("chosen === 'b'")
        shown = "['health', 'position', 'sweep', 'scale'].map((id) => byId(id).textContent).join()"
        assert browser.value(shown) == "–,–,–,"
        drawn = "byId('map').getContext('2d').getImageData(0, 0, 400, 200).data.some((v) => v > 0)"
        assert not browser.value(drawn)
        robots.all["b"].says.set()
        browser.wait_for("byId('health').textContent === 'no pose yet'")


def test_a_robot_that_is_chosen_by_keyboard_keeps_the_focus(url: str, tmp_path: Path) -> None:
    with Browser(url, tmp_path / "profile", 800, 600) as browser:
        browser.wait_for("state !== null")
        browser.value("document.querySelectorAll('#robots button')[1].focus()")
        browser.value("document.activeElement.click()")
        browser.wait_for("chosen === 'b'")
        assert browser.value("document.activeElement.textContent") == "b"


def test_a_link_that_was_cut_is_told(robots: Robots, url: str, tmp_path: Path) -> None:
    """Nothing comes, and nothing is refused: the page neither waits on nor says `connected`."""
    cut = robots.all["a"]
    with Browser(url, tmp_path / "profile", 800, 600) as browser:
        browser.wait_for("state !== null && byId('connection').className === ''")
        cut.says.clear()
        browser.value("stateMs = 500")
        browser.wait_for("byId('connection').className === 'lost'")
        browser.value("stateMs = 10000")
        cut.says.set()
        browser.wait_for("byId('connection').className === ''")
