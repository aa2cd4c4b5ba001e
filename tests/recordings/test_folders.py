"""Folders of clouds in each format are read back and replayed."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray
from pypcd4 import Encoding, PointCloud

from tests.integration.conftest import Capture, monitor
from tests.recordings import variants
from tests.recordings.test_bag_clouds import assert_same
from tests.recordings.variants import Scan
from zloam_monitor import trajectory
from zloam_monitor.recordings import Refused, folders, stream
from zloam_monitor.recordings.sweeps import Sweep, Sweeper, Timing

FIELDS = {"x": "f4", "y": "f4", "z": "f4", "intensity": "f4", "ring": "u2", "t": "u4"}
PLY_TYPES = {"f4": "float", "u2": "ushort", "u4": "uint32"}
LAS_STEP_M = 1e-3


def table(scan: Scan) -> NDArray[Any]:
    points = np.zeros(len(scan.xyz), [(n, "<" + t) for n, t in FIELDS.items()])
    for axis, name in enumerate("xyz"):
        points[name] = scan.xyz[:, axis]
    points["intensity"], points["ring"], points["t"] = scan.intensity, scan.ring, scan.time_ns
    return points


def pcd(encoding: Encoding) -> Callable[[Path, Scan], None]:
    def write(path: Path, scan: Scan) -> None:
        points = table(scan)
        types = [np.dtype(t).type for t in FIELDS.values()]
        columns = [points[name] for name in FIELDS]
        cloud = PointCloud.from_points(columns, tuple(FIELDS), types)
        cloud.save(path.with_suffix(".pcd"), encoding=encoding)

    return write


def pcd_ascii(path: Path, scan: Scan) -> None:
    """Written by hand: the library rounds to ten decimals."""
    points = table(scan)
    rows = "\n".join(" ".join(repr(v.item()) for v in p) for p in points)
    head = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {' '.join(FIELDS)}\nSIZE 4 4 4 4 2 4\nTYPE F F F F U U\n"
        f"COUNT 1 1 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA ascii\n"
    )
    path.with_suffix(".pcd").write_text(head + rows + "\n")


def ply(form: str) -> Callable[[Path, Scan], None]:
    def write(path: Path, scan: Scan) -> None:
        points = table(scan)
        properties = "".join(f"property {PLY_TYPES[t]} {n}\n" for n, t in FIELDS.items())
        head = f"ply\nformat {form} 1.0\ncomment by hand\nelement vertex {len(points)}\n"
        # The format allows further elements behind the vertices.
        head += properties + "element face 0\nproperty list uchar int vertex_index\nend_header\n"
        if form == "ascii":
            rows = (" ".join(repr(v.item()) for v in p) for p in points)
            data = "\n".join(rows).encode() + b"\n"
        else:
            order = ">" if "big" in form else "<"
            data = points.astype([(n, order + t) for n, t in FIELDS.items()]).tobytes()
        path.with_suffix(".ply").write_bytes(head.encode() + data)

    return write


def las(suffix: str) -> Callable[[Path, Scan], None]:
    def write(path: Path, scan: Scan) -> None:
        header = laspy.LasHeader(point_format=1, version="1.2")
        header.scales = np.full(3, LAS_STEP_M)
        header.add_extra_dim(laspy.ExtraBytesParams(name="ring", type=np.uint16))
        cloud = laspy.LasData(header)
        cloud.x, cloud.y, cloud.z = scan.xyz.astype(np.float64).T
        cloud.gps_time = 1e-9 * scan.time_ns
        cloud.ring = scan.ring
        cloud.write(path.with_suffix(suffix))

    return write


EXACT = {
    "pcd-ascii": pcd_ascii,
    "pcd-binary": pcd(Encoding.BINARY),
    "pcd-compressed": pcd(Encoding.BINARY_COMPRESSED),
    "ply-ascii": ply("ascii"),
    "ply-little": ply("binary_little_endian"),
    "ply-big": ply("binary_big_endian"),
}


@pytest.fixture(scope="module")
def scans(build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> list[Scan]:
    return variants.decoded(build, capture.pcap, tmp_path_factory.mktemp("decoded"))


def name_s(scan: Scan) -> str:
    return f"{scan.stamp_ns // 10**9}.{scan.stamp_ns % 10**9:09d}.x"


def written(
    folder: Path,
    scans: list[Scan],
    write: Callable[[Path, Scan], None] = EXACT["pcd-binary"],
    name: Callable[[Scan], str] = name_s,
) -> Path:
    folder.mkdir()
    for scan in scans:
        write(folder / name(scan), scan)
    return folder


def read(path: Path, timing: Timing | None = None) -> list[Sweep]:
    timing = timing or Timing()
    with folders.opened(path, timing.period_s) as folder:
        return list(Sweeper(timing).sweeps(folder.messages(folder.choose(""))))


@pytest.mark.parametrize("form", EXACT)
def test_points_are_the_same(scans: list[Scan], tmp_path: Path, form: str) -> None:
    folder = written(tmp_path / "clouds", scans[:3], EXACT[form])
    assert_same(read(folder), scans[:3])


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_to_its_own_step(scans: list[Scan], tmp_path: Path, suffix: str) -> None:
    (sweep, _) = read(written(tmp_path / "clouds", scans[1:3], las(suffix)))
    order = np.lexsort((sweep.points["time_ns"], sweep.points["ring"]))
    same = np.lexsort((scans[1].time_ns, scans[1].ring))
    found = np.stack([sweep.points[axis][order] for axis in "xyz"], axis=-1)
    assert np.abs(found - scans[1].xyz[same]).max() < 0.51 * LAS_STEP_M
    assert np.array_equal(sweep.points["ring"][order], scans[1].ring[same])


@pytest.mark.parametrize(
    ("unit_ns", "within_ns"), [(1, 0), (10**3, 10**3), (10**6, 10**6)], ids=["ns", "us", "ms"]
)
def test_names_are_times(scans: list[Scan], tmp_path: Path, unit_ns: int, within_ns: int) -> None:
    folder = tmp_path / "clouds"
    written(folder, scans[:3], name=lambda s: f"cloud_{s.stamp_ns // unit_ns}")
    assert_same(read(folder), scans[:3], within_ns)


def test_times_stand_in_a_file(scans: list[Scan], tmp_path: Path) -> None:
    """More than ten files, so that their numerical order differs from the alphabetical one."""
    numbers = {id(scan): i for i, scan in enumerate(scans[:11])}
    folder = written(tmp_path / "clouds", scans[:11], name=lambda s: str(numbers[id(s)]))
    times = "\n".join(f"{s.stamp_ns // 10**9}.{s.stamp_ns % 10**9:09d}" for s in scans[:11])
    (tmp_path / "times.txt").write_text(times)
    assert_same(read(folder), scans[:11])
    (tmp_path / "times.txt").write_text(times.rsplit("\n", 1)[0])
    with pytest.raises(Refused, match=r"times\.txt has 10 times for 11 clouds"):
        read(folder)


@pytest.mark.parametrize(("kept", "steps"), [([0, 1, 2], [1, 1]), ([0, 1, 2, 4], [1, 1, 2])])
def test_without_stamps_a_missing_file_is_a_gap(
    scans: list[Scan], tmp_path: Path, kept: list[int], steps: list[int]
) -> None:
    numbers = {id(scans[i]): i for i in kept}
    some = [scans[i] for i in kept]
    folder = written(tmp_path / "clouds", some, name=lambda s: f"{numbers[id(s)]:06d}")
    sweeps = read(folder, Timing(model="deskewed", period_s=0.2))
    assert np.diff([s.stamp_ns for s in sweeps]).tolist() == [200_000_000 * s for s in steps]
    assert any("scan_period_s" in line for line in stream.described(folder, "", Timing("deskewed")))


def test_damaged_files_are_left_out_and_named(scans: list[Scan], tmp_path: Path) -> None:
    folder = written(tmp_path / "clouds", scans[:4])
    damaged = sorted(folder.iterdir())[1]
    damaged.write_bytes(damaged.read_bytes()[:-7])
    (folder / "._x.pcd").write_bytes(b"of a Mac")
    with folders.opened(folder, 0.1) as there:
        sweeps = list(Sweeper(Timing()).sweeps(there.messages(there.choose(""))))
        (remark,) = there.remarks()
    assert damaged.name in remark
    assert_same(sweeps, [scans[0], *scans[2:4]])
    for each in folder.iterdir():
        each.write_bytes(b"ply\n")
    with pytest.raises(Refused, match="none of its files"):
        read(folder)


def test_a_map_is_no_sweep(scans: list[Scan], tmp_path: Path) -> None:
    far = Scan(
        scans[0].stamp_ns,
        scans[0].xyz + np.float32(450_000),
        scans[0].intensity,
        scans[0].ring,
        scans[0].time_ns,
    )
    with pytest.raises(Refused, match="coordinates of a map"):
        read(written(tmp_path / "clouds", [far]))


def test_the_trajectory_is_that_of_the_capture(
    build: Path, capture: Capture, scans: list[Scan], tmp_path: Path
) -> None:
    direct, out = tmp_path / "direct", tmp_path / "out"
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, "--out", direct)
    assert done.code == 0, done.said
    folder = written(tmp_path / "clouds", scans)
    shutil.copy(next(folder.glob("*.pcd")), tmp_path)  # a file beside the folder, to be ignored
    done = monitor("demo", "--preset-dir", build, "--bag", folder, "--out", out)
    assert done.code == 0, done.said
    found, truth = (trajectory.read(each / "trajectory.tum") for each in (out, direct))
    assert len(found) == len(truth)
    off = found.transforms[:, :3, 3] - truth.transforms[:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < 1e-3
    done = monitor("demo", "--preset-dir", build, "--scans", folder, "--out", out)
    assert done.code == 3
    assert "BAG=" in done.said
