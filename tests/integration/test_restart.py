"""A stage is killed with -9 in the middle of a run and started again: the trajectory goes on in the
same map, and what is missing is counted. Truth is the simulator's."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import dpkt
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.integration.conftest import Capture, digests, monitor, simulate
from tests.integration.live_run import (
    BRIDGING,
    KILL_AT,
    LOST,
    SECONDS,
    STAGES,
    LiveRun,
    rmse_m,
)
from tests.integration.replay_run import assert_books, replayed
from zloam_monitor import sources
from zloam_monitor.records import HEALTH, PoseRecord, StatusRecord
from zloam_monitor.trajectory import Trajectory, read

#: of the undisturbed run's, and metres on top (the acceptance of the stages' restart)
WORSE, FLOOR_M = 1.2, 0.01
FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum")
#: longer than a gap that a constant motion tells over
AWAY_SWEEPS = 15
#: poses that may be predicted over a gap until the map is found again
BRIDGED_SWEEPS = 15
#: more than the second over which a constant motion is believed
STANDSTILL_S = 3.0
SILENCE_AT_S, AFTER_SILENCE_S = 8, 6
#: of a drive of seconds in the city, unaligned: the map ahead is thin, and of one side only
SILENCES_RMSE_M = {1.5: 0.10, 5.0: 0.25}
#: sweeps that came of five seconds, and those after them
HOLES = {
    "rare": [range(64, 65), range(73, 74), range(80, 81), range(83, 84), range(85, 140)],
    "rarer": [*(range(n, n + 1) for n in (62, 71, 78, 83, 87)), range(89, 94), range(98, 140)],
}
AT_THE_END = 20
#: of the drive, while a process stood still and the sensor went on; and after it
STOPPED_S, AFTER_STOP_S = 5.0, 5.0
#: the search for the place takes a few sweeps of time; on a busy machine it would take so many that
#: the map lies behind
SLOWER_SEARCH = 2.5


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


def assert_as_good(found: Trajectory, undisturbed: Path, drive: Capture, from_ns: int) -> None:
    whole = read(undisturbed / "trajectory.tum")
    reference = Trajectory(whole.transforms, whole.stamps_ns, np.arange(len(whole)))
    allowed = WORSE * rmse_m(reference, drive, from_ns) + FLOOR_M
    assert rmse_m(found, drive, from_ns) <= allowed


def without_pose(out: Path, statuses: dict[str, StatusRecord]) -> int:
    """So many of the driver's sweeps have none. What integration wrote counts: whoever only listens
    may miss some of the poses that come at once when a stage catches up."""
    last_sweep = statuses["driver"].last_sweep
    assert last_sweep is not None
    return last_sweep + 1 - len(read(out / "trajectory.tum"))


def missing(poses: dict[tuple[int, int], PoseRecord], run: int) -> list[int]:
    """Sweeps up to the last one that were not heard of."""
    have = {sweep for r, sweep in poses if r == run}
    return sorted(set(range(max(have) + 1)) - have)


def given_up(statuses: dict[str, StatusRecord]) -> int:
    """Sweeps on the way to the pose, by those who had to."""
    inputs = (i for s in STAGES if s != "mapping" for i in statuses[s].inputs)
    return sum(i.lost + sum(i.dropped.values()) - i.dropped.get("duplicate", 0) for i in inputs)


def assert_bridged(poses: dict[tuple[int, int], PoseRecord], last: PoseRecord) -> None:
    """After the kill the map was searched for, and found soon."""
    after = [p for p in poses.values() if p.instant_ns > last.instant_ns]
    bridging = sum(p.health == BRIDGING for p in after)
    assert 0 < bridging <= BRIDGED_SWEEPS


def assert_last_pose_again(run: LiveRun, odometry: StatusRecord) -> None:
    """Who takes over gives out the pose of the newest commit that mapping has: it may have died
    with its publisher while the commit came through. It commits to nothing twice."""
    keys = run.chain.link.keys
    assert odometry.published[keys.odometry] == odometry.published[keys.odometry_features] + 1
    (_, again) = run.odometry_poses
    # a new publisher's first messages may come before it knows of this reader
    assert run.odometry_poses[again][0] >= run.kept_commit
    assert run.odometry_commits[again][0] > run.kept_commit


def gap_of(status: StatusRecord) -> list[int]:
    """Sweeps that the stage said it missed when it was away."""
    first, last = status.figures["gap_first_sweep"], status.figures["gap_last_sweep"]
    return list(range(int(first), int(last) + 1)) if status.figures["gap_sweeps"] else []


def test_mapping_takes_its_map_back(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path)
    last, statuses = run.killed("mapping")
    found, stamps = run.trajectory(undisturbed)
    mapping = statuses["mapping"]
    assert mapping.figures["map_points_taken_back"] > 0
    assert without_pose(tmp_path, statuses) == 0
    # at its start it waits for the store's answer: what it drops then is the first instance's
    absent = [s for s in missing(run.mapped, last.run) if s > KILL_AT - 10]
    account = mapping.inputs[0]
    assert set(gap_of(mapping)) <= set(absent)
    dropped = sum(account.dropped.values())
    assert len(absent) == len(gap_of(mapping)) + account.lost + dropped
    assert all(p.health != LOST for p in run.poses.values())
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def test_odometry_goes_on_in_its_frame(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path)
    last, statuses = run.killed("odometry")
    found, stamps = run.trajectory(undisturbed)
    lost = without_pose(tmp_path, statuses) - len(gap_of(statuses["odometry"]))
    # what came while it caught up may be given up in the queue, done already or not; on a machine
    # that is too busy for a sensor registration gives up some too
    assert 0 <= lost <= given_up(statuses)
    assert_last_pose_again(run, statuses["odometry"])
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


@pytest.mark.slow
def test_odometry_that_was_away_for_longer_goes_on_too(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """As a container that is started again; registration keeps what came meanwhile."""
    run = LiveRun(build, robot_file, drive, tmp_path)
    last, statuses = run.killed("odometry", away=AWAY_SWEEPS)
    found, stamps = run.trajectory(undisturbed)
    assert "a new odom frame begins" not in (tmp_path / "odometry-again.log").read_text()
    assert without_pose(tmp_path, statuses) < AWAY_SWEEPS
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])


def test_a_new_odometry_frame_is_bridged(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """Who kept the odometry's commits is gone too."""
    run = LiveRun(build, robot_file, drive, tmp_path)
    last, statuses = run.killed("odometry", "mapping")
    found, stamps = run.trajectory(undisturbed)
    assert "a new odom frame begins" in (tmp_path / "odometry-again.log").read_text()
    assert statuses["mapping"].figures["map_points_taken_back"] > 0
    assert_bridged(run.poses, last)
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])


def test_integration_goes_on_with_the_trajectory(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path)
    last, statuses = run.killed("integration")
    found, stamps = run.trajectory(undisturbed)
    lost = without_pose(tmp_path, statuses) - len(gap_of(statuses["integration"]))
    # nothing is, unless the machine is too busy for a sensor: then somebody says so
    before = [s for s in missing(run.poses, last.run) if s < last.sweep]
    assert 0 <= lost <= len(before) + given_up(statuses)
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def test_all_are_killed_and_the_store_has_the_map(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path, slower=1.0)
    last, statuses = run.killed("integration", "mapping", "odometry", "registration", "driver")
    found, stamps = run.trajectory(undisturbed)
    assert statuses["mapping"].figures["map_points_taken_back"] > 0
    second = [p for p in run.poses.values() if p.run != last.run]
    assert second
    if all(p.health in (BRIDGING, LOST) for p in second):
        # away for too long to be found again: nothing is put into the map
        assert statuses["mapping"].figures["inserted"] == 0.0
    else:
        assert_as_good(found, undisturbed, drive, stamps[last.sweep])


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
    replayed(build, robot_file, sources.from_pcap(drive.pcap), tmp_path, stage)
    assert digests(tmp_path, FILES) == digests(undisturbed, FILES)


def test_a_replay_goes_on_without_its_map(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """Without a store the map is founded anew, in the frame of the one before."""
    replayed(build, robot_file, sources.from_pcap(drive.pcap), tmp_path, "mapping")
    odometry = "odometry.tum"
    assert (tmp_path / odometry).read_bytes() == (undisturbed / odometry).read_bytes()
    written = read(tmp_path / "trajectory.tum")
    found = Trajectory(written.transforms, written.stamps_ns, np.arange(len(written)))
    assert written.stamps_ns is not None
    assert rmse_m(found, drive, int(written.stamps_ns[KILL_AT])) < 0.2


@pytest.mark.slow
def test_a_capture_that_is_replayed_again_has_a_map_of_its_own(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """The same capture has the same run: what the store has of the first time is of another map."""
    tiles = tmp_path / "tiles"
    source = sources.from_pcap(drive.pcap)
    replayed(build, robot_file, source, tmp_path / "first", None, tiles)
    statuses = replayed(build, robot_file, source, tmp_path / "second", "mapping", tiles)
    assert statuses["mapping"].figures["map_points_taken_back"] > 0
    written = read(tmp_path / "second" / "trajectory.tum")
    assert written.stamps_ns is not None
    found = Trajectory(written.transforms, written.stamps_ns, np.arange(len(written)))
    assert_as_good(found, undisturbed, drive, int(written.stamps_ns[KILL_AT]))


def test_an_odometry_that_stood_still_goes_on_in_its_map(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """For longer than a constant motion tells over, as in a container that was suspended."""
    run = LiveRun(build, robot_file, drive, tmp_path)
    with run:
        run.until_poses(KILL_AT)
        last = list(run.poses.values())[-1]
        process = run.chain.processes.running["odometry"]
        process.send(signal.SIGSTOP)
        time.sleep(STANDSTILL_S)
        process.send(signal.SIGCONT)
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def bridged(build: Path, drive: Capture, out: Path) -> tuple[Trajectory, NDArray[np.int64]]:
    """The poses of a replay in which the map was found again soon, and their times."""
    done = monitor("demo", "--preset-dir", build, "--pcap", drive.pcap, "--out", out)
    assert done.code == 0, done.said
    counts = json.loads((out / "report.json").read_text())["health"]["counts"]
    assert 0 < counts["bridging"] <= BRIDGED_SWEEPS
    assert "lost" not in counts
    whole = read(out / "trajectory.tum")
    assert whole.stamps_ns is not None
    found = Trajectory(whole.transforms, whole.stamps_ns, np.arange(len(whole)))
    return found, whole.stamps_ns


@pytest.mark.parametrize("silence_s", SILENCES_RMSE_M)
def test_after_a_silence_of_the_sensor_the_map_is_found_again(
    build: Path, tmp_path: Path, silence_s: float
) -> None:
    """A cable that was out for a moment, in the middle of a drive; after the longer time most of
    what is seen lies beyond the map."""
    duration = str(SILENCE_AT_S + silence_s + AFTER_SILENCE_S)
    options = ["--gap-start", str(SILENCE_AT_S), "--gap", str(silence_s), "--duration", duration]
    drive = simulate(build, tmp_path, "--world", "city", "--seed", "3", *options)
    found, stamps_ns = bridged(build, drive, tmp_path / "out")
    gap = int(np.argmax(np.diff(stamps_ns)))
    assert stamps_ns[gap + 1] - stamps_ns[gap] > 1e9 * silence_s
    # The first poses after it are predictions, and say so.
    after = int(stamps_ns[gap + 1]) + BRIDGED_SWEEPS * 100_000_000
    assert rmse_m(found, drive, after) <= SILENCES_RMSE_M[silence_s]


def keep_sweeps(capture: Path, kept: list[range]) -> None:
    """Leaves the packets of these sweeps' times in it."""
    with capture.open("rb") as file:
        packets = list(dpkt.pcap.Reader(file))
    first = packets[0][0]
    with capture.open("wb") as file:
        writer = dpkt.pcap.Writer(file)
        for stamp, frame in packets:
            if any(int((stamp - first) / 0.1) in sweeps for sweeps in kept):
                writer.writepkt(frame, ts=stamp)


@pytest.mark.parametrize("holes", HOLES.values(), ids=HOLES)
def test_after_single_sweeps_the_map_is_found_again(
    build: Path, tmp_path: Path, holes: list[range]
) -> None:
    """What a process that stood still finds in its queue: too few sweeps in a row to tell how fast
    the platform drives, and between them so much way that no sweep matches the one before."""
    drive = simulate(build, tmp_path, "--world", "city", "--seed", "3", "--duration", "14")
    keep_sweeps(drive.pcap, [range(45), *holes])
    found, stamps_ns = bridged(build, drive, tmp_path / "out")
    assert rmse_m(found, drive, int(stamps_ns[-AT_THE_END])) <= SILENCES_RMSE_M[5.0]


@pytest.mark.parametrize("stage", ["registration", "driver"])
def test_after_a_standstill_the_map_is_found_again(
    build: Path, robot_file: Path, tmp_path: Path, stage: str
) -> None:
    """What the sensor saw meanwhile is gone; some of it comes late and breaks off again. Where the
    rest is near enough to go on with, no new frame is needed."""
    seconds = 0.1 * KILL_AT + STOPPED_S + AFTER_STOP_S
    options = ["--world", "city", "--seed", "3", "--duration", str(seconds + 1)]
    drive = simulate(build, tmp_path, *options)
    run = LiveRun(build, robot_file, drive, tmp_path / "out", slower=SLOWER_SEARCH, seconds=seconds)
    with run:
        run.until_poses(KILL_AT)
        process = run.chain.processes.running[stage]
        process.send(signal.SIGSTOP)
        time.sleep(SLOWER_SEARCH * STOPPED_S)
        process.send(signal.SIGCONT)
        statuses = run.end()
    # that registration gave sweeps up is heard: nobody waits for them
    assert not any(each.dropped.get("fenced") for each in statuses["odometry"].inputs)
    poses = list(run.poses.values())
    assert poses[-1].sweep > KILL_AT + 10
    unlike = [(p.sweep, HEALTH[p.health]) for p in poses if p.health in (BRIDGING, LOST)]
    assert not {p.sweep for p in poses[-10:]} & {sweep for sweep, _ in unlike}, unlike
