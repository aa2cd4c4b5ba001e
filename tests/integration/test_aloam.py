"""A-LOAM's programs instead of registration, odometry and mapping: all of them, or any single
one."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.integration.conftest import Capture, digests, kill, monitor, simulate
from tests.integration.live_run import SECONDS, SPARE_S, LiveRun, one_quick
from zloam_monitor import sources
from zloam_monitor.chain import Chain
from zloam_monitor.methods import programs
from zloam_monitor.robot_file import names
from zloam_monitor.stages import STAGES

ALOAM = programs("aloam")
#: Limit for six seconds in the city: A-LOAM's error in a minute is 0.1 m; a wrong frame would give
#: far more.
ATE_M = 0.15
FILES = ("trajectory.tum", "odometry.tum", "map.pcd")


@pytest.fixture(scope="module", autouse=True)
def built(build: Path) -> None:
    missing = [p for p in ALOAM.values() if not (build / "bin" / f"zloam-{p}").is_file()]
    if missing:
        pytest.skip(f"not built in {build} (PCL): {', '.join(missing)}")


def replay(build: Path, capture: Capture, out: Path, method: str, *more: str) -> dict[str, Any]:
    arguments = ("--pcap", capture.pcap, "--truth", capture.truth_lidar, "--out", out)
    done = monitor("demo", "--preset-dir", build, *arguments, "--method", method, *more)
    assert done.code == 0, done.said
    report: dict[str, Any] = json.loads((out / "report.json").read_text())
    return report


def ate_m(report: dict[str, Any]) -> float:
    return float(report["ate_rmse_m"]["pose"])


@pytest.fixture(scope="module")
def plain(
    build: Path, built: None, capture: Capture, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Output of a replay with all three and without further settings."""
    out = tmp_path_factory.mktemp("plain")
    replay(build, capture, out, "aloam")
    return out


def test_all_three_map_the_city_with_the_same_bytes_each_time(
    build: Path, capture: Capture, plain: Path, tmp_path: Path
) -> None:
    report = replay(build, capture, tmp_path, "aloam")
    assert ate_m(report) < ATE_M
    # Houses on all sides hold the pose in every direction.
    assert report["health"]["counts"]["ok"] >= 0.9 * report["health"]["poses"]
    assert digests(tmp_path, FILES) == digests(plain, FILES)


@pytest.mark.parametrize("stage", ALOAM)
def test_each_takes_the_place_of_one_stage(
    build: Path, capture: Capture, tmp_path: Path, stage: str
) -> None:
    assert ate_m(replay(build, capture, tmp_path, f"{stage}=aloam")) < ATE_M


@pytest.mark.slow
def test_with_deskewing(build: Path, capture: Capture, plain: Path, tmp_path: Path) -> None:
    assert ate_m(replay(build, capture, tmp_path, "aloam", "--set", "aloam.deskew=true")) < ATE_M
    # Otherwise the setting would have no effect, and the limit would be the plain method's.
    odometry = ("odometry.tum",)
    assert digests(tmp_path, odometry) != digests(plain, odometry)


@pytest.mark.parametrize("stage", one_quick(tuple(ALOAM), "mapping"))
def test_a_killed_program_is_started_again_and_every_pose_comes(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path, stage: str
) -> None:
    robot = names(robot_file, [])
    settings = [
        *sources.from_pcap(capture.pcap).driver_settings("max"),
        f"mapping.map_path={tmp_path / 'map.pcd'}",
        f"integration.output_dir={tmp_path}",
    ]
    chain = Chain(build, robot_file, robot.robot, settings, tmp_path, robot.sensor, programs=ALOAM)
    with chain:
        while len(chain.link.poses) < 15:
            chain.link.poll(0.1)
            chain.check()
        kill(chain, stage)
        chain.start(stage, "second")
        while not chain.finished():
            chain.link.poll(0.1)
            chain.check()
        found = chain.link.trajectory()
    assert found.sweeps.tolist() == list(range(len(found)))


@pytest.mark.slow
def test_a_new_odometry_frame_goes_on_where_the_last_pose_was(
    build: Path, robot_file: Path, tmp_path: Path
) -> None:
    """With mapping killed too, no stage keeps the odometry's commits. An epoch that was used twice
    would let mapping apply the old frame's correction: the pose would jump to the start."""
    seconds = str(SECONDS + SPARE_S)
    drive = simulate(build, tmp_path, "--world", "city", "--seed", "3", "--duration", seconds)
    run = LiveRun(build, robot_file, drive, tmp_path, programs=ALOAM)
    last, _ = run.killed("odometry", "mapping")
    assert "a new odom frame begins" in (tmp_path / "odometry-again.log").read_text()
    way_m = np.linalg.norm(last.translation)
    assert way_m > 2.0
    after = [p for p in run.mapped.values() if p.instant_ns > last.instant_ns]
    assert after
    assert min(np.linalg.norm(p.translation) for p in after) > 0.5 * way_m


@pytest.mark.parametrize("mode", ["localize", "extend"])
def test_its_mapping_refuses_to_find_the_robot_in_a_stored_map(
    build: Path, robot_file: Path, tmp_path: Path, mode: str
) -> None:
    """Its first tile would replace that map."""
    written = tmp_path / "robot.yaml"
    written.write_text(f"mapping: {{mode: {mode}}}\n")
    for words in (
        ("--config", robot_file, "--set", f"mapping.mode={mode}"),
        ("--config", written),
    ):
        command = [build / "bin" / f"zloam-{ALOAM['mapping']}", "--check-config", *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2, done.stderr
        assert f"mapping.mode: {mode} needs the mapping stage itself" in done.stdout + done.stderr


def test_only_they_are_linked_with_pcl_and_ceres(build: Path) -> None:
    def libraries(program: str) -> str:
        path = build / "bin" / f"zloam-{program}"
        return subprocess.run(["ldd", path], capture_output=True, text=True, check=True).stdout

    for stage, program in ALOAM.items():
        assert "libpcl_" in libraries(program), program
        assert "libpcl_" not in libraries(stage), stage
    for program in (ALOAM["odometry"], ALOAM["mapping"]):
        assert "libceres" in libraries(program), program
    for stage in STAGES:
        assert "libceres" not in libraries(stage), stage
