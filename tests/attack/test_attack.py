"""A stranger on the network during a live run sends each kind of message, forged in each way.

Requirements: no process dies or needs a restart, every refused message is counted by its reason,
memory is released, and from one second after the attack's end every sweep has its pose again.
"""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tests.attack import forge
from tests.integration import live_run
from tests.integration.conftest import PATIENCE_S, Capture, simulate
from tests.integration.live_run import LiveRun, one_quick
from zloam_monitor import messages
from zloam_monitor.link import open_session
from zloam_monitor.processes import endpoints
from zloam_monitor.records import StatusRecord
from zloam_monitor.trajectory import read

#: number of received poses at which the attack begins
BEGINS_AT = 25
#: sweeps per second
RATE = 10
#: poses after the attack, of which the first second's do not count
JUDGED = 4 * RATE
SHARE = 0.9
#: Limit of a stage's memory: a factor on that without an attack, plus what the allocator may keep.
MEMORY_SHARE, MEMORY_MIB = 1.2, 24.0
FLOOD_RATE = 5000
LONG_S = 68.0
#: Reasons for forged messages only; a busy machine's own messages may be dropped as the others.
FORGED = ("garbage", "invalid", "wrong_run", "fenced")
REFUSED = (*FORGED, "duplicate", "late")
STAGES = ("registration", "odometry", "mapping", "integration")


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    seconds = str(live_run.SECONDS + live_run.SPARE_S)
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", seconds)


@pytest.fixture(scope="module")
def long_drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("long_drive")
    return simulate(
        build, folder, "--world", "city", "--seed", "3", "--duration", str(int(LONG_S) + 2)
    )


def run_calm(build: Path, robot_file: Path, drive: Capture, out: Path) -> dict[str, StatusRecord]:
    run = LiveRun(build, robot_file, drive, out, seconds=LONG_S)
    with run:
        return run.end()


class Stranger:
    """Receives one genuine message of each key and makes forgeries of them."""

    def __init__(self, run: LiveRun) -> None:
        self.run = run
        self.session = open_session(endpoints(run.chain.base_port))
        keys = run.chain.link.keys
        self.tables = {
            keys.sweep: "Sweep",
            keys.features: "Features",
            keys.odometry: "Odometry",
            keys.odometry_features: "OdometryFeatures",
            keys.map_correction: "MapCorrection",
            keys.map_odometry: "MapPose",
            keys.tiles: "MapTile",
        }
        self.heard: dict[str, tuple[str, bytes]] = {}
        self._listeners = [self._listen(key, table) for key, table in self.tables.items()]
        self.forgers = forge.forgers(random.Random(7))
        self.sent = 0

    def _listen(self, key: str, table: str) -> Any:
        def hear(sample: zenoh.Sample) -> None:
            self.heard[table] = (str(sample.key_expr), sample.payload.to_bytes())

        # excludes its own forgeries
        return self.session.declare_subscriber(key, hear, allowed_origin=zenoh.Locality.REMOTE)

    def __enter__(self) -> Stranger:
        return self

    def __exit__(self, *_: object) -> None:
        self._listeners.clear()
        self.session.close()

    def put(self, table: str, how: str) -> None:
        key, data = self.heard[table]
        forged = self.forgers[how](data, table)
        if forged is not None:
            self.session.put(key, forged, encoding=messages.encoding(table))
            self.sent += 1

    def put_all(self) -> None:
        """Publishes one forgery of each kind for each key."""
        for how in self.forgers:
            for table in list(self.heard):
                self.put(table, how)
        self.put_words()

    def put_words(self) -> None:
        """Publishes forgeries of messages without a header."""
        keys = self.run.chain.link.keys
        newest = next(reversed(self.run.poses.values()))
        for stage, data in forge.revisions():
            self.session.put(
                keys.revision(stage), data, encoding=messages.encoding("ConfigRevision")
            )
        self.session.put(
            keys.below("odometry/progress"),
            forge.progress(newest.run),
            encoding=messages.encoding("Progress"),
        )

    def put_huge(self) -> None:
        huge = bytes(forge.HUGE_BYTES)
        for table, (key, _) in list(self.heard.items()):
            self.session.put(key, huge, encoding=messages.encoding(table))
            self.sent += 1

    def flood(self, table: str, how: str, seconds: float) -> None:
        """Publishes FLOOD_RATE forgeries per second, or as many as possible. They are made
        beforehand, since making them takes longer."""
        key, data = self.heard[table]
        forged = [self.forgers[how](data, table) for _ in range(50)]
        encoding = messages.encoding(table)
        began = time.monotonic()
        count = 0
        while (now := time.monotonic() - began) < seconds:
            burst = int(now * FLOOD_RATE)
            while count < burst and time.monotonic() - began < seconds:
                payload = forged[count % len(forged)]
                if payload is not None:
                    self.session.put(key, payload, encoding=encoding)
                count += 1
            time.sleep(0.001)
        self.sent += count

    def command(self, stage: str, payload: str) -> Any:
        """The one reply to a command `set`."""
        key = self.run.chain.link.keys.command(stage, "set")
        answers = list(self.session.get(key, payload=payload, timeout=5.0))
        assert len(answers) == 1, (stage, len(payload), answers)
        return messages.decode("CommandReply", answers[0].ok.payload.to_bytes())


def statuses_of(run: LiveRun) -> dict[str, StatusRecord]:
    run.chain.link.query_statuses()
    return run.chain.statuses()


def refused(status: StatusRecord, reasons: tuple[str, ...] = REFUSED) -> int:
    return sum(i.dropped.get(reason, 0) for i in status.inputs for reason in reasons)


def busy(statuses: dict[str, StatusRecord]) -> int:
    """Number of sweeps dropped because the machine was too busy, not because of the attack."""
    reasons = ("queue_full", "late")
    inputs = [i for stage in STAGES if stage in statuses for i in statuses[stage].inputs]
    return sum(i.lost + sum(i.dropped.get(reason, 0) for reason in reasons) for i in inputs)


Record = Callable[[str, object], None]


def assert_recovered(run: LiveRun, attacked: dict[str, StatusRecord], record: Record) -> None:
    """Checks a run that has ended; `attacked`: the statuses at the end of the attack."""
    after = max(s.last_sweep or 0 for s in attacked.values())
    ended = {stage: run.chain.statuses()[stage] for stage in STAGES}
    last = max(p.sweep for p in run.poses.values())
    sweeps = [p.sweep for p in run.poses.values() if p.sweep > after + RATE]
    if last - after <= 2 * RATE:
        # Otherwise a robot that gives no pose any more would be skipped, too.
        sent = run.chain.statuses()["driver"].last_sweep or 0
        assert sent - after <= 3 * RATE, f"no poses after sweep {last}; the driver sent {sent}"
        pytest.skip("the machine is too busy: the attack ended with the drive")
    given_up = busy(ended) - busy(attacked)
    least = RATE
    for begin in range(after + RATE + 1, last - RATE + 1, RATE):
        seen = sum(begin <= sweep < begin + RATE for sweep in sweeps)
        assert seen >= SHARE * RATE - given_up, f"{seen} poses of the ten sweeps from {begin} on"
        assert seen > 0
        least = min(least, seen)
    record("poses of ten sweeps, at least", least)
    record("refused", {stage: refused(status) for stage, status in ended.items()})
    assert len({p.run for p in run.poses.values()}) == 1
    for stage, status in ended.items():
        assert all(i.balanced() for i in status.inputs), stage


def assert_memory_back(run: LiveRun, calm: dict[str, StatusRecord]) -> None:
    """Checks a run that has ended; `calm`: the statuses before the attack."""
    for stage in STAGES:
        # Only the stage's own memory: the pools of shared memory belong to all.
        held = calm[stage].figures["rss_anon_mib"]
        grown = run.chain.statuses()[stage].figures["rss_anon_mib"] - held * MEMORY_SHARE
        assert grown < MEMORY_MIB, f"{stage} kept {grown:.0f} MiB"


def test_one_of_everything(
    build: Path,
    robot_file: Path,
    drive: Capture,
    tmp_path: Path,
    record_property: Record,
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path)
    with run, Stranger(run) as stranger:
        run.until_poses(BEGINS_AT)
        before = statuses_of(run)
        refused_before = {stage: refused(before[stage]) for stage in STAGES}
        assert len(stranger.heard) == len(stranger.tables)
        stranger.put_all()
        for stage in ("registration", "odometry", "mapping"):
            assert not stranger.command(stage, "[" * forge.NESTED).Ok()
            assert not stranger.command(stage, "x" * 1_000_000).Ok()
        stranger.put_huge()
        run.until_poses_or_end(len(run.poses) + 1)
        attacked = statuses_of(run)
        run.until_poses_or_end(len(run.poses) + JUDGED)
        statuses = run.end()
    assert_recovered(run, attacked, record_property)
    for stage in STAGES:
        assert refused(statuses[stage]) - refused_before[stage] >= len(stranger.forgers) - 3, stage
    for stage in ("registration", "odometry", "mapping"):
        assert statuses[stage].config_rev == 0


@pytest.mark.parametrize("how", one_quick(("other run", "far sweep", "wild values"), "other run"))
def test_a_flood(
    build: Path,
    robot_file: Path,
    drive: Capture,
    tmp_path: Path,
    record_property: Record,
    how: str,
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path)
    with run, Stranger(run) as stranger:
        run.until_poses(BEGINS_AT)
        before = refused(statuses_of(run)["integration"], FORGED)
        stranger.flood("Odometry", how, 1.0)
        stranger.flood("MapCorrection", how, 0.5)
        attacked = statuses_of(run)
        run.until_poses_or_end(len(run.poses) + JUDGED)
        statuses = run.end()
    # It reads both kinds of messages.
    assert refused(statuses["integration"], FORGED) > before
    assert_recovered(run, attacked, record_property)


@pytest.mark.slow
def test_each_kind_in_each_way_at_length(
    build: Path,
    robot_file: Path,
    long_drive: Capture,
    tmp_path: Path,
    record_property: Record,
) -> None:
    undisturbed = run_calm(build, robot_file, long_drive, tmp_path / "calm")
    run = LiveRun(build, robot_file, long_drive, tmp_path, seconds=LONG_S)
    with run, Stranger(run) as stranger:
        run.until_poses(BEGINS_AT)
        run._until(lambda: len(stranger.heard) == len(stranger.tables))
        for table in list(stranger.heard):
            for how in stranger.forgers:
                stranger.flood(table, how, 0.5)
                run._poll()
            stranger.put_words()
        stranger.put_huge()
        attacked = statuses_of(run)
        statuses = run.end()
    for stage in STAGES:
        assert refused(statuses[stage], FORGED) > 0, stage
    assert_recovered(run, attacked, record_property)
    assert_memory_back(run, undisturbed)


def instances(run: LiveRun, heard: list[tuple[str, int]]) -> Any:
    """Records which instance published each pose."""

    def note(sample: zenoh.Sample) -> None:
        header = messages.decode("MapPose", sample.payload.to_bytes()).Header()
        heard.append((messages.text(header.Instance()), header.Sweep()))

    return run.chain.link.session.declare_subscriber(run.chain.link.keys.pose, note)


@pytest.mark.parametrize(
    "stage", ["driver", *one_quick(("odometry", "mapping", "integration"), "odometry")]
)
def test_a_second_instance_stands_by_and_both_say_so(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, stage: str
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path)
    heard: list[tuple[str, int]] = []
    with run:
        listener = instances(run, heard)
        run.until_poses(BEGINS_AT)
        link = run.chain.link
        first = link.stage(stage).instance
        run.chain.start_replica(stage, "second")

        def said() -> bool:
            told = {s.instance: s.reason for s in link.statuses.values() if s.stage == stage}
            texts = [told.get(name, "") for name in (first, "second")]
            return all(f"a second {stage}" in text for text in texts)

        run._until(said)
        after = run._driver_sweep()
        second = run.chain.processes.running.pop("second")
        second.send(signal.SIGTERM)
        assert second.wait(PATIENCE_S) == 0
        run._until(lambda: "a second" not in link.statuses[(stage, first)].reason)
        run.until_poses(len(run.poses) + RATE)
        statuses = run.end()
        del listener
    assert f"a second {stage}" in (tmp_path / "second.log").read_text()
    assert len({instance for instance, _ in heard}) == 1
    # The written trajectory counts: a mere subscriber may miss poses on a busy machine.
    sweeps = statuses["driver"].last_sweep + 1
    poses = len(read(tmp_path / "trajectory.tum"))
    assert statuses["integration"].last_sweep > after
    assert sweeps - poses <= (1 - SHARE) * sweeps + busy(statuses)
