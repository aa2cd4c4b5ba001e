"""Files keep every nanosecond; interpolation is exact for a constant motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zloam_monitor import cli, se3, trajectory
from zloam_monitor.trajectory import Trajectory


def turning(
    n: int = 11,
    rate_rad_s: float = 0.4,
    speed_m_s: float = 2.0,
    start_ns: int = 1700000000123456789,
) -> Trajectory:
    seconds = np.arange(n) * 0.1
    quats = Rotation.from_rotvec(np.outer(seconds * rate_rad_s, [0, 0, 1])).as_quat()
    positions = np.c_[seconds * speed_m_s, 0 * seconds, 0 * seconds]
    stamps = start_ns + (np.arange(n) * 100_000_000)
    return Trajectory(se3.matrices(positions, quats), stamps, np.arange(n))


def test_tum_keeps_the_nanosecond(tmp_path: Path) -> None:
    wanted = turning()
    trajectory.write_tum(tmp_path / "a.tum", wanted)
    got = trajectory.read(tmp_path / "a.tum")
    np.testing.assert_array_equal(got.stamps_ns, wanted.stamps_ns)
    np.testing.assert_allclose(got.transforms, wanted.transforms, atol=2e-9)


def test_kitti_round_trip(tmp_path: Path) -> None:
    wanted = turning()
    trajectory.write_kitti(tmp_path / "a.txt", wanted)
    got = trajectory.read(tmp_path / "a.txt")
    assert got.stamps_ns is None
    np.testing.assert_allclose(got.transforms, wanted.transforms, atol=2e-9)


def test_interpolation_is_exact_on_constant_motion() -> None:
    truth = turning()
    wanted = truth.stamps_ns[:-1] + 37_000_000
    got, inside = trajectory.interpolate(truth, wanted)
    assert inside.all()
    seconds = np.arange(10) * 0.1 + 0.037
    np.testing.assert_allclose(got.positions[:, 0], 2.0 * seconds, atol=1e-9)
    turned = Rotation.from_matrix(got.transforms[:, :3, :3]).as_rotvec()[:, 2]
    np.testing.assert_allclose(turned, 0.4 * seconds, atol=1e-9)


def test_interpolation_does_not_extrapolate() -> None:
    truth = turning()
    _, inside = trajectory.interpolate(truth, np.array([0, 10**19 // 2], np.int64))
    assert not inside.any()


@pytest.mark.parametrize("text", ["", "1 2 3\n", "1 0 0 0 0 0 zero 1\n"])
def test_a_wrong_file_says_so(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad").write_text(text)
    with pytest.raises(trajectory.TrajectoryError, match="bad"):
        trajectory.read(tmp_path / "bad")


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(trajectory.TrajectoryError, match="No such file"):
        trajectory.read(tmp_path / "none")


@pytest.mark.parametrize("stamp", [0, 1, -1_500_000_000, 1_700_000_000_123_456_789])
def test_stamp_text(stamp: int) -> None:
    assert trajectory.parse_stamp(trajectory.stamp_text(stamp)) == stamp


LINES = [f"1704067210.{i}00000000 {i} 0 0 0 0 0 1" for i in range(5)]
FIRST_NS = 1704067210000000000


@pytest.mark.parametrize(
    "data",
    [
        "\n".join(LINES).encode("utf-8-sig"),
        ("# x y z\n" + "\n".join(LINES)).encode("utf-8-sig"),
        "# Straße\n".encode("latin1") + "\n".join(LINES).encode(),
        "\n".join(LINES).encode("utf-16"),
        "\r\n".join(LINES).encode(),
        "\n".join(line.replace(" ", ",") for line in LINES).encode(),
        "\n".join(line.replace(" ", "; ") for line in LINES).encode(),
        ("timestamp tx ty tz qx qy qz qw\n" + "\n".join(LINES)).encode(),
        ("t x y z qx qy qz qw n\n\n" + "\n".join(f"{line} 7" for line in LINES)).encode(),
        "\n".join(f"  {line} # fine" for line in ["#", *LINES]).encode(),
        "\n".join(f"{1704067210000 + 100 * i} {i} 0 0 0 0 0 1" for i in range(5)).encode(),
        "\n".join(f"{1704067210000000 + 10**5 * i} {i} 0 0 0 0 0 1" for i in range(5)).encode(),
        "\n".join(f"{FIRST_NS + 10**8 * i} {i} 0 0 0 0 0 1" for i in range(5)).encode(),
    ],
)
def test_what_other_programs_write_is_the_same_trajectory(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.tum").write_bytes(data)
    got = trajectory.read(tmp_path / "a.tum")
    assert got.stamps_ns is not None
    assert got.stamps_ns.tolist() == [FIRST_NS + 100_000_000 * i for i in range(5)]
    np.testing.assert_array_equal(got.positions[:, 0], range(5))


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("1704067211 nan nan nan nan nan nan nan", "line 6: 'nan' is no finite number"),
        ("1704067211 inf 0 0 0 0 0 1", "line 6: 'inf' is no finite number"),
        ("1704067211 0 0 0 0 0 0 0", "line 6: the quaternion .* length 0, not 1"),
        ("1704067211 0 0 0 0 0 0", "line 6: 7 columns, 8 in the first pose"),
        ("1704067211,5;0;0;0;0;0;0;1", "line 6: decimal commas"),
        ("1e30 0 0 0 0 0 0 1", "1e.30 is no time"),
    ],
)
def test_a_line_that_is_no_pose_is_named(tmp_path: Path, line: str, reason: str) -> None:
    (tmp_path / "a.tum").write_text("\n".join([*LINES, line]))
    with pytest.raises(trajectory.TrajectoryError, match=reason):
        trajectory.read(tmp_path / "a.tum")


def test_a_mirror_is_no_rotation(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1 0 0 0 0 1 0 0 0 0 -1 0\n")
    with pytest.raises(trajectory.TrajectoryError, match=r"line 1: .* no rotation"):
        trajectory.read(tmp_path / "a.txt")


def test_damaged_files_are_read_or_refused_never_anything_else(tmp_path: Path) -> None:
    rng = np.random.default_rng(37)
    good = "\n".join(LINES).encode()
    path = tmp_path / "a.tum"
    outcomes = set()
    for _ in range(500):
        data = bytearray(good)
        for at in rng.integers(0, len(data), rng.integers(1, 5)):
            data[at] = rng.choice(list(b"-+.e0 9\n;,#_n\xef\xff\x00"))
        path.write_bytes(bytes(data[: rng.integers(1, len(data) + 1)]))
        outcomes.add(read_or_refused(path))
    assert outcomes == {"finite", "refused by name"}


def read_or_refused(path: Path) -> str:
    try:
        got = trajectory.read(path)
    except trajectory.TrajectoryError as error:
        return "refused by name" if str(path) in str(error) else str(error)
    return "finite" if np.isfinite(got.transforms).all() else "not finite"


def test_a_stamp_beyond_all_times_is_refused_by_its_line(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("1704067210.2 0 0 0 0 0 0 1\n17040677210.3 1 0 0 0 0 0 1\n")
    with pytest.raises(trajectory.TrajectoryError, match=r"a\.tum, line 2: .* is no time"):
        trajectory.read(path)


@pytest.mark.parametrize(
    "names",
    [
        "timestamp,x,y,z,qw,qx,qy,qz",
        "#timestamp [ns], p_x [m], p_y [m], p_z [m], q_w [], q_x [], q_y [], q_z []",
        "# time qx qy qz qw tx ty tz",
        "x y z qx qy qz qw time",
    ],
)
def test_other_orders_of_the_columns_are_refused(tmp_path: Path, names: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{names}\n100 1 2 3 0.5 0.5 0.5 0.5\n")
    with pytest.raises(trajectory.TrajectoryError, match="line 1: the columns are"):
        trajectory.read(path)


@pytest.mark.parametrize(
    "names",
    [
        "# ground truth of x, y and z",
        "timestamp tx ty tz qx qy qz qw",
        "time_s,x_m,y_m,z_m,qx,qy,qz,qw",
        "%time;pos.x [m];pos.y [m];pos.z [m];q.x;q.y;q.z;q.w",
        "1 2 3 4 5 6 7 8",
    ],
)
def test_names_of_columns_in_their_order_are_accepted(names: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    comment = "#" if names[0].isdigit() else ""
    path.write_text(f"{comment}{names}\n100 1 2 3 0.5 0.5 0.5 0.5\n")
    assert len(trajectory.read(path)) == 1


def test_stamps_that_go_backwards_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise KITTI's lines would be of another order than those of the file, without a word."""
    path = tmp_path / "a.tum"
    stamps = (100, 101, 50, 102, 51)
    path.write_text("".join(f"{stamp} 0 0 0 0 0 0 1\n" for stamp in stamps))
    for command in (["trajectory", path, tmp_path / "a.kitti"], ["evaluate", path, path]):
        assert cli.main([str(each) for each in command]) == 0
        assert f"{path}: its stamps go backwards at 2 lines" in capsys.readouterr().err


@pytest.mark.parametrize(
    "data", [b"\x00\x01\x02,3;4\n", b"VERSION .7\nDATA binary\n1,2;\x00\x99\n"]
)
def test_a_binary_file_is_refused_as_such(data: bytes, tmp_path: Path) -> None:
    """Its first bytes looked like numbers with commas, or like columns."""
    (tmp_path / "map.pcd").write_bytes(data)
    with pytest.raises(
        trajectory.TrajectoryError, match=r"map\.pcd: is no text; a trajectory in TUM"
    ):
        trajectory.read(tmp_path / "map.pcd")
