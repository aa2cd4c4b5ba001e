"""From packets to poses and a map, checked against the simulator's exact truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.integration.conftest import CAPTURE_SECONDS, Capture, monitor, simulate
from zloam_monitor import clouds, evaluation, trajectory
from zloam_monitor.stages import STAGES

POINT_BYTES = 24  # size of a point in a message


@pytest.fixture(scope="module")
def demo(
    build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("demo")
    done = monitor(
        "demo",
        "--preset-dir",
        build,
        "--pcap",
        capture.pcap,
        "--truth",
        capture.truth_lidar,
        "--out",
        out,
    )
    assert done.code == 0, done.said
    return out, json.loads((out / "report.json").read_text())


def test_every_sweep_gets_a_pose_and_both_identities_hold(
    demo: tuple[Path, dict[str, Any]],
) -> None:
    _, report = demo
    # A revolution takes 0.1 s; the first and the last sweep may be partial but count.
    sweeps = report["identities"]["sweeps"]
    assert CAPTURE_SECONDS * 10 <= sweeps <= CAPTURE_SECONDS * 10 + 2
    for stage in STAGES:
        assert report["sweeps"][stage]["in"] == sweeps, stage
        assert report["sweeps"][stage]["out"] == sweeps, stage
        assert report["sweeps"][stage]["lost"] == 0, stage
    assert report["identities"]["poses"] == sweeps
    assert report["identities"]["inputs_balanced"]
    assert report["identities"]["sweeps_accounted"]


def test_poses_agree_with_the_truth(demo: tuple[Path, dict[str, Any]]) -> None:
    _, report = demo
    assert report["ate_rmse_m"]["pose"] < 0.10
    assert report["rpe_1m_m"]["pose"] < 0.10
    assert report["ate_rmse_m"]["odometry"] < 0.50
    assert report["path_m"] > 5.0


def test_files_agree_with_the_report(demo: tuple[Path, dict[str, Any]]) -> None:
    out, report = demo
    poses = trajectory.read(out / "trajectory.tum")
    assert len(poses) == report["identities"]["poses"]
    # The same poses in another format, both with nine decimals.
    kitti = trajectory.read(out / "trajectory.kitti")
    np.testing.assert_allclose(kitti.transforms, poses.transforms, atol=1e-6)
    truth = trajectory.read(out / "ground_truth.tum")
    again = evaluation.evaluate(poses, truth)
    assert again.ate_rmse_m == pytest.approx(report["ate_rmse_m"]["pose"], abs=1e-6)
    # The sensor rotates at 10 Hz: consecutive poses are one sweep apart.
    steps = np.diff(poses.stamps_ns) * 1e-9
    np.testing.assert_allclose(steps[1:-1], 0.1, atol=0.002)
    assert len(clouds.read_pcd(out / "map.pcd")) > 3000
    assert (out / "picture.png").stat().st_size > 10_000


def test_report_has_every_figure(demo: tuple[Path, dict[str, Any]]) -> None:
    _, report = demo
    for stage in STAGES:
        assert report["cpu_ms_per_sweep"][stage] > 0
        assert report["rss_mib"][stage]["peak"] >= report["rss_mib"][stage]["start"] > 0
    for stage, mib in report["pss_mib"].items():
        assert 0 < mib <= report["rss_mib"][stage]["peak"]
    assert {"odometry", "mapping", "integration"} <= set(report["pss_mib"])
    moved = {s: report["bytes_per_sweep"][s] for s in ("driver", "registration", "odometry")}
    # All points of a sweep are passed on from stage to stage, 24 bytes each.
    for giver, taker in (("driver", "registration"), ("registration", "odometry")):
        assert moved[giver]["published"] > 15_000 * POINT_BYTES
        taken = moved[taker]["in_place"] + moved[taker]["copied"]
        assert taken > 15_000 * POINT_BYTES
    assert report["latency_ms"]["end_to_end"] is None
    assert report["latency_ms"]["mapped_pose"] is None
    assert report["wall_s"] > 0
    assert report["realtime_factor"] > 0


@pytest.mark.parametrize(
    ("xyz", "rpy_deg"),
    [((0.3, -0.2, 1.1), (0, 30, 90)), ((0, 0, 0.5), (180, 0, 0))],
    ids=["tilted", "upside down"],
)
def test_mounting(build: Path, tmp_path: Path, xyz: list[float], rpy_deg: list[float]) -> None:
    """Poses are those of base_link, however the sensor is mounted on it; the reference is the
    simulator's truth of base_link."""
    made = simulate(
        build,
        tmp_path,
        "--world",
        "indoor",
        "--seed",
        "2",
        "--duration",
        "4",
        "--mount-xyz",
        *map(str, xyz),
        "--mount-rpy-deg",
        *map(str, rpy_deg),
    )
    done = monitor(
        "demo",
        "--preset-dir",
        build,
        "--config",
        "deploy/robots/vlp16-indoor.yaml",
        "--pcap",
        made.pcap,
        "--out",
        tmp_path / "out",
        "--set",
        f"mounting.xyz_m={list(xyz)}",
        "--set",
        f"mounting.rpy_deg={list(rpy_deg)}",
    )
    assert done.code == 0, done.said
    poses = trajectory.read(tmp_path / "out" / "trajectory.tum")
    truth = trajectory.read(made.truth_base)
    scores = evaluation.evaluate(poses, truth)
    assert scores.ate_rmse_m < 0.05
    # Relative rotations check the axes too: they must be those of base_link, not of the sensor.
    compared = evaluation.compare(poses, truth)
    turned = np.linalg.inv(compared.truth[0, :3, :3]) @ compared.truth[-1, :3, :3]
    found = np.linalg.inv(compared.estimate[0, :3, :3]) @ compared.estimate[-1, :3, :3]
    np.testing.assert_allclose(found, turned, atol=0.02)
