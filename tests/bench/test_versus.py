"""Tests the scoring of tests/bench/versus on trajectories with known errors."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.acceptance.framework import Skip
from tests.acceptance.point_files import DECODED_POINT, SYNTH_POINT
from tests.bench import framework
from tests.bench.setting import BenchSetting
from tests.bench.versus import data, peer, rows, score, summary, systems, table, turned
from zloam_monitor import trajectory
from zloam_monitor.trajectory import Trajectory

PERIOD_NS = 100_000_000
START_NS = 1_000_000_000_000
SCANS = 300


def pose_at(seconds: np.ndarray) -> np.ndarray:
    """A closed curve of about 60 m with turns."""
    out = np.tile(np.eye(4), (len(seconds), 1, 1))
    phase = 2 * np.pi * seconds / 30.0
    out[:, 0, 3], out[:, 1, 3] = 10.0 * np.sin(phase), 6.0 * np.sin(2 * phase)
    out[:, 2, 3] = 0.1 * np.sin(5 * phase)
    angles = np.stack([3.0 * np.sin(4 * phase), 0.05 * np.sin(9 * phase), 0 * phase], axis=1)
    out[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    return out


@pytest.fixture
def truth() -> Trajectory:
    seconds = np.arange(-0.2, SCANS * 0.1 + 0.4, 0.005)
    stamps = START_NS + np.round(seconds * 1e9).astype(np.int64)
    return Trajectory(pose_at(seconds), stamps, np.arange(len(stamps)))


@pytest.fixture
def starts_ns() -> np.ndarray:
    return START_NS + PERIOD_NS * np.arange(SCANS, dtype=np.int64)


def poses_at_part(part: float) -> np.ndarray:
    return pose_at((np.arange(SCANS) + part) * 0.1)


@pytest.mark.parametrize("part", [0.0, 0.5, 0.625, 1.0])
def test_the_instant_that_poses_mean_is_found(
    truth: Trajectory, starts_ns: np.ndarray, part: float
) -> None:
    """A different convention must cost a system nothing; unnoticed it would cost 5 cm at 1 m/s."""
    found = score.by_scan(poses_at_part(part), starts_ns, PERIOD_NS, truth)
    assert found.instant == part
    assert found.scores.matched == SCANS
    assert found.scores.ate_rmse_m == pytest.approx(0.0, abs=2e-4)
    assert not found.lost


def test_the_instant_is_found_under_drift_and_in_another_frame(
    truth: Trajectory, starts_ns: np.ndarray
) -> None:
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_euler("ZYX", [1.0, 0.2, -0.3]).as_matrix()
    frame[:3, 3] = [5.0, -80.0, 3.0]
    poses = frame @ poses_at_part(0.5)
    poses[:, 0, 3] += 1e-3 * np.arange(SCANS)
    assert score.by_scan(poses, starts_ns, PERIOD_NS, truth).instant == 0.5


def test_stamped_poses_are_held_to_their_own_instants(
    truth: Trajectory, starts_ns: np.ndarray
) -> None:
    """Our poses have stamps: a wrong stamp is an error, not a convention."""
    right = Trajectory(poses_at_part(1.0), starts_ns + PERIOD_NS, np.arange(SCANS))
    wrong = Trajectory(poses_at_part(0.5), starts_ns + PERIOD_NS, np.arange(SCANS))
    assert score.stamped(right, starts_ns, truth).scores.ate_rmse_m == pytest.approx(0, abs=2e-4)
    assert score.stamped(right, starts_ns, truth).instant == 1.0
    a_firing_late = Trajectory(right.transforms, right.stamps_ns + 55_000, right.sweeps)
    assert score.stamped(a_firing_late, starts_ns, truth).instant == pytest.approx(1.0, abs=1e-3)
    # Half a period late: about the rms of speed times 50 ms; the alignment removes little of it.
    speed = np.linalg.norm(np.diff(poses_at_part(0.0)[:, :3, 3], axis=0), axis=1) / 0.1
    error = score.stamped(wrong, starts_ns, truth).scores.ate_rmse_m
    assert error is not None
    assert error == pytest.approx(float(np.sqrt(np.mean(speed**2))) * 0.05, rel=0.1)


def test_noise_of_a_known_size_is_the_error(truth: Trajectory, starts_ns: np.ndarray) -> None:
    poses = poses_at_part(1.0)
    noise = np.random.default_rng(1).normal(0.0, 0.03, (SCANS, 3))
    poses[:, :3, 3] += noise
    found = score.by_scan(poses, starts_ns, PERIOD_NS, truth).scores.ate_rmse_m
    assert found == pytest.approx(0.03 * np.sqrt(3), rel=0.05)


def test_a_scale_error_is_drift_of_its_size(starts_ns: np.ndarray) -> None:
    """The alignment removes no scale error; the path is straight, so chords equal path lengths."""
    seconds = np.arange(0.0, SCANS * 0.1 + 0.3, 0.005)
    straight = np.tile(np.eye(4), (len(seconds), 1, 1))
    straight[:, 0, 3] = seconds * 2.0
    stamps = START_NS + np.round(seconds * 1e9).astype(np.int64)
    poses = np.tile(np.eye(4), (SCANS, 1, 1))
    poses[:, 0, 3] = np.arange(SCANS) * 0.2 * 1.02
    line = Trajectory(straight, stamps, np.arange(len(stamps)))
    scored = score.by_scan(poses, starts_ns, PERIOD_NS, line)
    assert scored.scores.drift_percent == pytest.approx(2.0, rel=0.06)
    assert not scored.lost


def test_who_stands_still_is_lost(truth: Trajectory, starts_ns: np.ndarray) -> None:
    standing = np.tile(np.eye(4), (SCANS, 1, 1))
    assert score.by_scan(standing, starts_ns, PERIOD_NS, truth).lost


def test_poses_without_instants_go_by_scan_number() -> None:
    poses = poses_at_part(0.0)
    truth = Trajectory(poses, None, np.arange(SCANS))
    found = score.by_scan(poses.copy(), None, PERIOD_NS, truth)
    assert found.instant is None
    assert found.scores.ate_rmse_m == pytest.approx(0.0, abs=1e-9)


def entry(ate: float, cpu: float, **more: float) -> summary.Entry:
    fixed = {"drift_percent": ate * 10, "lost": False, "sweeps": 5}
    return {"ate_rmse_m": ate, "cpu_ms_per_sweep": cpu, **fixed, **more}


def test_cpu_ratios_are_of_one_round_and_then_medians() -> None:
    """A round on a busy machine spoils neither ratio: 10/20, 30/50, 10/25."""
    rounds: list[summary.Round] = [
        {"zloam": entry(0.01, ours), "kiss-icp": entry(0.1, theirs)}
        for ours, theirs in ((10.0, 20.0), (30.0, 50.0), (10.0, 25.0))
    ]
    found = summary.systems_of(rounds)
    ratios = summary.ratios_of(found, rounds)
    assert found["zloam"]["cpu_ms_per_sweep"] == 10.0
    assert found["zloam"]["spread"]["cpu_ms_per_sweep"] == [10.0, 30.0]
    assert ratios["cpu_to_kiss-icp"] == pytest.approx(0.5)
    assert ratios["cpu_to_kiss-icp_spread"] == pytest.approx([0.4, 0.6])
    assert ratios["ate_rmse_m_best_peer"] == "kiss-icp"
    assert ratios["ate_rmse_m_to_best_peer"] == pytest.approx(0.1)


def test_a_loam_is_measured_in_the_same_rounds() -> None:
    """A-LOAM's stages run like ours in each round: 30/90, 40/100, 50/200, never a figure of another
    session."""
    rounds: list[summary.Round] = [
        {"zloam": entry(0.01, ours), "a-loam": entry(0.2, theirs)}
        for ours, theirs in ((30.0, 90.0), (40.0, 100.0), (50.0, 200.0))
    ]
    found = summary.systems_of(rounds)
    ratios = summary.ratios_of(found, rounds)
    assert ratios["cpu_to_a-loam"] == pytest.approx(1 / 3)
    assert ratios["ate_rmse_m_best_peer"] == "a-loam"
    assert "0.200" in table.errors_and_cost({"fastrot-7": found})[-1]
    without = summary.systems_of([{"zloam": entry(0.01, 30.0)}])
    assert "a-loam" not in without


def test_chains_differ_in_the_method_alone() -> None:
    assert systems.CHAINS[systems.OURS] == ()
    assert "aloam" in systems.CHAINS[systems.ALOAM]
    assert set(systems.CHAINS) <= set(systems.SYSTEMS)


def test_who_is_better_in_both_is_named_and_only_that() -> None:
    rounds: list[summary.Round] = [
        {
            "zloam": entry(0.02, 20.0),
            "kiss-icp": entry(0.9, 5.0),
            "genz-icp": entry(0.01, 90.0),
            "small-gicp": entry(0.019, 19.0),
        }
    ]
    found = summary.systems_of(rounds)
    assert summary.ratios_of(found, rounds)["beaten_by"] == ["small-gicp"]


def session_of(found: summary.Round) -> rows.Session:
    """A session that has measured one seed of each scene once, with these figures."""
    session = rows.Session(BenchSetting(Path(), Path(), Path()), rows.Options())
    for name in (f"{scene}-7" for scene in data.SCENES):
        session.found[name] = summary.systems_of([found])
        session.ratios[name] = summary.ratios_of(session.found[name], [found])
    return session


def test_rows_are_not_held_by_peers_that_did_not_run() -> None:
    ours, kiss, aloam = entry(0.02, 20.0), entry(0.9, 50.0), entry(0.5, 90.0)
    kept = {**kiss, "cpu_ms_per_sweep": None}
    not_installed = {"skipped": "not installed"}
    cases: list[tuple[summary.Round, bool | None, bool | None]] = [
        ({"zloam": ours, "kiss-icp": kiss, "a-loam": aloam}, True, True),
        ({"zloam": ours, "kiss-icp": kiss, "a-loam": not_installed}, True, None),
        ({"zloam": ours, "kiss-icp": kept, "a-loam": not_installed}, None, None),
        ({"zloam": ours, "kiss-icp": entry(0.01, 5.0)}, False, False),
    ]
    for found, beaten, cpu in cases:
        session = session_of(found)
        assert rows._beaten(session).held == beaten
        if found["kiss-icp"].get("cpu_ms_per_sweep") is None:
            with pytest.raises(Skip, match="no peer was run"):
                rows._cpu(session)
        else:
            assert rows._cpu(session).held == cpu


def test_a_peer_that_did_not_run_has_a_reason_and_no_figure() -> None:
    rounds: list[summary.Round] = [
        {"zloam": entry(0.02, 20.0), "mad-icp": {"skipped": "not installed"}}
    ]
    found = summary.systems_of(rounds)
    assert found["mad-icp"] == {"skipped": "not installed"}
    assert summary.best_peer(found, "ate_rmse_m") is None
    text = table.document(
        {"sim-park-1": found}, {"sim-park-1": summary.ratios_of(found, rounds)}, ""
    )
    assert "skipped" in text
    assert "sim-park-1 (without kiss-icp, genz-icp, small-gicp, mad-icp)" in text


def test_scenes_take_the_median_over_their_seeds_and_a_lost_seed_stays_visible() -> None:
    names = ("city-7", "city-11", "city-23", "city-7-s8", "drive")
    found = {n: {"zloam": {"lost": n == "city-11"}} for n in names}
    ratios = {
        n: {"ate_rmse_m_to_best_peer": v, "drift_percent_to_best_peer": v, "cpu_to_kiss-icp": 2.0}
        for n, v in zip(names, (0.1, 0.3, 0.2, 9.0, 9.0), strict=True)
    }
    over = summary.over_sets(found, ratios, data.scene_of)
    assert list(over["scene"]) == ["city"]
    assert over["scene"]["city"]["ate_rmse_m_to_best_peer"] == 0.2
    assert over["scene"]["city"]["lost"] == ["city-11"]
    assert over["cpu_to_kiss_icp_geometric_mean"] == pytest.approx(2.0)


def test_the_peers_program_starts_in_its_own_environment(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(systems.PEER)],
        cwd=tmp_path,
        env=systems.peers_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert "usage:" in done.stdout + done.stderr


def test_written_scans_are_read_back_by_the_peers(tmp_path: Path) -> None:
    """Decoded points of four revolutions, the outer two partial: positions and times are
    preserved."""
    points = np.zeros(40, DECODED_POINT)
    points["xyz"] = np.arange(120).reshape(40, 3)
    points["sweep"] = np.repeat([0, 1, 2, 3], 10)
    points["time_ns"] = START_NS + np.arange(40) * 10_000_000
    data.write_scans(tmp_path, points)
    read = peer.Data.at(tmp_path)
    scans = list(read.scans())
    assert read.timed
    assert read.least_range_m == 0.5
    assert len(scans) == 2
    for (xyz, times), first in zip(scans, (10, 20), strict=True):
        np.testing.assert_array_equal(xyz, points["xyz"][first : first + 10])
        np.testing.assert_allclose(times, np.arange(10) * 0.1, atol=1e-9)
    starts = [line.split()[0] for line in (tmp_path / "stamps.txt").read_text().splitlines()]
    assert starts == ["1000.100000000", "1000.200000000"]


def test_kitti_scans_have_no_times_and_no_zero_points(tmp_path: Path) -> None:
    (tmp_path / "velodyne").mkdir()
    rows = np.array([[1, 2, 3, 0.5], [0, 0, 0, 0]], "<f4")
    rows.tofile(tmp_path / "velodyne" / "000000.bin")
    meta = {"scans_in": "velodyne", "period": 0.1, "timestamps": False, "rings": 64}
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    read = peer.Data.at(tmp_path)
    ((xyz, _),) = list(read.scans())
    np.testing.assert_array_equal(xyz, [[1, 2, 3]])
    assert not read.timed
    assert read.least_range_m == 3.0


def test_reports_of_several_benchmarks_meet_at_the_top(tmp_path: Path) -> None:
    results = [
        framework.Result("a", "", "", "", "", 0.0, {}, {"ratio": {"a": 1}, "a": {"x": 1}}),
        framework.Result("b", "", "", "", "", 0.0, {}, {"ratio": {"b": 2}}),
    ]
    framework.write(tmp_path, results, {"cpu": "x", "cores": 1, "load_1min": 0.0})
    found = json.loads((tmp_path / "report.json").read_text())
    assert found["ratio"] == {"a": 1, "b": 2}
    assert found["a"] == {"x": 1}
    assert [row["name"] for row in found["benchmarks"]] == ["a", "b"]


def test_numbers_keep_three_digits() -> None:
    given = (None, 0.0, 0.00721, 0.5, 12.345, 123.4, 1234.0)
    assert [table.number(v) for v in given] == ["–", "0", "0.00721", "0.500", "12.3", "123", "1234"]


def test_known_data_sets_only(tmp_path: Path) -> None:
    sets = [data.DataSet(n, lambda: pytest.fail("not to be made")) for n in ("city-7", "city-11")]
    assert [s.name for s in data.chosen(sets, "city-*")] == ["city-7", "city-11"]
    assert data.chosen(sets, "all") == sets
    with pytest.raises(SystemExit, match="town"):
        data.chosen(sets, "town")


def test_rounds_of_some_systems_only_give_ratios_of_their_own() -> None:
    """A long data set is measured in parts: a peer is compared with our figures of its own
    rounds."""
    rounds: list[summary.Round] = [
        {"zloam": entry(0.01, 10.0), "kiss-icp": entry(0.1, 20.0)},
        {"zloam": entry(0.01, 30.0), "genz-icp": entry(0.1, 60.0)},
    ]
    ratios = summary.ratios_of(summary.systems_of(rounds), rounds)
    assert ratios["cpu_to_kiss-icp"] == pytest.approx(0.5)
    assert ratios["cpu_to_genz-icp"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("limit", "held", "verdict"),
    [
        ("≤ 1", True, "held"),
        ("≤ 1", False, "not held"),
        ("≤ 1", None, "reported"),
        ("", None, "reported"),
    ],
)
def test_a_limit_is_judged_only_where_it_can_be(
    limit: str, held: bool | None, verdict: str
) -> None:
    row = framework.Benchmark("a", "", lambda: framework.Outcome("", {}, held), limit)
    assert framework.run(row).verdict == verdict


def test_only_names_benchmarks_by_parts() -> None:
    def unused() -> framework.Outcome:
        raise AssertionError

    names = ["live-cpu", "slow-reader-shm", "transport-shm", "transport-shm-faults"]
    benchmarks = [framework.Benchmark(name, "", unused) for name in names]

    def chosen(pattern: str | None) -> list[str]:
        return [b.name for b in framework.chosen(benchmarks, pattern)]

    assert chosen(None) == names
    assert chosen("transport-shm") == ["transport-shm"]
    assert chosen("live-*, transport-*") == [names[0], *names[2:]]
    assert chosen("shm") == names[1:]
    assert chosen("city-*") == []


def test_a_turned_set_shows_the_same_world(tmp_path: Path) -> None:
    """The position of a point in the world does not depend on the sensor's mounting."""
    straight, out = tmp_path / "straight", tmp_path / "turned"
    (straight / "scans").mkdir(parents=True)
    out.mkdir()
    count = turned.LATER_SCANS + 2
    scan = np.zeros(50, SYNTH_POINT)
    scan["xyz"] = np.random.default_rng(1).normal(scale=10.0, size=(50, 3))
    for number in range(count):
        scan["intensity"] = number
        scan.tofile(straight / "scans" / f"{number:06d}.bin")
    seconds = np.arange(count) * 0.1
    stamps = (seconds * 1e9).astype(np.int64)
    truth = Trajectory(pose_at(seconds), stamps, np.arange(count))
    trajectory.write_tum(straight / "gt_dense.tum", truth)
    lines = [f"{i}.0 {i + 1}.0" for i in range(count)]
    (straight / "stamps.txt").write_text("\n".join(lines))
    (straight / "meta.json").write_text(json.dumps({"rings": 16, "scans": count}))

    turned.write_turned(straight, out)

    seen = np.fromfile(out / "scans/000001.bin", SYNTH_POINT)
    at = turned.LATER_SCANS + 1
    pose = trajectory.read(out / "gt_dense.tum").transforms[at]
    expected = scan["xyz"] @ truth.transforms[at, :3, :3].T + truth.transforms[at, :3, 3]
    assert seen["intensity"][0] == at
    assert np.allclose(seen["xyz"] @ pose[:3, :3].T + pose[:3, 3], expected, atol=1e-5)
    assert not np.allclose(seen["xyz"], scan["xyz"], atol=1.0)
    assert (out / "stamps.txt").read_text().splitlines() == lines[turned.LATER_SCANS :]
    assert json.loads((out / "meta.json").read_text()) == {"rings": 16, "scans": 2}
    assert data.scene_of("city-7-turned") == "city-turned"
