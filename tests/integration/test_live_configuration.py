"""A parameter is changed during a run: the change takes effect from one sweep on in every instance,
and likewise in a replay that is given the change (docs/protocol.md, section 13)."""

from __future__ import annotations

import signal
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from tests.integration.conftest import PATIENCE_S, Capture, digests, monitor, simulate, until
from tests.integration.test_replicas import FILES, REPLICAS, SharedChain, books
from zloam_monitor import messages
from zloam_monitor.keys import Keys
from zloam_monitor.messages import text
from zloam_monitor.records import ReplyRecord, RevisionRecord
from zloam_monitor.settings import as_set_at, change

WINDOW = 8
DRIVE_SECONDS = "15"
#: pace of the replay relative to real time: slow enough for commands during the run
SLOW = "0.5"
#: stage -> parameter and value, chosen so that the stage's output changes
CHANGES = {
    "registration": {"registration.edge_chi2": "100"},
    "odometry": {"odometry.kernel_m": "0.05"},
    "mapping": {"mapping.voxel_planes.correlation": "4", "mapping.publish_every": "3"},
}
#: ZLOAM_FAULT_DEAF_SWEEPS: a replica ignores a change for this many sweeps after it is in force
DEAF_SWEEPS = "3"
LATER = {"odometry.kernel_m": "0.2"}


class Watching(SharedChain):
    """Records the configuration revision with which each instance processed each sweep."""

    def __init__(self, *args: Any, **named: Any) -> None:
        super().__init__(*args, **named)
        #: stage -> sweep -> revisions
        self.revs: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
        #: instance of registration -> sweep -> revision
        self.features: dict[str, dict[int, int]] = defaultdict(dict)
        keys = self.link.keys
        self._watched = [
            self.link._subscribe(
                keys.features, lambda p: self._note("registration", "Features", p)
            ),
            self.link._subscribe(keys.odometry, lambda p: self._note("odometry", "Odometry", p)),
            self.link._subscribe(
                keys.odometry_features, lambda p: self._note("odometry", "OdometryFeatures", p)
            ),
            self.link._subscribe(
                keys.map_correction, lambda p: self._note("mapping", "MapCorrection", p)
            ),
            self.link._subscribe(keys.map_odometry, lambda p: self._note("mapping", "MapPose", p)),
        ]

    def _note(self, stage: str, table: str, payload: bytes) -> None:
        header = messages.decode(table, payload).Header()
        self.revs[stage][header.Sweep()].add(header.ConfigRev())
        if stage == "registration":
            self.features[text(header.Instance())][header.Sweep()] = header.ConfigRev()

    def until_poses(self, count: int) -> None:
        until(self, lambda: len(self.link.poses) >= count)

    def shared(self) -> bool:
        """Whether the replicas of registration know of each other. One that knows of no other
        processes every sweep itself and answers every command."""
        done = [set(sweeps) for sweeps in list(self.features.values())]
        if len(done) < len(self.replicas):
            return False
        newest = max(map(max, done))
        late = range(newest - 6, newest - 1)
        once = all(sum(n in one for one in done) == 1 for n in late)
        # Each replica must have done some of them: if one does all, it may not know of the other,
        # to which it did not happen to leave a sweep.
        return once and all(any(n in one for n in late) for one in done)

    def command(self, stage: str, values: dict[str, str]) -> ReplyRecord:
        return change(self.link, stage, values)

    def command_all(self) -> dict[str, RevisionRecord]:
        """Commands all of CHANGES; returns the revision that each stage then publishes."""
        if len(self.replicas) > 1:
            until(self, self.shared)
        replies = {stage: self.command(stage, values) for stage, values in CHANGES.items()}
        assert all(reply.ok for reply in replies.values()), replies
        revisions = {r.stage: r for r in self.link.query_revisions()}
        for stage, reply in replies.items():
            assert reply.results["rev"] == revisions[stage].rev == 1
            assert reply.results["from_sweep"] == revisions[stage].from_sweep
            assert reply.results["values"] == revisions[stage].values
            assert revisions[stage].values.keys() == CHANGES[stage].keys()
        return revisions


def assert_in_force(chain: Watching, stage: str, from_sweep: int, sweeps: int) -> None:
    """Checks that all outputs of the stage have revision 0 before the sweep, and 1 from it on."""
    wanted = {n: {1 if n >= from_sweep else 0} for n in range(sweeps)}
    assert {n: set(revs) for n, revs in chain.revs[stage].items()} == wanted, stage


def ended(chain: Watching) -> int:
    """Follows the run to its end, checks that nothing was lost or dropped, and returns the number
    of sweeps."""
    return books(chain, chain.follow())["sweeps"]


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A drive long enough that a change commanded at full speed still takes effect during it."""
    folder = tmp_path_factory.mktemp("drive")
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", DRIVE_SECONDS)


def unchanged(build: Path, robot_file: Path, capture: Capture, logs: Path) -> dict[str, str]:
    """Digests of a run without any command."""
    with SharedChain(build, robot_file, capture, logs) as chain:
        chain.follow()
    return digests(logs, FILES)


def test_in_force_at_its_sweep_everywhere_and_the_same_in_a_replay(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    """The changes are commanded at full speed with two replicas; then their record is replayed with
    one."""
    chain = Watching(build, robot_file, drive, tmp_path / "live")
    chain.replicas = {instance: {} for instance in REPLICAS[:2]}
    with chain:
        chain.until_poses(1)
        revisions = chain.command_all()
        sweeps = ended(chain)
    for stage, revision in revisions.items():
        assert 2 * WINDOW <= revision.from_sweep < sweeps, "too late to show anything"
        assert_in_force(chain, stage, revision.from_sweep, sweeps)
    from_sweep = revisions["registration"].from_sweep
    for instance in REPLICAS[:2]:
        found = chain.features[instance]
        assert {n: rev for n, rev in found.items() if rev != int(n >= from_sweep)} == {}
        assert set(found.values()) == {0, 1}, f"{instance} had no part in one of the two"
    live = digests(tmp_path / "live", FILES)
    without = unchanged(build, robot_file, drive, tmp_path / "unchanged")
    assert all(live[name] != without[name] for name in FILES), "the changes changed nothing"

    run = chain.link.run
    recorded = as_set_at(revisions.values(), run)
    again = Watching(build, robot_file, drive, tmp_path / "again", set_at=recorded)
    with again:
        assert ended(again) == sweeps
    for stage, revision in revisions.items():
        assert_in_force(again, stage, revision.from_sweep, sweeps)
    assert again.link.run != run, "the change is no part of the replay's name"
    assert digests(tmp_path / "again", FILES) == live


@pytest.mark.slow
def test_replicas_that_disagree_for_a_while_cost_work_only(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    """The replica that did not issue the change hears of it only after it is in force. Its outputs
    until then are dropped, and the sweeps are processed again, by either replica."""
    chain = Watching(build, robot_file, capture, tmp_path / "live", SLOW)
    chain.replicas = {i: {"ZLOAM_FAULT_DEAF_SWEEPS": DEAF_SWEEPS} for i in REPLICAS[:2]}
    with chain:
        chain.until_poses(5)
        revision = chain.command_all()["registration"]
        statuses = chain.follow()
        revisions = chain.link.revisions
    assert 0 in set().union(
        *(r for n, r in chain.revs["registration"].items() if n >= revision.from_sweep)
    ), "nobody was late"
    features = statuses["odometry", _only(statuses, "odometry")].inputs[0]
    assert features.balanced()
    assert features.dropped["invalid"] > 0
    again = sum(s.figures.get("done_again", 0) for (_, _), s in statuses.items())
    assert again > 0
    sweeps = len(chain.revs["odometry"])
    assert sorted(chain.link.poses) == list(range(sweeps))
    recorded = as_set_at(revisions, chain.link.run)
    agreed = Watching(build, robot_file, capture, tmp_path / "agreed", set_at=recorded)
    with agreed:
        assert ended(agreed) == sweeps
    assert digests(tmp_path / "live", FILES) == digests(tmp_path / "agreed", FILES)


def test_a_second_change_keeps_the_first(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    with Watching(build, robot_file, capture, tmp_path, SLOW) as chain:
        chain.until_poses(3)
        first = chain.command("odometry", {"odometry.min_correspondences": "31"})
        chain.until_poses(6)
        second = chain.command("odometry", LATER)
        sweeps = ended(chain)
    assert (first.results["rev"], second.results["rev"]) == (1, 2)
    assert first.results["from_sweep"] < second.results["from_sweep"] < sweeps
    assert second.results["values"] == {
        "odometry.min_correspondences": 31,
        "odometry.kernel_m": 0.2,
    }
    begins = [first.results["from_sweep"], second.results["from_sweep"]]
    wanted = {n: {sum(n >= b for b in begins)} for n in range(sweeps)}
    assert {n: set(revs) for n, revs in chain.revs["odometry"].items()} == wanted


@pytest.mark.parametrize(
    "stage",
    [
        pytest.param("registration", marks=pytest.mark.slow),
        "odometry",
        pytest.param("mapping", marks=pytest.mark.slow),
    ],
)
def test_a_stage_that_was_killed_goes_on_with_the_revision(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path, stage: str
) -> None:
    """The stage is killed after the change is in force, and in a second run before that."""
    for after in (True, False):
        chain = Watching(build, robot_file, capture, tmp_path / f"after-{after}", SLOW)
        with chain:
            chain.until_poses(5)
            revision = chain.command_all()[stage]
            if after:
                chain.until_poses(revision.from_sweep + 5)
            elif len(chain.link.poses) >= revision.from_sweep:
                pytest.skip("the machine is too busy: the change was in force before the kill")
            name = REPLICAS[0] if stage == "registration" else stage
            killed = chain.processes.running.pop(name)
            killed.send(signal.SIGKILL)
            killed.wait(PATIENCE_S)
            if stage == "registration":
                chain.start_replica(stage, REPLICAS[1])
            else:
                chain.start(stage, f"{stage}-again")
            statuses = chain.follow()
        sweeps = (statuses["driver", _only(statuses, "driver")].last_sweep or 0) + 1
        assert sorted(chain.link.poses) == list(range(sweeps))
        assert_in_force(chain, stage, revision.from_sweep, sweeps)
        mine = [s for (name, _), s in statuses.items() if name == stage]
        assert max(mine, key=lambda s: s.stamp_ns).config_rev == 1


def _only(statuses: object, stage: str) -> str:
    assert isinstance(statuses, dict)
    return str(next(instance for name, instance in statuses if name == stage))


REFUSED = [
    ("odometry.kernel", "1", ["unknown key", "odometry.kernel_m"]),
    ("odometry.kernel_m", "wide", ["a number is expected", "0.001 to 100 m"]),
    ("odometry.kernel_m", "1000", ["out of range", "0.001 to 100 m"]),
    ("odometry.kernel_m", "[1, 2]", ["a single value is expected", "0.001 to 100 m"]),
    ("odometry.voxel_m", "1", ["can't change while running", "allowed: ", "odometry.kernel_m"]),
    ("zenoh.base_port", "1", ["can't change while running", "allowed: ", "odometry.kernel_m"]),
]


def test_what_is_refused_says_key_value_and_what_is_allowed(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    with Watching(build, robot_file, capture, tmp_path / "asked", SLOW) as chain:
        chain.until_poses(2)
        for key, value, words in REFUSED:
            reply = chain.command("odometry", {key: value})
            assert not reply.ok, reply
            for word in [key, *words]:
                assert word in reply.message
            assert value in reply.message
        reply = chain.command("integration", {"integration.jump_m": "1"})
        assert not reply.ok
        assert "allowed: nothing" in reply.message
        # One invalid value refuses the whole command.
        both = {"odometry.kernel_m": "0.05", "odometry.correlation": "none"}
        assert not chain.command("odometry", both).ok
        assert chain.link.query_revisions() == []
        ended(chain)
    without = unchanged(build, robot_file, capture, tmp_path / "unchanged")
    assert digests(tmp_path / "asked", FILES) == without


def test_the_command_of_the_monitor(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    with Watching(build, robot_file, capture, tmp_path, SLOW) as chain:
        chain.until_poses(2)
        keys: Keys = chain.link.keys
        to = ["--robot", keys.robot, "--connect", f"tcp/127.0.0.1:{chain.base_port + 4}"]
        done = monitor(
            "set", "mapping", "mapping.drift_limit=0.02", "mapping.bridge_sweeps=30", *to
        )
        assert done.code == 0, done.said
        assert "revision 1 from sweep" in done.said
        wrong = monitor("set", "mapping", "mapping.drift_limit=-2", *to)
        assert wrong.code == 1
        assert "mapping.drift_limit" in wrong.said
        assert "1e-06 to 1" in wrong.said
        nobody = monitor("set", "mupping", "mapping.drift_limit=0.02", *to)
        assert nobody.code == 1
        assert "no instance of mupping" in nobody.said
        chain.link.query_revisions()
    assert [r.values for r in chain.link.revisions] == [
        {"mapping.drift_limit": 0.02, "mapping.bridge_sweeps": 30}
    ]


def test_a_change_on_the_command_line_is_checked_alike(build: Path, capture: Capture) -> None:
    asked = ("demo", "--preset-dir", build, "--pcap", capture.pcap, "--out", "out/never")
    done = monitor(*asked, "--set-at", "30:odometry.kernel_m=1000")
    assert done.code == 2, done.said
    assert "--set-at 30: odometry.kernel_m: value '1000' is refused" in done.said
    done = monitor(*asked, "--set-at", "odometry.kernel_m=1")
    assert done.code == 2, done.said
    assert "SWEEP:key=value is expected" in done.said
