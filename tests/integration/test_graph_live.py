"""The graph of loops beside a live run in which mapping begins a new map, or driver and graph are
started again: no pose of the drive is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import Capture, kill, simulate
from tests.integration.live_run import SPARE_S, LiveRun, beside_command
from zloam_monitor import clouds, messages
from zloam_monitor.records import StatusRecord
from zloam_monitor.trajectory import Trajectory, read

SECONDS = 22.0
#: number of received poses: enough way for some submaps
FIRST_PART = 80
#: poses after a stage was started again
SECOND_PART = 25
#: submaps before the graph is killed
SOME_SUBMAPS = 2
#: The drive is sent this many times slower than recorded. A driver begins with the host's time: at
#: a slower pace the sensor seems to have been away for the seconds by which its own time is late.
NEARLY_LIVE = 1.1
#: At 10 Hz a car drives less per sweep.
LONGEST_STEP_M = 2.0


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    seconds = str(SECONDS + SPARE_S)
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", seconds)


def start_graph(build: Path, robot_file: Path, run: LiveRun, log: str) -> None:
    own = f"graph.output_dir={run.out}"
    command = beside_command(build, robot_file, run.chain, "graph", own)
    run.chain.processes.start("graph", command, run.out / f"{log}.log")


def mapped_poses(run: LiveRun, statuses: dict[str, StatusRecord]) -> int:
    return int(statuses["mapping"].published[run.chain.link.keys.map_odometry])


def submaps(run: LiveRun) -> float:
    status = run.chain.link.stage("graph")
    return status.figures.get("submaps", 0.0) if status else 0.0


def is_new(run: LiveRun, before: StatusRecord) -> bool:
    """Whether another instance of the graph than the one before is there."""
    status = run.chain.link.stage("graph")
    return status is not None and status.instance != before.instance


def has_taken_over(run: LiveRun, before: StatusRecord) -> bool:
    """Whether another instance of the graph has as many submaps as the one before."""
    return is_new(run, before) and submaps(run) >= before.figures["submaps"]


def wait_for_submaps(run: LiveRun) -> StatusRecord:
    """Waits for some submaps; returns the graph's status."""
    run._until(lambda: submaps(run) >= SOME_SUBMAPS)
    status = run.chain.link.stage("graph")
    assert status is not None
    return status


def world_path(run: LiveRun) -> tuple[int, int]:
    """The map that the graph's path names, and the path's first instant; zeros without a pose."""
    answers = run.chain.link.get(run.chain.link.keys.path_world)
    path = next((messages.decode("Path", each) for each in answers), None)
    if path is None:
        return 0, 0
    poses = messages.struct_vector(path, "Poses", messages.STAMPED_POSE)
    return path.Header().MapId(), int(poses["instant_ns"][0])


def maps_of(folder: Path) -> set[Path]:
    """Files of mapping's maps."""
    return {path for path in folder.glob("map*.pcd") if "world" not in path.name}


def smooth(path: Path) -> Trajectory:
    """A trajectory that was written in one frame, without a step."""
    found = read(path)
    assert np.linalg.norm(np.diff(found.positions, axis=0), axis=1).max() < LONGEST_STEP_M
    return found


@pytest.mark.slow
def test_each_map_of_a_run_has_its_own_files(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path, store=False, seconds=SECONDS)
    start_graph(build, robot_file, run, "graph")
    with run:
        run.until_poses(FIRST_PART)
        reply = run.chain.link.command("mapping", "reset", {})
        assert reply is not None
        assert reply.ok
        reset_ns = list(run.mapped.values())[-1].instant_ns
        run._until(lambda: world_path(run)[1] > reset_ns)
        # Before the new map's first submap, too, the answer names it.
        assert world_path(run)[0] == reply.results["map_id"]
        run.until_poses(len(run.poses) + SECOND_PART)
        statuses = run.end()
    first, second = (smooth(tmp_path / f"trajectory_world{n}.tum") for n in ("", "_2"))
    assert first.stamps_ns is not None
    assert second.stamps_ns is not None
    assert first.stamps_ns[-1] < second.stamps_ns[0]
    assert len(first) + len(second) == mapped_poses(run, statuses)
    for number in ("", "_2"):
        assert len(clouds.read_pcd(tmp_path / f"map_world{number}.pcd")) > 0


@pytest.mark.slow
def test_a_graph_that_is_killed_after_the_driver_lacks_nothing(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    """Mapping goes on over the driver's restart, and its sweep numbers begin again at 0."""
    run = LiveRun(build, robot_file, drive, tmp_path, seconds=SECONDS)
    start_graph(build, robot_file, run, "graph")
    with run:
        run.until_poses(FIRST_PART)
        last = run.restart("driver")
        run._until(lambda: sum(r != last.run for r, _ in run.mapped) >= SECOND_PART)
        undisturbed = wait_for_submaps(run)
        kill(run.chain, "graph")
        start_graph(build, robot_file, run, "graph-again")
        run._until(lambda: has_taken_over(run, undisturbed))
        statuses = run.end()
        again = run.chain.link.stage("graph")
    assert again is not None
    assert again.instance != undisturbed.instance
    assert again.figures["submaps"] >= undisturbed.figures["submaps"]
    # On a busy machine the driver may be away for so long that mapping begins another map.
    written = [smooth(path) for path in tmp_path.glob("trajectory_world*.tum")]
    assert len(written) == len(maps_of(tmp_path))
    assert sum(map(len, written)) == mapped_poses(run, statuses)


def test_a_graph_that_is_started_again_with_the_driver_lacks_nothing(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    """Its first message is sweep 0 of the driver's second run, in the map of the first one."""
    run = LiveRun(build, robot_file, drive, tmp_path, slower=NEARLY_LIVE, seconds=SECONDS)
    start_graph(build, robot_file, run, "graph")
    with run:
        run.until_poses(FIRST_PART)
        before, last = wait_for_submaps(run), list(run.poses.values())[-1]
        kill(run.chain, "graph", "driver")
        # At once: after three seconds without sweeps, mapping begins another map.
        start_graph(build, robot_file, run, "graph-again")
        run.chain.start("driver", "driver-again")
        run._until(lambda: sum(r != last.run for r, _ in run.mapped) >= SECOND_PART)
        statuses = run.end()
        assert is_new(run, before)
        assert submaps(run) > before.figures["submaps"]
    if len(maps_of(tmp_path)) > 1:
        pytest.skip("the driver was away for so long that mapping began another map")
    assert len(read(tmp_path / "trajectory_world.tum")) == mapped_poses(run, statuses)
