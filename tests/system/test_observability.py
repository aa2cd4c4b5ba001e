"""Prometheus beside a robot in containers: it has the robot's figures and our alerts."""

from __future__ import annotations

import json
import os
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.system.compose import Deployment, free_port
from tests.system.conftest import DETACHED

pytestmark = pytest.mark.system
PATIENCE_S = 60.0


@pytest.fixture
def watched(images: None, tmp_path: Path) -> Iterator[tuple[Deployment, int]]:
    port = free_port()
    deployment = Deployment(
        f"zloam-figures-{os.getpid()}",
        tmp_path / "out",
        ["deploy/compose/observability.yml"],
        {
            # A driver that has nothing more to replay is not there any more.
            "ZLOAM_DURATION": "60",
            "ZLOAM_RATE": "realtime",
            "ZLOAM_PROMETHEUS_PORT": f"127.0.0.1:{port}",
            "ZLOAM_METRICS_PORT": f"127.0.0.1:{free_port()}",
        },
    )
    deployment.out.mkdir()
    deployment.run("build", "prometheus")
    deployment.run("up", "--detach", DETACHED, "prometheus")
    yield deployment, port
    deployment.run("down", "--volumes", "--timeout", "20", check=False)


def asked(port: int, path: str) -> Any:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/{path}", timeout=5) as answer:
        return json.load(answer)["data"]


def test_prometheus_has_the_figures_and_the_alerts(watched: tuple[Deployment, int]) -> None:
    _, port = watched
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
    (group,) = asked(port, "rules")["groups"]
    assert len(group["rules"]) == 10
    assert {rule["health"] for rule in group["rules"]} <= {"ok", "unknown"}
