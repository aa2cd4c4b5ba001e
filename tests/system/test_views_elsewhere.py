"""The demo in containers at real time, seen by every view of the monitor from other containers."""

from __future__ import annotations

import json
import os
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from tests.integration.views import (
    answers,
    assert_foxglove_shows_the_drive,
    fetched,
    has_driven,
    rerun_lets_in,
    until,
)
from tests.system.compose import Deployment, free_port, inspect
from tests.system.conftest import DETACHED
from tests.system.outside import elsewhere
from zloam_monitor.stages import STAGES

pytestmark = pytest.mark.system
#: longer than the tests of this file take together; how long each waits on a busy machine
DRIVE_SECONDS, PATIENCE_S = 400, 180.0
LAYERS = ("observability", "preview", "views")
ROUTER = "tcp/router:7447"
#: Rerun's own program as another viewer, which writes the received data into a file
VIEWER = """
PATH=$PATH:/opt/site-view/rerun_cli
timeout --signal INT 8 rerun rerun+http://view:9093/proxy --save /tmp/a.rrd >&2
rerun rrd print /tmp/a.rrd
"""
ENTITIES = ("/map/path/", "/map/tiles/plane/", "/map/odom/base_link/sweep", "/log")


@dataclass(frozen=True)
class Shown:
    """A driving robot, and the addresses of its views on this host."""

    deployment: Deployment
    page: str
    foxglove: str
    rerun: str
    rerun_data: str


@pytest.fixture(scope="module")
def shown(view_image: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shown]:
    ports = {name: f"127.0.0.1:{free_port()}" for name in ("WEB", "FOXGLOVE", "VIEW", "VIEW_DATA")}
    deployment = Deployment(
        f"zloam-shown-{os.getpid()}",
        tmp_path_factory.mktemp("shown"),
        [f"deploy/compose/{layer}.yml" for layer in LAYERS],
        {
            "ZLOAM_DURATION": str(DRIVE_SECONDS),
            "ZLOAM_RATE": "realtime",
            **{f"ZLOAM_{name}_PORT": address for name, address in ports.items()},
        },
    )
    try:
        services = ("web", "foxglove", "view", "preview")
        deployment.run("up", "--no-build", "--detach", DETACHED, *services)
        page = f"http://{ports['WEB']}"
        until(lambda: answers(page) and has_driven(page), PATIENCE_S)
        rerun, data = (f"http://{ports[name]}" for name in ("VIEW", "VIEW_DATA"))
        yield Shown(deployment, page, f"ws://{ports['FOXGLOVE']}", rerun, data)
    finally:
        deployment.run("down", "--volumes", "--timeout", "20", check=False)


def assert_drives(page: str) -> None:
    """Waits until all stages have reported that they are well, and the robot has moved."""

    def state() -> Any:
        return fetched(f"{page}/robots/robot/state.json")

    until(lambda: {stage["health"] for stage in state()["stages"]} == {"ready"})
    pose = until(lambda: state().get("pose"))
    assert pose["health"] == "ok"
    until(lambda: state()["pose"]["xyz"] != pose["xyz"])


def test_the_page_shows_it(shown: Shown) -> None:
    assert_drives(shown.page)
    assert until(lambda: fetched(f"{shown.page}/robots/robot/map.json")["cells"])


def test_the_thin_page_shows_it(shown: Shown) -> None:
    words = ("zenoh-loam-monitor", "web", "--thin", "--address", "0.0.0.0", "--connect", ROUTER)
    with elsewhere(shown.deployment, "thin", *words) as name:
        page = f"http://{inspect(name).address}:8080"
        until(lambda: answers(page), PATIENCE_S)
        assert_drives(page)


def test_watch_shows_it(shown: Shown) -> None:
    said = shown.deployment.run(
        *("run", "--rm", "--no-deps", "-T", "monitor"),
        *("watch", "--connect", ROUTER, "--json", "--every", "1", "--seconds", "8"),
    )
    looks = [json.loads(line) for line in said.splitlines()]
    assert len(looks) >= 4
    assert looks[-1]["stages"].keys() == set(STAGES)
    assert {stage["health"] for stage in looks[-1]["stages"].values()} == {"ready"}
    sweeps = [look["pose"]["sweep"] for look in looks if look["pose"]]
    assert sweeps[-1] > sweeps[0]
    assert looks[-1]["this_view_kb_s"] > 0


def test_foxglove_shows_it(shown: Shown) -> None:
    assert_foxglove_shows_the_drive(shown.foxglove)


def test_rerun_shows_it(shown: Shown) -> None:
    """The page comes to this host; the data go to a viewer in another container, and to a browser
    that knows the robot by a host name."""
    with urllib.request.urlopen(shown.rerun, timeout=30) as answer:
        assert b"re_viewer" in answer.read()
    assert rerun_lets_in(shown.rerun_data, "http://robot.lan:9092")
    command = ("run", "--rm", "--no-deps", "-T", "--entrypoint", "sh", "view", "-c", VIEWER)

    def is_whole() -> bool:
        printed = shown.deployment.run(*command)
        return all(entity in printed for entity in ENTITIES)

    until(is_whole, PATIENCE_S)
