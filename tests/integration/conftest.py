"""Fixtures and helpers for tests with real processes: programs, recordings, short captures from the
simulator."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from zloam_monitor.chain import Chain
from zloam_monitor.stages import STAGES

ROOT = Path(__file__).resolve().parents[2]
#: length of the short simulated capture in s; the sensor makes 10 sweeps a second
CAPTURE_SECONDS = 6


@dataclass(frozen=True)
class Capture:
    """A simulated drive and its exact truth."""

    pcap: Path
    truth_lidar: Path
    truth_base: Path


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs each test in a folder of its own, so that a stage's default output folder (out/) does
    not hold the map of an earlier test, which the stage would resume."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def build() -> Path:
    """The build folder under test: ZLOAM_BUILD, or build/release."""
    folder = Path(os.environ.get("ZLOAM_BUILD", ROOT / "build" / "release")).resolve()
    missing = [s for s in (*STAGES, "simulator") if not (folder / "bin" / f"zloam-{s}").is_file()]
    if missing:
        pytest.skip(f"not built in {folder}: zloam-{', zloam-'.join(missing)}")
    return folder


@pytest.fixture(scope="session")
def decode() -> Path:
    """The decoding tool zloam-decode, which runs without any stage."""
    folder = Path(os.environ.get("ZLOAM_BUILD", ROOT / "build" / "release"))
    tool = folder / "bin" / "zloam-decode"
    if not tool.is_file():
        pytest.skip(f"not built: {tool}")
    return tool


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings, which is not in the repository."""
    folder = Path(os.environ.get("ZLOAM_SHARED", ROOT.parent / "shared")).resolve()
    if not (folder / "data").is_dir():
        pytest.skip(f"no recordings in {folder} (set ZLOAM_SHARED)")
    return folder


def simulate(build: Path, folder: Path, *options: str) -> Capture:
    """Simulates a capture with these options of zloam-simulator."""
    made = Capture(folder / "capture.pcap", folder / "lidar.tum", folder / "base.tum")
    subprocess.run(
        [
            build / "bin" / "zloam-simulator",
            "--quiet",
            "--out",
            made.pcap,
            "--truth",
            made.truth_lidar,
            "--truth-base",
            made.truth_base,
            *options,
        ],
        check=True,
    )
    return made


@pytest.fixture(scope="session")
def capture(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A few seconds of driving in the simulated city."""
    folder = tmp_path_factory.mktemp("capture")
    seconds = str(CAPTURE_SECONDS)
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", seconds)


@pytest.fixture(scope="session")
def robot_file() -> Path:
    return ROOT / "deploy" / "robots" / "vlp16-outdoor.yaml"


def digests(folder: Path, files: tuple[str, ...]) -> dict[str, str]:
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in files}


@cache
def _answers(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def needs_compose() -> None:
    """Skips a test that calls `docker compose` where it is not installed."""
    if not _answers("docker", "compose", "version"):
        pytest.skip("docker, or its Compose, is not installed")


#: Nothing is waited for longer than this; it only limits the time of a test that fails.
PATIENCE_S = 60.0


def until(chain: Chain, holds: Callable[[], object]) -> None:
    """Follows the chain until this holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        chain.link.poll(0.05)
        chain.check()
        assert time.monotonic() < deadline, chain.link.statuses


def kill(chain: Chain, *stages: str) -> None:
    """Sends SIGKILL to all of these stages, then waits for their ends."""
    killed = [chain.processes.running.pop(stage) for stage in stages]
    for process in killed:
        process.send(signal.SIGKILL)
    for process in killed:
        process.wait(PATIENCE_S)


class WithoutDriver(Chain):
    """The chain without our driver, for sweeps that another program publishes."""

    def start(self, stage: str, log: str | None = None) -> None:
        if stage != "driver":
            super().start(stage, log)


@dataclass(frozen=True)
class Done:
    """Exit code and output of a program that has ended."""

    code: int
    said: str


def monitor(*arguments: object) -> Done:
    """Runs `python -m zloam_monitor ...` from the root of the repository."""
    paths = [str(ROOT / "services/monitor/src"), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-m", "zloam_monitor", *map(str, arguments)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=280,
    )
    return Done(done.returncode, done.stdout)
