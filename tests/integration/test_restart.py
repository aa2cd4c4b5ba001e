"""A stage is killed with SIGKILL during a run and started again: the trajectory continues in the
same map, and missed sweeps are counted. The reference is the simulator's truth."""

from __future__ import annotations

import json
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path

import dpkt
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.integration.conftest import Capture, digests, kill, monitor, simulate
from tests.integration.live_run import (
    BRIDGING,
    KILL_AT,
    LOST,
    SECONDS,
    SPARE_S,
    STAGES,
    LiveRun,
    one_quick,
    rmse_m,
)
from tests.integration.replay_run import assert_books, replayed
from zloam_monitor import sources
from zloam_monitor.records import HEALTH, PoseRecord, StatusRecord
from zloam_monitor.trajectory import Trajectory, read

#: Limit of the error: a factor on the undisturbed run's, plus metres (acceptance of the stages'
#: restart).
WORSE, FLOOR_M = 1.2, 0.01
FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum")
#: longer than a gap that the constant-motion prediction bridges
AWAY_SWEEPS = 15
#: poses that may be predicted over a gap until the robot is found in the map again
BRIDGED_SWEEPS = 15
#: longer than the second for which the constant-motion prediction is trusted
STANDSTILL_S = 3.0
SILENCE_AT_S, AFTER_SILENCE_S = 8, 6
#: length of the sensor's silence in s -> limit of the RMSE after it. For drives of seconds in the
#: city, without alignment: the map ahead is sparse and was seen from one side only.
SILENCES_RMSE_M = {1.5: 0.10, 5.0: 0.25}
#: sweeps that remain of a gap of about five seconds, and those after it
HOLES = {
    "rare": [range(64, 65), range(73, 74), range(80, 81), range(83, 84), range(85, 140)],
    "rarer": [*(range(n, n + 1) for n in (62, 71, 78, 83, 87)), range(89, 94), range(98, 140)],
}
AT_THE_END = 20
#: length of the drive while a process is stopped and the sensor keeps sending, and after that
STOPPED_S, AFTER_STOP_S = 5.0, 5.0
#: The search for the place takes as long as a few sweeps; at the recorded pace a busy machine would
#: miss so many sweeps meanwhile that the platform leaves the map.
SLOWER_SEARCH = 2.5


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """A drive in the city with a map large enough that its loss would show."""
    folder = tmp_path_factory.mktemp("drive")
    seconds = str(SECONDS + SPARE_S)
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", seconds)


@pytest.fixture(scope="module")
def short(drive: Capture, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """The first part of the drive, for replays: they wait for their readers, and need no more."""
    pcap = tmp_path_factory.mktemp("short") / "capture.pcap"
    shutil.copy(drive.pcap, pcap)
    keep_sweeps(pcap, [range(round(10 * SECONDS) + 10)])
    return replace(drive, pcap=pcap)


def calm(build: Path, drive: Capture, out: Path) -> Path:
    """Output folder of an undisturbed replay; sweep n is its n-th pose."""
    done = monitor("demo", "--preset-dir", build, "--pcap", drive.pcap, "--out", out)
    assert done.code == 0, done.said
    return out


@pytest.fixture(scope="module")
def undisturbed(build: Path, drive: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return calm(build, drive, tmp_path_factory.mktemp("undisturbed"))


@pytest.fixture(scope="module")
def short_undisturbed(
    build: Path, short: Capture, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    return calm(build, short, tmp_path_factory.mktemp("short_undisturbed"))


def assert_as_good(found: Trajectory, undisturbed: Path, drive: Capture, from_ns: int) -> None:
    """Compares both over the same part of the drive, as a live run may end before its end. Poses
    must have come after that instant: the one at it is of the time before the kill."""
    whole = read(undisturbed / "trajectory.tum")
    assert whole.stamps_ns is not None
    assert found.stamps_ns is not None
    assert (found.stamps_ns > from_ns).any(), "no pose came afterwards, except predicted ones"
    count = int(np.searchsorted(whole.stamps_ns, found.stamps_ns.max(), side="right"))
    reference = Trajectory(
        whole.transforms[:count], whole.stamps_ns[:count], np.arange(len(whole))[:count]
    )
    allowed = WORSE * rmse_m(reference, drive, from_ns) + FLOOR_M
    assert rmse_m(found, drive, from_ns) <= allowed


def goes_on_after(last: PoseRecord, pose: PoseRecord) -> bool:
    """Whether the pose is of the same run, a second later or more, and not a predicted one."""
    return pose.run == last.run and pose.sweep >= last.sweep + 10 and pose.health != BRIDGING


def without_pose(out: Path, statuses: dict[str, StatusRecord]) -> int:
    """Number of the driver's sweeps without a pose. The trajectory that integration wrote counts: a
    mere subscriber may miss some of the poses that come at once when a stage catches up."""
    last_sweep = statuses["driver"].last_sweep
    assert last_sweep is not None
    return last_sweep + 1 - len(read(out / "trajectory.tum"))


def missing(poses: dict[tuple[int, int], PoseRecord], run: int) -> list[int]:
    """Sweeps up to the last one that have no entry here."""
    have = {sweep for r, sweep in poses if r == run}
    return sorted(set(range(max(have) + 1)) - have)


def given_up(statuses: dict[str, StatusRecord]) -> int:
    """Sweeps that the stages between driver and pose dropped or lost."""
    inputs = (i for s in STAGES if s != "mapping" for i in statuses[s].inputs)
    return sum(i.lost + sum(i.dropped.values()) - i.dropped.get("duplicate", 0) for i in inputs)


def assert_bridged(poses: dict[tuple[int, int], PoseRecord], last: PoseRecord) -> None:
    """Checks that poses were predicted after the kill, and only for a short time."""
    after = [p for p in poses.values() if p.instant_ns > last.instant_ns]
    bridging = sum(p.health == BRIDGING for p in after)
    assert 0 < bridging <= BRIDGED_SWEEPS


def assert_last_pose_again(run: LiveRun, odometry: StatusRecord) -> None:
    """The restarted odometry publishes the pose of the newest commit that mapping has once more,
    since that pose may have been lost with its publisher while the commit arrived. It repeats no
    commit."""
    keys = run.chain.link.keys
    assert odometry.published[keys.odometry] == odometry.published[keys.odometry_features] + 1
    (_, again) = run.odometry_poses
    # The first messages of a new publisher may be sent before it knows of this subscriber.
    assert run.odometry_poses[again][0] >= run.kept_commit
    assert run.odometry_commits[again][0] > run.kept_commit


def gap_of(status: StatusRecord) -> list[int]:
    """Sweeps that the stage reports as missed while it was away."""
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
    # At its start mapping waits for the store's answer; the sweeps that it drops then were the
    # first instance's.
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
    # Sweeps that arrived while odometry caught up may be dropped from the queue; and if the machine
    # is too slow for the sensor, registration drops some too.
    assert 0 <= lost <= given_up(statuses)
    assert_last_pose_again(run, statuses["odometry"])
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


@pytest.mark.slow
def test_odometry_that_was_away_for_longer_goes_on_too(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """As with a restarted container: registration keeps the sweeps that come meanwhile."""
    run = LiveRun(build, robot_file, drive, tmp_path)
    last, statuses = run.killed("odometry", away=AWAY_SWEEPS)
    found, stamps = run.trajectory(undisturbed)
    assert "a new odom frame begins" not in (tmp_path / "odometry-again.log").read_text()
    assert without_pose(tmp_path, statuses) < AWAY_SWEEPS
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])


def test_a_new_odometry_frame_is_bridged(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """With mapping killed too, no stage keeps the odometry's commits."""
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
    # No sweep is lost, unless the machine is too slow for the sensor; then a stage reports it.
    before = [s for s in missing(run.poses, last.run) if s < last.sweep]
    assert 0 <= lost <= len(before) + given_up(statuses)
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def test_a_replay_into_the_folder_of_a_live_run_that_was_killed_keeps_its_poses(
    build: Path, robot_file: Path, drive: Capture, short: Capture, tmp_path: Path
) -> None:
    """Only the journal has them; containers write all runs into one folder."""
    run = LiveRun(build, robot_file, drive, tmp_path, store=False)
    with run:
        run.until_poses(KILL_AT)
        kill(run.chain, "integration")
        first_ns = min(pose.instant_ns for pose in run.poses.values())
    assert not (tmp_path / "trajectory.tum").exists()
    replayed(build, robot_file, sources.from_pcap(short.pcap), tmp_path, None)
    rescued, replay = (read(tmp_path / f"trajectory{n}.tum") for n in ("", "_2"))
    assert rescued.stamps_ns is not None
    assert abs(int(rescued.stamps_ns[0]) - first_ns) < 1_000_000
    # The last pose may have been published and not yet written when integration was killed.
    assert KILL_AT - 1 <= len(rescued) < len(replay)


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
        # The run was away for too long to find its place again: nothing is inserted into
        # the map.
        assert statuses["mapping"].figures["inserted"] == 0.0
    else:
        assert_as_good(found, undisturbed, drive, stamps[last.sweep])


@pytest.mark.parametrize("stage", one_quick(("driver", "odometry", "integration"), "odometry"))
def test_a_replay_has_the_same_bytes(
    build: Path,
    robot_file: Path,
    short: Capture,
    short_undisturbed: Path,
    tmp_path: Path,
    stage: str,
) -> None:
    """All state of a killed stage can be obtained from the others."""
    replayed(build, robot_file, sources.from_pcap(short.pcap), tmp_path, stage)
    assert digests(tmp_path, FILES) == digests(short_undisturbed, FILES)


def test_a_replay_goes_on_without_its_map(
    build: Path, robot_file: Path, short: Capture, short_undisturbed: Path, tmp_path: Path
) -> None:
    """Without a store a new map is created, in the frame of the old one."""
    replayed(build, robot_file, sources.from_pcap(short.pcap), tmp_path, "mapping")
    odometry = "odometry.tum"
    assert (tmp_path / odometry).read_bytes() == (short_undisturbed / odometry).read_bytes()
    written = read(tmp_path / "trajectory.tum")
    found = Trajectory(written.transforms, written.stamps_ns, np.arange(len(written)))
    assert written.stamps_ns is not None
    assert rmse_m(found, short, int(written.stamps_ns[KILL_AT])) < 0.2


@pytest.mark.slow
def test_a_capture_that_is_replayed_again_has_a_map_of_its_own(
    build: Path, robot_file: Path, short: Capture, short_undisturbed: Path, tmp_path: Path
) -> None:
    """The same capture has the same run id; still, the store's tiles of the first replay belong to
    another map."""
    tiles = tmp_path / "tiles"
    source = sources.from_pcap(short.pcap)
    replayed(build, robot_file, source, tmp_path / "first", None, tiles)
    statuses = replayed(build, robot_file, source, tmp_path / "second", "mapping", tiles)
    assert statuses["mapping"].figures["map_points_taken_back"] > 0
    written = read(tmp_path / "second" / "trajectory.tum")
    assert written.stamps_ns is not None
    found = Trajectory(written.transforms, written.stamps_ns, np.arange(len(written)))
    assert_as_good(found, short_undisturbed, short, int(written.stamps_ns[KILL_AT]))


def test_an_odometry_that_stood_still_goes_on_in_its_map(
    build: Path, robot_file: Path, drive: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    """Odometry is stopped for longer than the constant-motion prediction bridges, as in a suspended
    container."""
    run = LiveRun(build, robot_file, drive, tmp_path)
    with run:
        run.until_poses(KILL_AT)
        last = list(run.poses.values())[-1]
        process = run.chain.processes.running["odometry"]
        process.send(signal.SIGSTOP)
        time.sleep(STANDSTILL_S)
        process.send(signal.SIGCONT)
        run._until(lambda: any(goes_on_after(last, pose) for pose in run.poses.values()))
        statuses = run.end()
    found, stamps = run.trajectory(undisturbed)
    assert_as_good(found, undisturbed, drive, stamps[last.sweep])
    assert_books(statuses, STAGES)


def bridged(build: Path, drive: Capture, out: Path) -> tuple[Trajectory, NDArray[np.int64]]:
    """Replays a drive, checks that the robot was soon found in the map again, and returns the poses
    and their times."""
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
    """As when a cable is unplugged for a moment during a drive. After the longer silence, most of
    what the sensor sees lies beyond the map."""
    duration = str(SILENCE_AT_S + silence_s + AFTER_SILENCE_S)
    options = ["--gap-start", str(SILENCE_AT_S), "--gap", str(silence_s), "--duration", duration]
    drive = simulate(build, tmp_path, "--world", "city", "--seed", "3", *options)
    found, stamps_ns = bridged(build, drive, tmp_path / "out")
    gap = int(np.argmax(np.diff(stamps_ns)))
    assert stamps_ns[gap + 1] - stamps_ns[gap] > 1e9 * silence_s
    # The first poses after the silence are predictions, and flagged as such.
    after = int(stamps_ns[gap + 1]) + BRIDGED_SWEEPS * 100_000_000
    assert rmse_m(found, drive, after) <= SILENCES_RMSE_M[silence_s]


def keep_sweeps(capture: Path, kept: list[range]) -> None:
    """Removes all packets but those of these sweeps from the capture."""
    with capture.open("rb") as file:
        packets = list(dpkt.pcap.Reader(file))
    first = packets[0][0]
    with capture.open("wb") as file:
        writer = dpkt.pcap.Writer(file)
        for stamp, frame in packets:
            if any(int((stamp - first) / 0.1) in sweeps for sweeps in kept):
                writer.writepkt(frame, ts=stamp)


@pytest.mark.parametrize("holes", one_quick(tuple(HOLES), "rarer"))
def test_after_single_sweeps_the_map_is_found_again(
    build: Path, tmp_path: Path, holes: str
) -> None:
    """What a process that stood still finds in its queue: too few consecutive sweeps to estimate
    the speed, and so much way between them that no sweep matches its predecessor."""
    drive = simulate(build, tmp_path, "--world", "city", "--seed", "3", "--duration", "14")
    keep_sweeps(drive.pcap, [range(45), *HOLES[holes]])
    found, stamps_ns = bridged(build, drive, tmp_path / "out")
    assert rmse_m(found, drive, int(stamps_ns[-AT_THE_END])) <= SILENCES_RMSE_M[5.0]


@pytest.mark.parametrize("stage", one_quick(("registration", "driver"), "driver"))
def test_after_a_standstill_the_map_is_found_again(
    build: Path, robot_file: Path, tmp_path: Path, stage: str
) -> None:
    """Most of what the sensor saw meanwhile is lost; a part of it arrives late, with gaps. Where
    the remaining sweeps are close enough to continue, no new frame is needed."""
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
    # Odometry hears that registration dropped sweeps, and does not wait for them.
    assert not any(each.dropped.get("fenced") for each in statuses["odometry"].inputs)
    poses = list(run.poses.values())
    assert poses[-1].sweep > KILL_AT + 10
    unlike = [(p.sweep, HEALTH[p.health]) for p in poses if p.health in (BRIDGING, LOST)]
    assert not {p.sweep for p in poses[-10:]} & {sweep for sweep, _ in unlike}, unlike
