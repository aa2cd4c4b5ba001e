"""A stage is killed with -9 in the middle of a run and started again: the trajectory goes on in the
same map, and what is missing is counted. Truth is the simulator's."""

from __future__ import annotations

import hashlib
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.acceptance import live
from tests.integration.conftest import Capture, monitor, simulate
from zloam_monitor import se3, sources
from zloam_monitor.chain import Chain, binary
from zloam_monitor.records import PoseRecord, StatusRecord
from zloam_monitor.robot_file import names
from zloam_monitor.trajectory import Trajectory, from_records, interpolate, read

SECONDS = 12.0
#: the live capture is sent slower than it was recorded, so that a busy machine is no fault
SLOWER = 1.5
#: killed when so many poses have come
KILL_AT = 45
#: of the undisturbed run's, and metres on top (the acceptance of the stages' restart)
WORSE, FLOOR_M = 1.2, 0.01
LOST = 9
FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum")
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Enough of the city for a map worth losing."""
    folder = tmp_path_factory.mktemp("drive")
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", str(SECONDS + 1))


@pytest.fixture(scope="module")
def undisturbed(build: Path, drive: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a replay in which nothing is done to anybody; sweep n is its n-th pose."""
    out = tmp_path_factory.mktemp("undisturbed")
    done = monitor("demo", "--preset-dir", build, "--pcap", drive.pcap, "--out", out)
    assert done.code == 0, done.said
    return out


def digests(folder: Path) -> dict[str, str]:
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES}


def rmse_m(found: Trajectory, drive: Capture, from_ns: int) -> float:
    """Of the positions from an instant on, in the frame of the map: nothing is aligned, so that a
    frame that has moved is an error."""
    assert found.stamps_ns is not None
    truth, inside = interpolate(read(drive.truth_base), found.stamps_ns)
    estimate = found.transforms[inside]
    assert found.sweeps[0] == 0
    wanted = se3.inverse(truth.transforms[0]) @ truth.transforms
    error = np.linalg.norm(wanted[:, :3, 3] - estimate[:, :3, 3], axis=1)
    after = found.stamps_ns[inside] >= from_ns
    assert after.any()
    return float(np.sqrt(np.mean(error[after] ** 2)))


def assert_as_good(found: Trajectory, undisturbed: Path, drive: Capture, from_ns: int) -> None:
    whole = read(undisturbed / "trajectory.tum")
    reference = Trajectory(whole.transforms, whole.stamps_ns, np.arange(len(whole)))
    allowed = WORSE * rmse_m(reference, drive, from_ns) + FLOOR_M
    assert rmse_m(found, drive, from_ns) <= allowed


def kill(chain: Chain, *stages: str) -> None:
    killed = [chain.processes.running.pop(stage) for stage in stages]
    for process in killed:
        process.send(signal.SIGKILL)
    for process in killed:
        process.wait(10.0)


class LiveRun:
    """The chain on a sensor's packets; keeps the poses of all runs."""

    def __init__(
        self,
        build: Path,
        robot_file: Path,
        drive: Capture,
        out: Path,
        *,
        store: bool = True,
        slower: float = SLOWER,
    ) -> None:
        self.out, self.port = out, live.free_udp_port()
        robot = names(robot_file, [])
        settings = [
            "driver.source=udp",
            f"driver.port={self.port}",
            "driver.position_port=0",
            f"integration.output_dir={out}",
            f"mapping.map_path={out / 'map.pcd'}",
        ]
        self.chain = Chain(build, robot_file, robot.robot, settings, out, robot.sensor)
        self._store: list[str] = []
        if store:
            own = [f"zenoh.base_port={self.chain.base_port}", f"store.path={out / 'tiles'}"]
            own.append(f"zenoh.connect=[{self.chain._own_endpoint()}]")
            command = [str(binary(build, "store")), "--config", str(robot_file)]
            self._store = [*command, *(w for setting in own for w in ("--set", setting))]
        self._sender = threading.Thread(
            target=live.send, args=(drive.pcap, self.port, SECONDS, slower)
        )
        #: (run, sweep) -> pose, in the order of their coming
        self.poses: dict[tuple[int, int], PoseRecord] = {}
        self.mapped: dict[tuple[int, int], PoseRecord] = {}

    def __enter__(self) -> LiveRun:
        self.chain.__enter__()
        if self._store:
            self.chain.processes.start("store", self._store, self.out / "store.log")
            self._until(lambda: self.chain.link.stage("store") is not None)
        self.chain.wait_ready()
        self._sender.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.chain.close()
        self._sender.join()

    def _poll(self) -> None:
        link = self.chain.link
        link.poll(0.1)
        for kept, found in ((self.poses, link.poses), (self.mapped, link.mapped)):
            for pose in found.values():
                kept.setdefault((pose.run, pose.sweep), pose)
        self.chain.processes.check()

    def _until(self, done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            self._poll()
            assert time.monotonic() < deadline, "it never happened"

    def until_poses(self, count: int) -> None:
        self._until(lambda: len(self.poses) >= count)

    def restart(self, *stages: str) -> PoseRecord:
        """Kills and starts again; the last pose before."""
        last = list(self.poses.values())[-1]
        kill(self.chain, *stages)
        for stage in stages:
            self.chain.start(stage, f"{stage}-again")
        return last

    def end(self) -> dict[str, StatusRecord]:
        """After the last packet: statuses, and exit codes that are all 0."""
        while self._sender.is_alive():
            self._poll()
        ends = time.monotonic() + live.AFTER_SECONDS
        while time.monotonic() < ends:
            self._poll()
        self.chain.link.query_statuses()
        statuses = self.chain.statuses()
        codes = self.chain.stop()
        assert set(codes.values()) == {0}, codes
        return {**statuses, **self.chain.statuses()}

    def trajectory(self, undisturbed: Path) -> tuple[Trajectory, NDArray[np.int64]]:
        """Of the poses, at the instants that the capture gives the first run's sweeps; those of
        later ones as far behind these as the sensor's own time says."""
        stamps = read(undisturbed / "trajectory.tum").stamps_ns
        assert stamps is not None
        first_run = next(iter(self.poses))[0]
        begin = self.poses[(first_run, 0)].instant_ns
        rows = {}
        for place, pose in enumerate(self.poses.values()):
            own = pose.run == first_run
            at = int(stamps[pose.sweep]) if own else int(stamps[0]) + pose.instant_ns - begin
            rows[place] = (at, pose.translation, pose.quaternion)
        return from_records(rows), stamps


def assert_books(statuses: dict[str, StatusRecord], stages: tuple[str, ...]) -> None:
    for stage in stages:
        for account in statuses[stage].inputs:
            assert account.balanced(), (stage, account)


def missing(poses: dict[tuple[int, int], PoseRecord], run: int) -> list[int]:
    """Sweeps without a pose up to the last one."""
    have = {sweep for r, sweep in poses if r == run}
    return sorted(set(range(max(have) + 1)) - have)


def gap_of(status: StatusRecord) -> list[int]:
    """Sweeps that the stage said it missed when it was away."""
    first, last = status.figures["gap_first_sweep"], status.figures["gap_last_sweep"]
    return list(range(int(first), int(last) + 1)) if status.figures["gap_sweeps"] else []


STAGES = ("registration", "odometry", "mapping", "integration")


def test_mapping_takes_its_map_back(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    with LiveRun(build, robot_file, drive, tmp_path) as run:
        run.until_poses(KILL_AT)
        last = run.restart("mapping")
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    mapping = statuses["mapping"]
    assert mapping.figures["map_points_taken_back"] > 0
    assert missing(run.poses, last.run) == []
    # at its start it waits for the store's answer: what it drops then is the first instance's
    absent = [s for s in missing(run.mapped, last.run) if s > KILL_AT - 10]
    account = mapping.inputs[0]
    assert set(gap_of(mapping)) <= set(absent)
    dropped = sum(account.dropped.values())
    assert len(absent) == len(gap_of(mapping)) + account.lost + dropped
    assert all(p.health != LOST for p in run.poses.values())
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def test_mapping_without_a_store_says_that_the_map_is_lost(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    with LiveRun(build, robot_file, drive, tmp_path, store=False) as run:
        run.until_poses(KILL_AT)
        last = run.restart("mapping")
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    assert statuses["mapping"].figures["map_points_taken_back"] == 0
    assert missing(run.poses, last.run) == []
    # The frame is the same; the map is not, so that the drift until then stays in.
    assert rmse_m(found, drive, stamps[last.sweep]) < 0.2


def test_odometry_goes_on_in_its_frame(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    with LiveRun(build, robot_file, drive, tmp_path) as run:
        run.until_poses(KILL_AT)
        last = run.restart("odometry")
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    gaps = missing(run.poses, last.run)
    lost = [s for s in gaps if s not in gap_of(statuses["odometry"])]
    account = next(i for i in statuses["odometry"].inputs)
    # what came while it caught up may be given up in the queue, done already or not
    assert len(lost) <= account.lost + account.dropped.get("queue_full", 0)
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def test_a_new_odometry_frame_is_bridged(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """Who kept the odometry's commits is gone too."""
    with LiveRun(build, robot_file, drive, tmp_path) as run:
        run.until_poses(KILL_AT)
        last = run.restart("odometry", "mapping")
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    assert "a new odom frame begins" in (tmp_path / "odometry-again.log").read_text()
    assert statuses["mapping"].figures["map_points_taken_back"] > 0
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])


def test_integration_goes_on_with_the_trajectory(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    with LiveRun(build, robot_file, drive, tmp_path) as run:
        run.until_poses(KILL_AT)
        last = run.restart("integration")
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    assert missing(run.poses, last.run) == gap_of(statuses["integration"])
    written = read(tmp_path / "trajectory.tum")
    sweeps = statuses["driver"].last_sweep + 1
    assert len(written) == sweeps - len(gap_of(statuses["integration"]))
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def test_the_map_outlives_a_new_run_of_the_driver(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    # at the sensor's own pace: the gap is told by its clock
    with LiveRun(build, robot_file, drive, tmp_path, slower=1.0) as run:
        run.until_poses(KILL_AT)
        last = run.restart("driver")
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    assert len({r for r, _ in run.poses}) == 2
    for stage in ("odometry", "mapping", "integration"):
        assert 0 < statuses[stage].figures["gap_ms"] < 2000.0
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert len(read(tmp_path / "trajectory.tum")) == len(run.poses)


def test_all_are_killed_and_the_store_has_the_map(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    with LiveRun(build, robot_file, drive, tmp_path, slower=1.0) as run:
        run.until_poses(KILL_AT)
        last = run.restart("integration", "mapping", "odometry", "registration", "driver")
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    assert statuses["mapping"].figures["map_points_taken_back"] > 0
    second = [p for p in run.poses.values() if p.run != last.run]
    assert second
    if any(p.health == LOST for p in second):
        assert statuses["mapping"].figures["inserted"] == 0.0
    else:
        # the first poses of the new run are predicted until the first match
        settled = second[5].instant_ns - run.poses[(last.run, 0)].instant_ns + int(stamps[0])
        assert_as_good(found, undisturbed, drive, settled)


def replayed(
    build: Path, robot_file: Path, drive: Capture, out: Path, stage: str
) -> dict[str, StatusRecord]:
    """The folder and the statuses of a replay in which the stage is killed once."""
    robot = names(robot_file, [])
    settings = [
        *sources.from_pcap(drive.pcap).driver_settings("realtime"),
        f"integration.output_dir={out}",
        f"mapping.map_path={out / 'map.pcd'}",
    ]
    with Chain(build, robot_file, robot.robot, settings, out, robot.sensor) as chain:
        deadline = time.monotonic() + 3 * PATIENCE_S
        while len(chain.link.poses) < KILL_AT:
            chain.link.poll(0.1)
            chain.check()
        kill(chain, stage)
        chain.start(stage, f"{stage}-again")
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
            assert time.monotonic() < deadline, "the run does not end"
        chain.link.query_statuses()
        poses = dict(chain.link.poses)
        codes = chain.stop()
        statuses = chain.statuses()
    assert set(codes.values()) == {0}, codes
    assert sorted(poses) == list(range(statuses["driver"].last_sweep + 1))
    assert_books(statuses, STAGES)
    return statuses


@pytest.mark.parametrize("stage", ["driver", "odometry", "integration"])
def test_a_replay_has_the_same_bytes(
    build: Path,
    robot_file: Path,
    drive: Capture,
    undisturbed: Path,
    tmp_path: Path,
    stage: str,
) -> None:
    """What the killed one held can all be had from others."""
    replayed(build, robot_file, drive, tmp_path, stage)
    assert digests(tmp_path) == digests(undisturbed)


def test_a_replay_goes_on_without_its_map(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """Without a store the map is founded anew, in the frame of the one before."""
    replayed(build, robot_file, drive, tmp_path, "mapping")
    odometry = "odometry.tum"
    assert (tmp_path / odometry).read_bytes() == (undisturbed / odometry).read_bytes()
    written = read(tmp_path / "trajectory.tum")
    found = Trajectory(written.transforms, written.stamps_ns, np.arange(len(written)))
    assert written.stamps_ns is not None
    assert rmse_m(found, drive, int(written.stamps_ns[KILL_AT])) < 0.2
