"""Docker, the images, and one complete run of the default deployment, which several tests use."""

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

#: length of the simulated drive in s: long enough to turn a corner, short enough to run every day
DRIVE_SECONDS = 20
#: length in s of the drive over which several runs are compared
LONG_DRIVE_SECONDS = 60
#: exit code of images.sh if the base image is missing
NO_BASE_IMAGE = 3
#: Starting `driver` starts all services that it depends on, thus all but the one that only makes
#: `up` wait for the end of a replay.
DETACHED = "driver"
SERVICES = ("router", "store", "integration", "mapping", "odometry", "registration", "monitor")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All tests here need Docker and are run by `make system`."""
    for item in items:
        if "tests/system" in str(item.path):
            item.add_marker(pytest.mark.system)


@pytest.fixture(scope="session")
def images() -> None:
    """The three images, built if they are missing; skips with the reason without Docker."""
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
    """The image with Rerun and Foxglove."""
    if os.environ.get("ZLOAM_IMAGES") != "as-they-are":
        layers, environment = ["deploy/compose/views.yml"], {"ZLOAM_RUST": "prebuilt"}
        Deployment("zloam-images", ROOT / "out", layers, environment).run("build", "view")


@dataclass(frozen=True)
class Drive:
    """A simulated drive outside the containers, and its exact truth."""

    pcap: Path
    truth_base: Path


def drive_of(folder: Path, seconds: int, *options: str) -> Drive:
    """A drive in the city by the image's simulator, so that nothing needs to be built here."""
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
    """A drive long enough to compare runs over it."""
    return drive_of(tmp_path_factory.mktemp("drive"), LONG_DRIVE_SECONDS)


@dataclass(frozen=True)
class Replayed:
    """The results of a replay of the drive, and the final statuses of all stages."""

    out: Path
    report: dict[str, Any]
    statuses: dict[tuple[str, str], StatusRecord]


def replay(
    drive: Drive, out: Path, *options: str, layers: Sequence[str] = (), seconds: float = 300
) -> Replayed:
    """Replays the capture by a deployment with these layers and options of `up`."""
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
    """The drive through one instance of each stage, undisturbed."""
    return replay(drive, tmp_path_factory.mktemp("undisturbed"))


@contextlib.contextmanager
def up(deployment: Deployment, *options: str) -> Iterator[Deployment]:
    """`docker compose up` until all services are healthy; removes everything at the end, volumes
    included."""
    try:
        deployment.run("up", "--no-build", "--detach", *options, DETACHED)
        yield deployment
    finally:
        deployment.run("down", "--volumes", "--timeout", "20", check=False)


def ask_statuses(port: int) -> dict[tuple[str, str], StatusRecord]:
    """(stage, instance) -> status, of all instances that any process remembers, killed ones
    included."""
    session = open_client([f"tcp/127.0.0.1:{port}"])
    link = Link(session, Keys("robot"))
    link.query_statuses()
    link.close()
    session.close()
    return link.statuses


@dataclass
class Finished:
    """The results of one run."""

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
    """Number of poses that a program outside the containers receives through the router."""
    session = open_client([f"tcp/127.0.0.1:{port}"])
    link = Link(session, Keys("robot"))
    deadline = time.monotonic() + seconds
    while len(link.poses) < wanted and time.monotonic() < deadline:
        link.poll(0.2)
    link.close()
    session.close()
    return len(link.poses)


def versions(port: int) -> dict[str, int]:
    """Cube -> version of the whole map, as any client can query it."""
    session = open_client([f"tcp/127.0.0.1:{port}"])
    link = Link(session, Keys("robot"))
    tiles = {f"{t.layer}/{t.index}": t.version for t in link.query_tiles(["*"])}
    link.close()
    session.close()
    return tiles


def _start_once(deployment: Deployment) -> tuple[float, str]:
    """Seconds until all services are healthy, and the output of `up` if it failed."""
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
    """Seconds until all services are healthy. Tries once more if `up` lost a container that it had
    just created: nothing here removes containers, so another program cleans up this Docker
    engine."""
    healthy_after_s, failure = _start_once(deployment)
    if "is missing dependency" in failure or "No such container" in failure:
        print(f"begun again: a container was removed while it started\n{failure}")
        deployment.run("down", "--volumes", "--timeout", "20", check=False)
        healthy_after_s, failure = _start_once(deployment)
    assert not failure, failure
    return healthy_after_s


@pytest.fixture(scope="session")
def run(images: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Finished]:
    """`docker compose up` with the simulator as the source, until the end of the run."""
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
    """Command of `make demo` without building: the stages as plain processes. Skips if they are not
    built."""
    build = Path(os.environ.get("ZLOAM_BUILD", ROOT / "build" / "release"))
    if not (build / "bin" / "zloam-mapping").is_file():
        pytest.skip(f"not built in {build}: nothing to compare with")
    python = [ROOT / ".venv/bin/python", "-m", "zloam_monitor"]
    return [str(a) for a in (*python, "demo", "--preset-dir", build, "--out", out, *options)]


def demo_environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT / "services/monitor/src")}


@pytest.fixture(scope="session")
def demo_report(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The report of the same drive with the same stages as plain processes."""
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
