"""Beside a robot in containers, Prometheus has its figures and our alerts, and the web page shows
it."""

from __future__ import annotations

import json
import os
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.system.compose import ROOT, Deployment, free_port
from tests.system.conftest import DETACHED

pytestmark = pytest.mark.system
PATIENCE_S = 60.0


@pytest.fixture
def watched(images: None, tmp_path: Path) -> Iterator[tuple[int, int]]:
    """Ports of Prometheus and of the page."""
    port, page = free_port(), free_port()
    deployment = Deployment(
        f"zloam-figures-{os.getpid()}",
        tmp_path / "out",
        ["deploy/compose/observability.yml"],
        {
            # A driver that has replayed everything ends, so the drive must be long enough.
            "ZLOAM_DURATION": "60",
            "ZLOAM_RATE": "realtime",
            "ZLOAM_PROMETHEUS_PORT": f"127.0.0.1:{port}",
            "ZLOAM_WEB_PORT": f"127.0.0.1:{page}",
            "ZLOAM_METRICS_PORT": f"127.0.0.1:{free_port()}",
        },
    )
    deployment.out.mkdir()
    deployment.run("build", "prometheus")
    deployment.run("up", "--detach", DETACHED, "prometheus", "web")
    yield port, page
    deployment.run("down", "--volumes", "--timeout", "20", check=False)


def fetched(port: int, path: str) -> Any:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=5) as answer:
        return json.load(answer)


def asked(port: int, path: str) -> Any:
    return fetched(port, f"api/v1/{path}")["data"]


def alerts() -> list[str]:
    """Names of the alerts that we give Prometheus."""
    (group,) = yaml.safe_load((ROOT / "deploy/observability/alerts.yml").read_text())["groups"]
    return [rule["alert"] for rule in group["rules"]]


def test_prometheus_and_the_page_show_the_robot(watched: tuple[int, int]) -> None:
    port, page = watched
    wanted = {"driver", "registration", "odometry", "mapping", "integration"}
    ends, found = time.monotonic() + PATIENCE_S, set[str]()
    while not found >= wanted and time.monotonic() < ends:
        time.sleep(1.0)
        try:
            result = asked(port, "query?query=zloam_up==1")["result"]
        except OSError:
            continue
        found = {each["metric"]["stage"] for each in result}
    assert found >= wanted
    state: dict[str, Any] = {}
    while not state.get("pose") and time.monotonic() < ends:
        time.sleep(1.0)
        try:
            state = fetched(page, "robots/robot/state.json")
        except OSError:
            continue
    assert {stage["health"] for stage in state["stages"]} == {"ready"}
    assert state["pose"]["health"] == "ok"
    (group,) = asked(port, "rules")["groups"]
    assert [rule["name"] for rule in group["rules"]] == alerts()
    assert {rule["health"] for rule in group["rules"]} <= {"ok", "unknown"}
