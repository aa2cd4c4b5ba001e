"""`docker compose up` as a user types it ends successfully after the replay and its table; a live
run continues."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.system.compose import ROOT, Deployment
from tests.system.conftest import DRIVE_SECONDS

pytestmark = pytest.mark.system
#: limit for a whole run, with all health checks before it
PATIENCE_S = 240
LIVE = "docker compose -f docker-compose.yml -f deploy/compose/live.yml up -d"
LIVE_PORTS = range(7460, 7465)


@dataclass(frozen=True)
class Ended:
    """The result of a command."""

    code: int
    said: str
    deployment: Deployment

    def lines(self) -> list[str]:
        """The output without the service names that Compose prepends."""
        lines = (re.sub(r"\x1b\[\d*K", "", line) for line in self.said.splitlines())
        return [re.sub(r"^[a-z]+-1 +\| ", "", line) for line in lines]


def typed(command: str, deployment: Deployment) -> Ended:
    """Runs the command in a shell in the checkout; what only tests need is passed by the
    environment."""
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=ROOT,
        env={**deployment.variables(), "COMPOSE_PROJECT_NAME": deployment.project},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    return Ended(done.returncode, done.stdout, deployment)


@pytest.fixture
def fresh(images: None, tmp_path: Path) -> Iterator[Deployment]:
    """A deployment of which nothing exists yet and nothing remains."""
    deployment = Deployment(
        f"zloam-up-{os.getpid()}",
        tmp_path / "out",
        environment={"ZLOAM_DURATION": str(DRIVE_SECONDS), "ZLOAM_AFTER": "end"},
    )
    deployment.out.mkdir()
    yield deployment
    deployment.run("down", "--volumes", "--timeout", "20", check=False)


def assert_all_ended(deployment: Deployment, seconds: float = 0.0) -> None:
    def ended(containers: dict[str, dict[str, object]]) -> bool:
        return all(c["State"] in ("exited", "created") for c in containers.values())

    deployment.wait("all ended", seconds, ended)


@pytest.mark.smoke
def test_it_ends_with_the_table_and_its_success(fresh: Deployment) -> None:
    ended = typed("docker compose up", fresh)
    assert ended.code == 0, ended.said
    lines = ended.lines()
    # After the table, only Compose prints: that containers have ended, in any order.
    said = [line for line in lines if not re.fullmatch(r"[a-z]+-1 exited with code 0", line)]
    assert said[-1] == "accounted for: yes", ended.said
    assert any(line.startswith("stage          in  out") for line in lines)
    assert_all_ended(fresh)
    assert {c["ExitCode"] for c in fresh.containers().values()} == {0}
    assert (fresh.out / "picture.png").stat().st_size > 0


def test_a_second_one_maps_it_again(fresh: Deployment) -> None:
    codes = [typed("docker compose up", fresh).code for _ in range(2)]
    assert codes == [0, 0]
    assert_all_ended(fresh)


def test_it_takes_a_robot_file_of_ones_own(fresh: Deployment, tmp_path: Path) -> None:
    """Nothing of it is in the images, not even the robot's name."""
    robots = tmp_path / "robots"
    robots.mkdir()
    text = (ROOT / "deploy/robots/vlp16-outdoor.yaml").read_text()
    (robots / "mine.yaml").write_text(text.replace("robot: robot", "robot: alpha"))
    ended = typed(f"ZLOAM_ROBOTS={robots} ZLOAM_CONFIG=mine docker compose up", fresh)
    assert ended.code == 0, ended.said
    assert "accounted for: yes" in ended.lines()


def test_it_fails_where_the_run_can_not_be_followed_and_all_end(fresh: Deployment) -> None:
    (fresh.out / "report.json").write_text("of somebody else\n")
    ended = typed("docker compose up", fresh)
    assert ended.code != 0, ended.said
    assert "report.json" in ended.said
    assert_all_ended(fresh, seconds=60.0)
    assert (fresh.out / "report.json").read_text() == "of somebody else\n"


def test_it_fails_where_the_capture_is_none(fresh: Deployment, tmp_path: Path) -> None:
    (tmp_path / "drive.pcap").write_text("no capture at all, but long enough for a header\n")
    layers = "-f docker-compose.yml -f deploy/compose/replay.yml"
    ended = typed(f"ZLOAM_PCAP={tmp_path}/drive.pcap docker compose {layers} up", fresh)
    assert ended.code != 0, ended.said
    assert 'service "driver" didn\'t complete successfully' in ended.said
    assert_all_ended(fresh)


def test_the_live_deployment_stays(fresh: Deployment) -> None:
    for port in LIVE_PORTS:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                pytest.skip(f"somebody on this machine has port {port}, which the layer publishes")
    ended = typed(LIVE, fresh)
    assert ended.code == 0, ended.said
    fresh.wait("all healthy", 60.0, _all_healthy)
    for service in ("mapping", "router"):
        killed = fresh.kill(service)
        fresh.wait_back(service, killed, 60.0)
    time.sleep(5.0)
    assert _all_healthy(fresh.containers())


def _all_healthy(containers: dict[str, dict[str, object]]) -> bool:
    lasting = {name: c for name, c in containers.items() if name != "prepare"}
    return lasting.keys() == {
        "router", "store", "driver", "registration", "odometry", "mapping", "integration"
    } and all(c["Health"] == "healthy" for c in lasting.values())  # fmt: skip


@pytest.mark.smoke
def test_the_images_help(images: None) -> None:
    done = subprocess.run(
        ["docker", "run", "--rm", "zenoh-loam", "driver", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "--health" in done.stdout
