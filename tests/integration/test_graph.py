"""The graph of loops beside a replay: what it makes of a drive on which mapping drifts, and that no
other stage is affected by it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import Capture, digests, kill, monitor, simulate
from tests.integration.replay_run import chain_of
from zloam_monitor import clouds, messages, trajectory
from zloam_monitor.chain import Chain
from zloam_monitor.loops import LoopRecord, add, known, remove

#: A poor sensor, with a map that forgets what is behind: the second round meets no old map, so
#: drift shows.
SENSOR = ("--noise", "0.06", "--dropout", "0.3", "--range-bias-mm", "30")
FORGETS = "mapping.voxel_planes.keep_radius_m=25"
POSES = ("trajectory.tum", "trajectory.kitti", "odometry.tum", "map.pcd")
#: sweeps that pass while the graph is dead
MISSED = 40
WORLD = ("trajectory_world.tum", "map_world.pcd")
ONE_ROUND = ("--world", "city", "--seed", "5", "--speed-factor", "1.6")
#: size of the cells in which a wall is a plane, and the fewest points from which its thickness is
#: measured
CELL_M, FEWEST_POINTS = 1.0, 30


@pytest.fixture(scope="module")
def rounds(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Two rounds of the block."""
    folder = tmp_path_factory.mktemp("rounds")
    return simulate(build, folder, *ONE_ROUND, "--laps", "2", *SENSOR)


@pytest.fixture(scope="module")
def undisturbed(build: Path, rounds: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of a demo with the graph."""
    out = tmp_path_factory.mktemp("with_graph")
    given = ("--pcap", rounds.pcap, "--truth", rounds.truth_lidar, "--set", FORGETS)
    done = monitor("demo", "--preset-dir", build, *given, "--graph", "--out", out)
    assert done.code == 0, done.said
    assert "loops in force between" in done.said
    assert "pose with loops closed against" in done.said
    return out


def test_closed_loops_are_nearer_to_the_truth(undisturbed: Path) -> None:
    report = json.loads((undisturbed / "report.json").read_text())
    assert report["loops"]["submaps"] > 60
    assert report["loops"]["loops"] > 15
    errors = report["ate_rmse_m"]
    assert errors["world"] < 0.8 * errors["pose"]


def thickness_m(points: Path) -> float:
    """Thickness of the surfaces: the median over cells of the points' smallest spread."""
    cloud = clouds.read_pcd(points)
    positions = np.stack([cloud[axis] for axis in "xyz"], axis=-1).astype(np.float64)
    cells = np.floor(positions / CELL_M).astype(np.int64)
    _, cell, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(cell.ravel(), kind="stable")
    first = np.concatenate(([0], np.cumsum(counts)[:-1]))
    sorted_points = positions[order]
    means = np.add.reduceat(sorted_points, first) / counts[:, None]
    off = sorted_points - np.repeat(means, counts, axis=0)
    spread = np.add.reduceat(off[:, :, None] * off[:, None, :], first) / counts[:, None, None]
    smallest = np.linalg.eigvalsh(spread[counts >= FEWEST_POINTS])[:, 0]
    return float(np.median(np.sqrt(np.maximum(smallest, 0.0))))


@pytest.mark.slow
def test_walls_are_single_where_loops_are_closed(
    build: Path, undisturbed: Path, tmp_path: Path
) -> None:
    """Surfaces seen on two rounds are as thin as those seen on one."""
    once = simulate(build, tmp_path, *ONE_ROUND, *SENSOR)
    out = tmp_path / "out"
    given = ("--pcap", once.pcap, "--set", FORGETS, "--graph", "--out", out)
    done = monitor("demo", "--preset-dir", build, *given)
    assert done.code == 0, done.said
    assert thickness_m(undisturbed / "map_world.pcd") < 1.2 * thickness_m(out / "map_world.pcd")


@pytest.mark.slow
def test_a_graph_that_is_killed_is_missed_by_nobody_and_answers_strangers(
    build: Path, robot_file: Path, rounds: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    chain = chain_of(build, robot_file, rounds.pcap, tmp_path, FORGETS, beside=("graph",))
    keys, newest = chain.link.keys, list[bytes]()
    heard = chain.link.session.declare_subscriber(
        keys.graph_poses, lambda sample: newest.append(bytes(sample.payload))
    )
    with chain:
        for sweep in (150, 500):
            while len(chain.link.mapped) < sweep:
                chain.link.poll(0.05)
                chain.check()
            kill(chain, "graph")
            while len(chain.link.mapped) < sweep + MISSED:
                chain.link.poll(0.05)
            chain.start("graph")
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
        assert digests(tmp_path, POSES) == digests(undisturbed, POSES)
        # The restarted graph has caught up on the missed sweeps: same graph as without the restart.
        assert digests(tmp_path, WORLD) == digests(undisturbed, WORLD)
        heard.undeclare()
        takes_a_loop_out(chain, newest[-1])
        assert all(code == 0 for code in chain.stop().values())
    assert digests(tmp_path, WORLD) != digests(undisturbed, WORLD)
    # Without loops, the second round's walls stand beside those of the first.
    open_m, closed_m = (thickness_m(f / "map_world.pcd") for f in (tmp_path, undisturbed))
    assert open_m > 1.2 * closed_m


@pytest.mark.parametrize("seconds", ["6", "6.1"])
def test_a_run_of_which_only_some_sweeps_are_mapped_ends(
    build: Path, tmp_path: Path, seconds: str
) -> None:
    """The last sweep of one of the two has an odd number, which mapping.every=2 leaves out."""
    drive = simulate(build, tmp_path, *ONE_ROUND, "--duration", seconds)
    out = tmp_path / "out"
    given = ("--pcap", drive.pcap, "--set", "mapping.every=2", "--graph", "--map", tmp_path / "map")
    done = monitor("demo", "--preset-dir", build, *given, "--out", out)
    assert done.code == 0, done.said
    poses, world = (trajectory.read(out / name) for name in ("trajectory.tum", WORLD[0]))
    assert poses.stamps_ns is not None
    assert world.stamps_ns is not None
    assert world.stamps_ns[-1] == poses.stamps_ns[-1]
    assert len(world) <= len(poses) // 2 + 2


def takes_a_loop_out(chain: Chain, payload: bytes) -> None:
    """Removes a loop by a message, as any program on the network can."""
    poses = messages.decode("GraphPoses", payload)
    submaps = messages.struct_vector(poses, "Poses", messages.SUBMAP_POSE)
    assert len(submaps) > 60
    assert np.isfinite(submaps["world"]["translation"]["x"]).all()
    path = messages.decode("Path", next(iter(chain.link.get(chain.link.keys.path_world))))
    corrected = messages.struct_vector(path, "Poses", messages.STAMPED_POSE)
    assert len(corrected) == len(chain.link.mapped)

    found = known(chain.link)
    in_force = [loop for loop in found if loop.verdict == "accepted"]
    assert poses.Loops() == len(in_force) > 15
    first = in_force[0]
    adds_and_removes(chain, first)
    # Half a round farther is no place of the beginning: refused, and no pose moves.
    moved = next(iter(chain.link.get(chain.link.keys.path_world)))
    false = add(chain.link, first.from_sweep, in_force[len(in_force) // 2].to_sweep, force=False)
    assert not false.ok
    assert "refused: " in false.message
    assert next(iter(chain.link.get(chain.link.keys.path_world))) == moved
    # Loops that were taken back because of one that is removed count again.
    while left := [loop for loop in known(chain.link) if loop.verdict == "accepted"]:
        assert remove(chain.link, left[0].from_sweep, left[0].to_sweep).ok
    again = remove(chain.link, first.from_sweep, first.to_sweep)
    assert not again.ok
    assert "no loop is in force" in again.message
    unknown = remove(chain.link, 1, 2)
    assert not unknown.ok
    assert "from_sweep" in unknown.message


def adds_and_removes(chain: Chain, loop: LoopRecord) -> None:
    """A loop that is taken out and named again is verified again; a loop is not added twice."""
    ends = (loop.from_sweep, loop.to_sweep)
    assert not add(chain.link, *ends, force=False).ok
    assert remove(chain.link, *ends).ok
    assert {each.verdict for each in known(chain.link) if each.from_sweep == ends[0]} >= {"removed"}
    named = add(chain.link, *ends, force=False)
    assert named.ok, named.message
    assert any(
        (each.from_sweep, each.to_sweep, each.verdict) == (*ends, "accepted")
        for each in known(chain.link)
    )
