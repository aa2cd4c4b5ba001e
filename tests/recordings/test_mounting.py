"""The lidar's mounting is taken from a recording's static transforms; scipy provides the
reference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.integration.conftest import Capture, monitor
from tests.recordings import variants
from tests.recordings.variants import CONTAINERS, PLAIN, Scan
from zloam_monitor import se3, sources, trajectory

#: frame of the messages in variants.py
LIDAR = "lidar"
TURN = Rotation.from_euler("ZYX", [30.0, -8.0, 5.0], degrees=True)
MAST, HEAD = (0.4, -0.2, 1.1), (0.05, 0.0, 0.3)
CHAIN = [
    ("base_link", "mast", MAST, TURN.as_quat()),
    ("mast", LIDAR, HEAD, Rotation.from_euler("X", 180.0, degrees=True).as_quat()),
]
Transform = tuple[str, str, Any, Any]


def matrix(xyz: Any, quaternion: Any) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    pose[:3, 3] = xyz
    return pose


@pytest.fixture(scope="module")
def scans(build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> list[Scan]:
    return variants.decoded(build, capture.pcap, tmp_path_factory.mktemp("decoded"))


def recorded(path: Path, scans: list[Scan], transforms: list[Transform]) -> Path:
    with variants.Recorder(CONTAINERS[6], path) as bag:
        if transforms:
            bag.put_static(transforms)
        for scan in scans:
            bag.put_cloud("/points", scan, PLAIN)
            bag.put_imu("/imu", scan.stamp_ns, np.zeros(3), np.array([0.0, 0.0, 9.8]))
    return path


def said(path: Path, capsys: pytest.CaptureFixture[str], *settings: str) -> tuple[list[str], str]:
    found = sources.from_bag(path, settings)
    mounting = [word for word in found.settings if word.startswith("mounting.")]
    return mounting, capsys.readouterr().out


def test_poses_are_those_of_base_link(
    build: Path, capture: Capture, scans: list[Scan], tmp_path: Path
) -> None:
    """The same drive with and without static transforms: the poses differ by the lidar's
    mounting."""
    found = []
    for name, transforms in (("bare", []), ("tree", CHAIN)):
        bag, out = recorded(tmp_path / name, scans, transforms), tmp_path / f"{name}-out"
        done = monitor("demo", "--preset-dir", build, "--bag", bag, "--out", out)
        assert done.code == 0, done.said
        found.append(trajectory.read(out / "trajectory.tum").transforms)
    lidar, base = found
    T_base_lidar = matrix(*CHAIN[0][2:]) @ matrix(*CHAIN[1][2:])
    wanted = T_base_lidar @ lidar @ np.linalg.inv(T_base_lidar)
    assert len(base) == len(lidar)
    np.testing.assert_allclose(base[:, :3, 3], wanted[:, :3, 3], atol=0.03)
    turned = np.swapaxes(base[:, :3, :3], 1, 2) @ wanted[:, :3, :3]
    assert np.degrees(Rotation.from_matrix(turned).magnitude()).max() < 0.1


def test_the_imu_has_its_own(
    scans: list[Scan], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The IMU's frame in these messages is the lidar's."""
    bag = recorded(tmp_path / "bag", scans[:12], CHAIN)
    words, _ = said(bag, capsys, "driver.imu=sensor")
    of = dict(word.split("=", 1) for word in words)
    assert set(of) == {
        f"mounting.{name}" for name in ("xyz_m", "rpy_deg", "imu_xyz_m", "imu_rpy_deg")
    }
    read = {key: [float(v) for v in value.strip("[]").split(",")] for key, value in of.items()}
    wanted = matrix(*CHAIN[0][2:]) @ matrix(*CHAIN[1][2:])
    for of_what in ("", "imu_"):
        xyz_m, rpy_deg = (read[f"mounting.{of_what}{name}"] for name in ("xyz_m", "rpy_deg"))
        np.testing.assert_allclose(se3.from_xyz_rpy_deg(xyz_m, rpy_deg), wanted, atol=1e-7)


def test_what_the_user_says_stands(
    scans: list[Scan], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = recorded(tmp_path / "bag", scans[:12], CHAIN)
    words, text = said(bag, capsys, "mounting.xyz_m=[0, 0, 1]")
    assert words == []
    assert "the mounting that you give stands" in text


@pytest.mark.parametrize(
    ("name", "transforms", "wanted"),
    [
        ("prefixed", [("robot1/base_link", LIDAR, MAST, TURN.as_quat())], "in robot1/base_link"),
        ("below", [(LIDAR, "base_link", MAST, TURN.as_quat())], "in base_link"),
        ("no base", [("mast", LIDAR, MAST, TURN.as_quat())], "to no base_link"),
        (
            "two bases",
            [
                ("a/base_link", LIDAR, MAST, TURN.as_quat()),
                (LIDAR, "b/base_link", HEAD, (0, 0, 0, 1)),
            ],
            "to no base_link",
        ),
        ("elsewhere", [("base_link", "camera", MAST, TURN.as_quat())], "to no base_link"),
    ],
)
def test_the_tree_may_be_any(
    scans: list[Scan],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    transforms: list[Transform],
    wanted: str,
) -> None:
    bag = recorded(tmp_path / "bag", scans[:12], transforms)
    words, text = said(bag, capsys)
    assert wanted in text, name
    assert bool(words) == wanted.startswith("in ")


@pytest.mark.parametrize(
    ("transforms", "wanted"),
    [
        ([("base_link", LIDAR, MAST, (0.0, 0.0, 0.0, 0.0))], "no rotation and translation"),
        ([("base_link", LIDAR, (np.nan, 0, 0), (0, 0, 0, 1))], "no rotation and translation"),
        ([(LIDAR, "a", MAST, (0, 0, 0, 1)), ("a", LIDAR, MAST, (0, 0, 0, 1))], "is above itself"),
    ],
)
def test_what_is_no_tree_is_refused(
    scans: list[Scan], tmp_path: Path, transforms: list[Transform], wanted: str
) -> None:
    bag = recorded(tmp_path / "bag", scans[:12], transforms)
    with pytest.raises(sources.SourceError, match=wanted):
        sources.from_bag(bag, [])


def test_an_imu_that_is_not_in_the_tree_is_asked_for(scans: list[Scan], tmp_path: Path) -> None:
    with variants.Recorder(CONTAINERS[6], tmp_path / "bag") as bag:
        bag.put_static(CHAIN)
        for scan in scans[:12]:
            bag.put_cloud("/points", scan, PLAIN)
            bag.put_imu("/imu", scan.stamp_ns, np.zeros(3), np.ones(3), frame="imu")
    with pytest.raises(sources.SourceError, match=r"mounting.imu_xyz_m"):
        sources.from_bag(tmp_path / "bag", ["driver.imu=sensor"])
    sources.from_bag(tmp_path / "bag", ["driver.imu=sensor", "mounting.imu_xyz_m=[0, 0, 0]"])
