"""Dropped messages, another pace of replay, a slow subscriber: the results stay the same."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance import live
from tests.integration.conftest import PATIENCE_S, ROOT, Capture, digests, kill, monitor, until
from zloam_monitor import sources
from zloam_monitor.chain import Chain
from zloam_monitor.keys import topic_of
from zloam_monitor.processes import endpoints
from zloam_monitor.robot_file import names
from zloam_monitor.stages import STAGES

FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum", "map.pcd")
#: stages between driver and pose, none of which may lose a sweep
POSE_PATH = ("registration", "odometry", "integration")
LIVE_SECONDS = 4.0
#: The live capture is sent this many times slower than recorded, so that a busy machine drops
#: nothing.
LIVE_SLOWER = 2.0
#: time that the slow subscriber takes for each message; a live sweep causes a dozen messages
SLOW_SECONDS, SLOW_REPLAY_SECONDS = 0.1, 0.02


def replay(
    build: Path, capture: Capture, out: Path, *options: object
) -> tuple[dict[str, str], dict[str, Any]]:
    """Digests of the result files, and the report."""
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, "--out", out, *options)
    assert done.code == 0, done.said
    return digests(out, FILES), json.loads((out / "report.json").read_text())


def assert_books(report: dict[str, Any]) -> None:
    books = report["identities"]
    assert books["inputs_balanced"], books["complaints"]
    assert books["sweeps_accounted"], books["complaints"]
    assert books["poses"] == books["sweeps"]


@pytest.fixture(scope="module")
def untroubled(
    build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    """Digests of the files of an undisturbed replay."""
    return replay(build, capture, tmp_path_factory.mktemp("untroubled"))[0]


@pytest.mark.parametrize("every", [7, 2])
def test_dropped_messages_are_recovered(
    build: Path,
    capture: Capture,
    untroubled: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    every: int,
) -> None:
    """Each stage drops every n-th message of each of its inputs (n = `every`)."""
    monkeypatch.setenv("ZLOAM_FAULT_DROP_EVERY", str(every))
    files, report = replay(build, capture, tmp_path, "--set", "recovery.gap_replay_ms=50")
    assert files == untroubled
    assert_books(report)
    sweeps = report["sweeps"]
    for stage in STAGES[1:]:
        assert sweeps[stage]["recovered"] > 0, stage
        assert sweeps[stage]["lost"] == 0, stage
        assert set(sweeps[stage]["dropped"]) <= {"duplicate"}, stage


def test_the_pace_is_in_no_file(
    build: Path, capture: Capture, untroubled: dict[str, str], tmp_path: Path
) -> None:
    files, report = replay(build, capture, tmp_path, "--rate", "realtime")
    assert files == untroubled
    assert_books(report)


class SlowReader:
    """A third party's subscriber of all keys of the robot that takes long for each message."""

    def __init__(
        self, base_port: int, key: str, folder: Path, seconds: float = SLOW_SECONDS
    ) -> None:
        self._said = folder / "slow_reader.txt"
        arguments = [str(seconds), key, *endpoints(base_port)]
        with self._said.open("wb") as out:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.integration.slow_reader", *arguments],
                cwd=ROOT,
                env={**os.environ, "PYTHONPATH": str(ROOT / "services/monitor/src")},
                stdout=out,
            )

    def seen(self) -> int:
        """Number of messages read so far."""
        return max(0, len(self._said.read_text().splitlines()) - 1)

    def read(self) -> dict[str, tuple[int, int]]:
        """Topic -> (number of its newest message, messages before it that did not arrive)."""
        whole = self._said.read_text().rpartition("\n")[0].splitlines()[1:]
        lines = [line.split() for line in whole]
        return {topic: (int(seq), int(lost)) for topic, seq, lost in lines if seq != "-"}

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def run_live(
    build: Path, robot_file: Path, capture: Capture, logs: Path, slow: bool
) -> tuple[dict[str, Any], int, int]:
    """(final statuses, poses, messages that the slow subscriber read)."""
    port, robot = live.free_udp_port(), names(robot_file, [])
    settings = [
        "driver.source=udp",
        f"driver.port={port}",
        "driver.position_port=0",
        f"integration.output_dir={logs}",
    ]
    chain = Chain(build, robot_file, robot.robot, settings, logs, robot.sensor)
    with chain:
        chain.wait_linked()
        link = chain.link
        reader = SlowReader(chain.base_port, link.keys.below("**"), logs) if slow else None
        try:
            deadline = time.monotonic() + PATIENCE_S
            while reader and reader.seen() == 0:  # statuses are published all the time
                assert time.monotonic() < deadline, "the slow reader reads nothing"
                link.poll(0.1)
            sender = threading.Thread(
                target=live.send, args=(capture.pcap, port, LIVE_SECONDS, LIVE_SLOWER)
            )
            sender.start()
            while sender.is_alive():
                link.poll(0.2)
                chain.processes.check()
            ends = time.monotonic() + live.AFTER_SECONDS
            while time.monotonic() < ends:
                link.poll(0.2)
            seen = reader.seen() if reader else 0
            link.query_statuses()
        finally:
            if reader:
                reader.close()
        chain.stop()
        statuses = chain.statuses()
        # Published poses count, not those that arrived here: the monitor's own link does not
        # matter.
        poses = statuses["integration"].published[link.keys.pose]
        return statuses, poses, seen


@pytest.mark.parametrize("slow", [False, True], ids=["alone", "beside a slow reader"])
def test_a_slow_reader_is_nobody_elses_trouble(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path, slow: bool
) -> None:
    statuses, poses, seen = run_live(build, robot_file, capture, tmp_path, slow)
    sweeps = statuses["driver"].last_sweep + 1
    assert sweeps >= LIVE_SECONDS * 9
    assert poses == sweeps, {s: statuses[s].inputs for s in POSE_PATH}
    for stage in POSE_PATH:
        for account in statuses[stage].inputs:
            # Live mapping takes only the newest input: sweeps that it skips lose no pose.
            wanted = account.received if account.key.endswith("map/correction") else sweeps
            assert account.processed == account.received == wanted, (stage, account)
            assert account.lost == 0, (stage, account)
    published = sum(sum(s.published.values()) for s in statuses.values())
    # Unless the subscriber was too slow for all messages, the test proves nothing.
    assert not slow or 0 < seen < published


def replaying(build: Path, robot_file: Path, capture: Capture, logs: Path) -> Chain:
    robot = names(robot_file, [])
    settings = [
        *sources.from_pcap(capture.pcap).driver_settings("realtime"),
        f"integration.output_dir={logs}",
    ]
    return Chain(build, robot_file, robot.robot, settings, logs, robot.sensor)


def until_poses(chain: Chain) -> None:
    while len(chain.link.poses) < 5:
        chain.link.poll(0.2)
        chain.check()


def test_a_replay_waits_for_a_slow_reader_of_the_map(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    """What a recorder or a store keeps of a replay must not depend on how fast it is."""
    with replaying(build, robot_file, capture, tmp_path) as chain, contextlib.ExitStack() as stack:
        key = chain.link.keys.below("map/**")
        reader = SlowReader(chain.base_port, key, tmp_path, SLOW_REPLAY_SECONDS)
        stack.callback(reader.close)
        until(chain, chain.finished)
        chain.link.query_statuses()
        published = chain.statuses()["mapping"].published
        newest = {topic_of(key): number - 1 for key, number in published.items() if number}
        newest = {key: number for key, number in newest.items() if "/map/" in key}
        until(chain, lambda: {topic: seq for topic, (seq, _) in reader.read().items()} == newest)
        lost = {topic: lost for topic, (_, lost) in reader.read().items()}
    assert lost == dict.fromkeys(newest, 0)


def orphans() -> set[Path]:
    """Shared-memory segments that no living process has mapped."""
    mapped = ""
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with contextlib.suppress(OSError):
            mapped += maps.read_text()
    return {path for path in Path("/dev/shm").iterdir() if str(path) not in mapped}


def test_shared_memory_of_the_killed_is_reclaimed(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    """A SIGKILL leaves segments behind; they are removed when a stage is started the next time."""
    with replaying(build, robot_file, capture, tmp_path / "a") as chain:
        until_poses(chain)
        kill(chain, *chain.processes.running)
    left = orphans()
    assert left, "nothing was shared: the test shows nothing"
    with replaying(build, robot_file, capture, tmp_path / "b") as chain:
        until_poses(chain)
        assert not left & orphans()


def test_registration_is_killed_and_started_again(
    build: Path, robot_file: Path, capture: Capture, untroubled: dict[str, str], tmp_path: Path
) -> None:
    """Registration has no state: sweeps that were under way are published again, and the new
    process computes them."""
    with replaying(build, robot_file, capture, tmp_path) as chain:
        until_poses(chain)
        kill(chain, "registration")
        chain.start("registration", "registration-again")
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
        chain.link.query_statuses()
        poses = len(chain.link.poses)
        codes = chain.stop()
        statuses = chain.statuses()
    assert set(codes.values()) == {0}
    assert poses == statuses["driver"].last_sweep + 1
    for stage in ("odometry", "mapping", "integration"):
        for account in statuses[stage].inputs:
            assert account.balanced(), (stage, account)
            assert account.lost == 0, (stage, account)
    files = ("trajectory.tum", "odometry.tum")
    assert digests(tmp_path, files) == {name: untroubled[name] for name in files}
