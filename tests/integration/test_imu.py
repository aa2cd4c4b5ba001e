"""IMU readings through the real processes: from a file in a replay, and as live messages. The
reference is the simulator's truth."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.integration.conftest import PATIENCE_S, Capture, digests, kill, monitor, simulate
from tests.integration.test_refusals import REFUSED_CONFIG, REFUSED_FILE, stage
from zloam_monitor import evaluation, sources, trajectory
from zloam_monitor.chain import Chain, binary
from zloam_monitor.records import StatusRecord
from zloam_monitor.robot_file import names

SECONDS = 9
#: poses before the kill; the platform stands for its first 1.5 s
KILL_AT = 45
FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum")
#: T_base_imu: turned upside down, beside the lidar
XYZ_M, RPY_DEG = (0.2, -0.1, 0.3), (180.0, 0.0, 90.0)
MOUNTING = [
    "mounting.imu_xyz_m=[0.2, -0.1, 0.3]",
    "mounting.imu_rpy_deg=[180, 0, 90]",
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("imu")


@pytest.fixture(scope="module")
def swing(build: Path, folder: Path) -> Capture:
    """A hand-held lidar with an IMU."""
    options = ["--world", "handheld", "--seed", "2", "--duration", str(SECONDS)]
    mounting = ["--imu-xyz", *map(str, XYZ_M), "--imu-rpy-deg", *map(str, RPY_DEG)]
    return simulate(build, folder, *options, "--imu", str(folder / "imu.csv"), *mounting)


def with_imu(readings: Path) -> list[str]:
    return ["driver.imu=file", f"driver.imu_path={readings}", *MOUNTING]


def errors(out: Path, swing: Capture) -> evaluation.Scores:
    truth = trajectory.read(swing.truth_base)
    return evaluation.evaluate(trajectory.read(out / "trajectory.tum"), truth)


def demo(build: Path, swing: Capture, out: Path, settings: list[str]) -> None:
    done = monitor(
        "demo",
        *("--preset-dir", build, "--pcap", swing.pcap, "--out", out),
        *(word for setting in settings for word in ("--set", setting)),
    )
    assert done.code == 0, done.said


@pytest.fixture(scope="module")
def undisturbed(build: Path, swing: Capture, folder: Path) -> Path:
    out = folder / "with"
    demo(build, swing, out, with_imu(folder / "imu.csv"))
    return out


def run_until(chain: Chain, done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not done():
        chain.link.poll(0.1)
        chain.check()
        assert time.monotonic() < deadline, "it never happened"


def test_a_replay_is_better_with_readings(
    build: Path, swing: Capture, undisturbed: Path, tmp_path: Path
) -> None:
    demo(build, swing, tmp_path, [])
    without, better = errors(tmp_path, swing), errors(undisturbed, swing)
    assert without.ate_rmse_m is not None
    assert better.ate_rmse_m is not None
    assert better.ate_rmse_m < 0.6 * without.ate_rmse_m
    assert better.ate_rmse_m < 0.005


@pytest.mark.parametrize("killed", ["odometry", "driver"])
def test_a_killed_stage_goes_on_to_the_byte(
    build: Path,
    robot_file: Path,
    swing: Capture,
    folder: Path,
    undisturbed: Path,
    tmp_path: Path,
    killed: str,
) -> None:
    """Biases and gravity are restored from the commits; the sweeps carry their readings again."""
    robot = names(robot_file, [])
    settings = [
        *sources.from_pcap(swing.pcap).driver_settings("realtime"),
        *with_imu(folder / "imu.csv"),
        f"integration.output_dir={tmp_path}",
        f"mapping.map_path={tmp_path / 'map.pcd'}",
        "mapping.store_link_s=0",
    ]
    with Chain(build, robot_file, robot.robot, settings, tmp_path, robot.sensor) as chain:
        run_until(chain, lambda: len(chain.link.poses) >= KILL_AT)
        kill(chain, killed)
        chain.start(killed, f"{killed}-again")
        run_until(chain, chain.finished)
        codes = chain.stop()
    assert set(codes.values()) == {0}, codes
    assert digests(tmp_path, FILES) == digests(undisturbed, FILES)


def live_settings(out: Path) -> list[str]:
    return [
        "driver.source=zenoh",
        "driver.imu=zenoh",
        *MOUNTING,
        f"integration.output_dir={out}",
        f"mapping.map_path={out / 'map.pcd'}",
        "mapping.store_link_s=0",
    ]


@contextmanager
def simulated(build: Path, chain: Chain, robot: str, *options: str) -> Iterator[None]:
    """A lidar that sends to the chain's driver meanwhile."""
    simulator = subprocess.Popen(
        [
            binary(build, "simulator"),
            *("--quiet", "--world", "handheld", "--seed", "2", "--duration", "20"),
            *("--zenoh", "--rate", "0.7", *options),
            *("--zenoh-base-port", str(chain.base_port), "--robot", robot),
            *("--imu-xyz", *map(str, XYZ_M), "--imu-rpy-deg", *map(str, RPY_DEG)),
        ]
    )
    try:
        yield
    finally:
        simulator.kill()
        simulator.wait()


def test_live_readings_go_with_their_sweeps(build: Path, robot_file: Path, tmp_path: Path) -> None:
    robot = names(robot_file, [])
    settings = live_settings(tmp_path)
    with Chain(build, robot_file, robot.robot, settings, tmp_path, robot.sensor) as chain:
        run_until(chain, lambda: status(chain, "driver") is not None)
        with simulated(build, chain, robot.robot, "--zenoh-imu"):
            run_until(chain, lambda: len(chain.link.poses) >= 50)
            chain.link.query_statuses()
            driver, odometry = status(chain, "driver"), status(chain, "odometry")
        chain.stop()
    assert driver is not None
    assert odometry is not None
    assert driver.figures["imu_readings"] > 500
    assert odometry.figures["imu_used"] == 1.0
    assert odometry.figures["imu_contradictions"] == 0.0
    # The first sweeps may begin before the first readings.
    assert driver.figures["imu_sweeps_incomplete"] <= 2


def test_an_imu_that_covers_no_sweep_is_reported_until_it_stops(
    build: Path, robot_file: Path, tmp_path: Path
) -> None:
    """Afterwards the driver says that no readings come."""
    robot = names(robot_file, [])

    def is_reported() -> bool:
        odometry = status(chain, "odometry")
        return odometry is not None and "do not cover the sweeps" in odometry.reason

    settings = live_settings(tmp_path)
    with Chain(build, robot_file, robot.robot, settings, tmp_path, robot.sensor) as chain:
        run_until(chain, lambda: status(chain, "driver") is not None)
        with simulated(build, chain, robot.robot, "--zenoh-imu", "--imu-rate", "10"):
            run_until(chain, is_reported)
        with simulated(build, chain, robot.robot):
            run_until(chain, lambda: not is_reported())
        chain.stop()


def status(chain: Chain, name: str) -> StatusRecord | None:
    return chain.link.stage(name)


NAMES = "t_ns,wx_rad_s,wy_rad_s,wz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t_ns,wx_rad_s\n1,2\n", [":1", "wy_rad_s"]),
        (NAMES + "1,0,0,0,0,zero,9.8\n", [":2", "ay_m_s2", "zero"]),
        (NAMES + "1,0,0,0,0,0,1.0\n10000001,0,0,0,0,0,1.0\n", ["in g", "9.80665"]),
        (NAMES + "1,0,0,0,0,0,-9.8\n10000001,0,0,0,0,0,-9.8\n", ["sign", "mounting.imu_rpy_deg"]),
        (NAMES + "1,0,0,0,0,0,9.8\n10000001,0,0,0,0,0,9.8\n", ["one clock"]),
        (NAMES, ["no reading"]),
    ],
    ids=["column", "number", "unit", "sign", "other clock", "nothing"],
)
def test_wrong_readings(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path, text: str, words: list[str]
) -> None:
    path = tmp_path / "readings.csv"
    path.write_text(text)
    wanted = ["driver.source=pcap", f"driver.path={capture.pcap}", "driver.imu=file"]
    options = [word for s in [*wanted, f"driver.imu_path={path}"] for word in ("--set", s)]
    done = stage(build, "driver", "--config", robot_file, *options)
    said = done.stdout + done.stderr
    assert done.returncode == REFUSED_FILE, said
    for word in [str(path), *words]:
        assert word in said


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        (["driver.source=pcap", "driver.path=x", "driver.imu=file"], "driver.imu_path"),
        (["driver.source=udp", "driver.imu=file", "driver.imu_path=x"], "driver.imu"),
        (["driver.source=pcap", "driver.path=x", "driver.imu=zenoh"], "driver.imu"),
        (["driver.imu=yes"], "driver.imu"),
    ],
)
def test_wrong_settings(build: Path, robot_file: Path, settings: list[str], key: str) -> None:
    options = [word for setting in settings for word in ("--set", setting)]
    done = stage(build, "driver", "--config", robot_file, *options)
    assert done.returncode == REFUSED_CONFIG
    # The one key is the beginning of the other's, and either complaint names both.
    assert f"{key}: " in done.stdout + done.stderr
