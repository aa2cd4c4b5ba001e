"""Docker, the images, and one whole run of the default deployment that several tests look at."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.system.compose import ROOT, Deployment
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_client
from zloam_monitor.records import StatusRecord

#: seconds of the simulated drive: long enough to turn a corner, short enough for every day
DRIVE_SECONDS = 20
#: seconds of the drive that several runs are compared over
LONG_DRIVE_SECONDS = 60
#: exit code of images.sh where there is nothing to build upon
NO_BASE_IMAGE = 3
#: with what it depends on, all services but the one for whose sake `up` waits for a replay's end
DETACHED = "driver"
SERVICES = ("router", "store", "integration", "mapping", "odometry", "registration", "monitor")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Everything here needs Docker and is run by `make system`."""
    for item in items:
        if "tests/system" in str(item.path):
            item.add_marker(pytest.mark.system)


@pytest.fixture(scope="session")
def images() -> None:
    """The three images, made when they are not there; skipped with the reason without Docker."""
    asked = subprocess.run(["docker", "info"], capture_output=True, text=True, check=False)
    if asked.returncode != 0:
        pytest.skip(f"Docker does not answer: {asked.stderr.strip()}")
    if os.environ.get("ZLOAM_IMAGES") == "as-they-are":
        return
    built = subprocess.run(
        [ROOT / "deploy/docker/images.sh", "--prebuilt"],
        capture_output=True,
        text=True,
        check=False,
    )
    if built.returncode == NO_BASE_IMAGE:
        pytest.skip(f"no base image: {built.stderr.strip().splitlines()[-1]}")
    assert built.returncode == 0, built.stdout[-3000:] + built.stderr[-6000:]


@pytest.fixture(scope="session")
def view_image(images: None) -> None:
    """The one with Rerun and Foxglove."""
    if os.environ.get("ZLOAM_IMAGES") != "as-they-are":
        layers, environment = ["deploy/compose/views.yml"], {"ZLOAM_RUST": "prebuilt"}
        Deployment("zloam-images", ROOT / "out", layers, environment).run("build", "view")


@dataclass(frozen=True)
class Drive:
    """A simulated drive outside the containers, and its exact truth."""

    pcap: Path
    truth_base: Path


def drive_of(folder: Path, seconds: int, *options: str) -> Drive:
    """In the city, by the image's simulator: nothing needs to be built here."""
    subprocess.run(
        ["docker", "run", "--rm", "--user", f"{os.getuid()}:{os.getgid()}", "--network", "none",
         "--volume", f"{folder}:/drive", "zenoh-loam", "simulator", "--quiet", "--world", "city",
         "--seed", "3", "--duration", str(seconds), "--out", "/drive/capture.pcap",
         "--truth", "/drive/lidar.tum", "--truth-base", "/drive/base.tum", *options],
        check=True,
    )  # fmt: skip
    return Drive(folder / "capture.pcap", folder / "base.tum")


@pytest.fixture(scope="session")
def drive(images: None, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """Long enough to compare runs over it."""
    return drive_of(tmp_path_factory.mktemp("drive"), LONG_DRIVE_SECONDS)


@dataclass(frozen=True)
class Replayed:
    """What a replay of the drive left, and the last statuses of all stages."""

    out: Path
    report: dict[str, Any]
    statuses: dict[tuple[str, str], StatusRecord]


def replay(
    drive: Drive, out: Path, *options: str, layers: Sequence[str] = (), seconds: float = 300
) -> Replayed:
    """The capture through the deployment with these layers, and options of `up`."""
    deployment = Deployment(
        f"zloam-replay-{os.getpid()}",
        out,
        ["deploy/compose/replay.yml", *layers],
        {"ZLOAM_PCAP": str(drive.pcap)},
    )
    with up(deployment, *options):
        deployment.wait("finished", seconds, _ended)
        assert deployment.containers()["monitor"]["ExitCode"] == 0
        statuses = ask_statuses(deployment.router_port)
    return Replayed(out, json.loads((out / "report.json").read_text()), statuses)


@pytest.fixture(scope="session")
def undisturbed(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    """The drive through one instance of each stage, to which nothing is done."""
    return replay(drive, tmp_path_factory.mktemp("undisturbed"))


@contextlib.contextmanager
def up(deployment: Deployment, *options: str) -> Iterator[Deployment]:
    """`docker compose up` until all are healthy; what is there goes at the end, volumes too."""
    try:
        deployment.run("up", "--no-build", "--detach", *options, DETACHED)
        yield deployment
    finally:
        deployment.run("down", "--volumes", "--timeout", "20", check=False)


def ask_statuses(port: int) -> dict[tuple[str, str], StatusRecord]:
    """(stage, instance) -> status, of all that anybody knows of: also of killed ones."""
    session = open_client([f"tcp/127.0.0.1:{port}"])
    link = Link(session, Keys("robot"))
    link.query_statuses()
    link.close()
    session.close()
    return link.statuses


@dataclass
class Finished:
    """What one run left."""

    deployment: Deployment
    healthy_after_s: float
    poses_seen: int
    report: dict[str, Any]
    tiles_live: dict[str, int]
    containers: dict[str, dict[str, Any]]


def _healthy(containers: dict[str, dict[str, Any]]) -> bool:
    return all(
        name in containers
        and (containers[name].get("Health") == "healthy" or containers[name].get("ExitCode") == 0)
        and (containers[name]["State"] == "running" or name == "monitor")
        for name in SERVICES
    )


def _ended(containers: dict[str, dict[str, Any]]) -> bool:
    return containers.get("monitor", {}).get("State") == "exited"


def _count_poses(port: int, wanted: int, seconds: float) -> int:
    """Poses that a program outside the containers gets through the router."""
    session = open_client([f"tcp/127.0.0.1:{port}"])
    link = Link(session, Keys("robot"))
    deadline = time.monotonic() + seconds
    while len(link.poses) < wanted and time.monotonic() < deadline:
        link.poll(0.2)
    link.close()
    session.close()
    return len(link.poses)


def versions(port: int) -> dict[str, int]:
    """Cube -> version of the whole map, as anybody may ask for it."""
    session = open_client([f"tcp/127.0.0.1:{port}"])
    link = Link(session, Keys("robot"))
    tiles = {f"{t.layer}/{t.index}": t.version for t in link.query_tiles(["*"])}
    link.close()
    session.close()
    return tiles


def _start_once(deployment: Deployment) -> tuple[float, str]:
    """Seconds until all are healthy, and what `up` said if it failed."""
    began = time.monotonic()
    up = subprocess.Popen(
        deployment.command("up", "--no-build", "--detach", DETACHED),
        cwd=ROOT,
        env=deployment.variables(),
        stderr=subprocess.PIPE,
        text=True,
    )
    deployment.wait("all healthy", 180, lambda c: _healthy(c) or up.poll() not in (None, 0))
    healthy_after_s = time.monotonic() - began
    said = up.communicate(timeout=180)[1]
    return healthy_after_s, said if up.returncode != 0 else ""


def _start(deployment: Deployment) -> float:
    """Seconds until all are healthy. Begun once more where `up` lost a container that it had just
    created: nothing here removes any, so somebody else cleans this engine."""
    healthy_after_s, failure = _start_once(deployment)
    if "is missing dependency" in failure or "No such container" in failure:
        print(f"begun again: a container was removed while it started\n{failure}")
        deployment.run("down", "--volumes", "--timeout", "20", check=False)
        healthy_after_s, failure = _start_once(deployment)
    assert not failure, failure
    return healthy_after_s


@pytest.fixture(scope="session")
def run(images: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Finished]:
    """`docker compose up` with the simulator as source, to the end of the run."""
    out = tmp_path_factory.mktemp("compose")
    deployment = Deployment(
        f"zloam-system-{os.getpid()}",
        out,
        environment={"ZLOAM_DURATION": str(DRIVE_SECONDS), "ZLOAM_RATE": "realtime"},
    )
    try:
        healthy_after_s = _start(deployment)
        poses = _count_poses(deployment.router_port, 10, 60)
        deployment.wait("finished", 300, _ended)
        report = json.loads((out / "report.json").read_text())
        time.sleep(2.0)  # the store writes once a second
        yield Finished(
            deployment,
            healthy_after_s,
            poses,
            report,
            versions(deployment.router_port),
            deployment.containers(),
        )
    finally:
        deployment.run("down", "--volumes", "--timeout", "20", check=False)


def demo_command(out: Path, *options: str | Path) -> list[str]:
    """`make demo` without building: the stages as plain processes. Skipped when not built."""
    build = Path(os.environ.get("ZLOAM_BUILD", ROOT / "build" / "release"))
    if not (build / "bin" / "zloam-mapping").is_file():
        pytest.skip(f"not built in {build}: nothing to compare with")
    python = [ROOT / ".venv/bin/python", "-m", "zloam_monitor"]
    return [str(a) for a in (*python, "demo", "--preset-dir", build, "--out", out, *options)]


def demo_environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT / "services/monitor/src")}


@pytest.fixture(scope="session")
def demo_report(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The same drive by the same stages as plain processes."""
    out = tmp_path_factory.mktemp("demo")
    done = subprocess.run(
        demo_command(out, "--simulate=--duration", f"--simulate={DRIVE_SECONDS}"),
        cwd=ROOT,
        env=demo_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads((out / "report.json").read_text())
