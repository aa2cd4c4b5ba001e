"""Several instances of registration share the sweeps; the results equal those of a single
instance."""

import signal
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.integration.conftest import PATIENCE_S, Capture, digests, until
from zloam_monitor import sources
from zloam_monitor.chain import Chain
from zloam_monitor.processes import StageDied
from zloam_monitor.records import StatusRecord
from zloam_monitor.robot_file import names

Files = dict[str, str]
Statuses = dict[tuple[str, str], StatusRecord]
FILES = ("trajectory.tum", "odometry.tum", "map.pcd")
REPLICAS = ("registration-a", "registration-b", "registration-c")
#: pace of the replay relative to real time: slow enough for replicas to join and leave
SLOW = "0.4"


class SharedChain(Chain):
    """The chain with several replicas of registration, all started before the driver."""

    def __init__(
        self,
        build: Path,
        robot_file: Path,
        capture: Capture,
        logs: Path,
        rate: str = "max",
        set_at: Sequence[str] = (),
    ) -> None:
        robot = names(robot_file, [])
        settings = [
            *sources.from_pcap(capture.pcap).driver_settings(rate),
            f"integration.output_dir={logs}",
            f"mapping.map_path={logs / 'map.pcd'}",
        ]
        super().__init__(build, robot_file, robot.robot, settings, logs, robot.sensor, set_at)
        #: instance -> its environment
        self.replicas: dict[str, dict[str, str]] = {REPLICAS[0]: {}}
        self.logs = logs

    def start(self, stage: str, log: str | None = None) -> None:
        if stage != "registration":
            super().start(stage, log)
            return
        for instance, environment in self.replicas.items():
            self.start_replica("registration", instance, environment)
        until(self, lambda: self.ready() >= set(self.replicas))

    def ready(self) -> set[str]:
        """Instances of registration whose status says ready."""
        found = self.link.statuses.items()
        return {i for (stage, i), s in found if stage == "registration" and s.health == "ready"}

    def sharing(self) -> set[str]:
        """Instances of registration that have processed a sweep."""
        found = self.link.statuses.items()
        return {
            i
            for (stage, i), status in found
            if stage == "registration" and any(each.processed for each in status.inputs)
        }

    def follow(self) -> Statuses:
        """Follows the run to its end; returns the final statuses of all instances."""
        began = time.monotonic()
        while not self.finished():
            self.link.poll(0.2)
            self.check()
            assert time.monotonic() - began < 4 * PATIENCE_S
        self.link.query_statuses()
        codes = self.stop()
        assert set(codes.values()) == {0}, codes
        return self.link.statuses


class Mourning(SharedChain):
    """The chain keeps running without replicas that were killed."""

    def __init__(self, build: Path, robot_file: Path, capture: Capture, logs: Path) -> None:
        super().__init__(build, robot_file, capture, logs)
        self.dead: set[str] = set()

    def check(self) -> None:
        """Decides by the process that the check found dead: checking again might find another one,
        as a process may die in between."""
        try:
            super().check()
        except StageDied as died:
            if died.stage not in self.replicas or died.code != -signal.SIGKILL:
                raise
            del self.processes.running[died.stage]
            self.dead.add(died.stage)
            self.check()


def books(chain: SharedChain, statuses: Statuses) -> Counter[str]:
    """Checks both identities of docs/protocol.md, section 2, and that each sweep came once; returns
    the sum of all figures."""
    for (stage, instance), status in statuses.items():
        for account in status.inputs:
            assert account.balanced(), (stage, instance, account)
            assert account.lost == 0, (stage, instance, account)
            assert set(account.dropped) <= {"duplicate"}, (stage, instance, account)
    of = {stage: status for (stage, _), status in statuses.items()}
    last = of["driver"].last_sweep
    assert last is not None
    sweeps = last + 1
    assert sorted(chain.link.poses) == list(range(sweeps))
    pose_key = chain.link.keys.pose
    assert of["integration"].published[pose_key] == sweeps
    assert len((chain.logs / "trajectory.tum").read_text().splitlines()) == sweeps
    features = of["odometry"].inputs[0]
    assert features.processed == sweeps
    return Counter(duplicates=features.dropped.get("duplicate", 0), sweeps=sweeps)


def shares(statuses: Statuses) -> tuple[dict[str, int], dict[str, int]]:
    """By instance of registration: sweeps that it has processed, and those that it left to
    others."""
    of = {i: s.inputs[0] for (stage, i), s in statuses.items() if stage == "registration"}
    return {i: a.processed for i, a in of.items()}, {i: a.not_mine for i, a in of.items()}


@pytest.fixture(scope="module")
def alone(
    build: Path, robot_file: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory
) -> Files:
    """Digests of a run with one instance, which processes every sweep."""
    logs = tmp_path_factory.mktemp("alone")
    with SharedChain(build, robot_file, capture, logs) as chain:
        statuses = chain.follow()
        sweeps = books(chain, statuses)["sweeps"]
    assert shares(statuses) == ({REPLICAS[0]: sweeps}, {REPLICAS[0]: 0})
    return digests(logs, FILES)


def test_three_share_the_sweeps(
    build: Path, robot_file: Path, capture: Capture, alone: Files, tmp_path: Path
) -> None:
    chain = SharedChain(build, robot_file, capture, tmp_path)
    chain.replicas = {instance: {} for instance in REPLICAS}
    with chain:
        statuses = chain.follow()
        found = books(chain, statuses)
    assert digests(tmp_path, FILES) == alone
    computed, _ = shares(statuses)
    assert set(computed) == set(REPLICAS)
    assert all(count > 0 for count in computed.values()), computed
    assert sum(computed.values()) >= found["sweeps"]


def test_one_three_one_during_a_run(
    build: Path, robot_file: Path, capture: Capture, alone: Files, tmp_path: Path
) -> None:
    with SharedChain(build, robot_file, capture, tmp_path, SLOW) as chain:
        until(chain, lambda: len(chain.link.poses) >= 5)
        for instance in REPLICAS[1:]:
            chain.start_replica("registration", instance)
        until(chain, lambda: chain.ready() >= set(REPLICAS))
        until(chain, lambda: chain.sharing() >= set(REPLICAS))
        for instance in REPLICAS[1:]:
            process = chain.processes.running.pop(instance)
            process.send(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        statuses = chain.follow()
        books(chain, statuses)
    assert digests(tmp_path, FILES) == alone
    computed, _ = shares(statuses)
    assert all(computed[instance] > 0 for instance in REPLICAS), computed


def test_a_replica_is_killed_between_receipt_and_output(
    build: Path, robot_file: Path, capture: Capture, alone: Files, tmp_path: Path
) -> None:
    """The replica kills itself at the first sweep from 20 on that it begins; the others process the
    sweep again."""
    chain = Mourning(build, robot_file, capture, tmp_path)
    chain.replicas = {instance: {} for instance in REPLICAS}
    chain.replicas[REPLICAS[1]] = {"ZLOAM_FAULT_KILL_AT": "20"}
    with chain:
        statuses = chain.follow()
        books(chain, statuses)
    assert chain.dead == {REPLICAS[1]}, "it was not killed: the test shows nothing"
    assert digests(tmp_path, FILES) == alone
    computed, _ = shares(statuses)
    assert computed[REPLICAS[0]] > 0
    assert computed[REPLICAS[2]] > 0


def test_a_wrong_list_of_members_costs_work_only(
    build: Path, robot_file: Path, capture: Capture, alone: Files, tmp_path: Path
) -> None:
    """One replica knows of no other and processes every sweep; the other counts a member that does
    not exist."""
    chain = SharedChain(build, robot_file, capture, tmp_path)
    chain.replicas = {
        REPLICAS[0]: {"ZLOAM_FAULT_MEMBERS": REPLICAS[0]},
        REPLICAS[1]: {"ZLOAM_FAULT_MEMBERS": f"{REPLICAS[1]},nobody"},
    }
    with chain:
        statuses = chain.follow()
        found = books(chain, statuses)
    assert digests(tmp_path, FILES) == alone
    computed, _ = shares(statuses)
    assert computed[REPLICAS[1]] > 0, computed
    assert found["duplicates"] > 0


def test_a_member_that_is_not_there_is_done_without(
    build: Path, robot_file: Path, capture: Capture, alone: Files, tmp_path: Path
) -> None:
    """Both count a third, non-existent member, whose sweeps are missing until the next in rank
    processes them."""
    chain = SharedChain(build, robot_file, capture, tmp_path)
    chain.replicas = {
        i: {"ZLOAM_FAULT_MEMBERS": ",".join([*REPLICAS[:2], "nobody"])} for i in REPLICAS[:2]
    }
    with chain:
        statuses = chain.follow()
        books(chain, statuses)
    assert digests(tmp_path, FILES) == alone
    redone = sum(
        s.figures.get("redone", 0) for (stage, _), s in statuses.items() if stage == "registration"
    )
    assert redone > 0
