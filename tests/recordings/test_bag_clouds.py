"""Bags in each of the layouts that drivers and recorders write are read back."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import Capture
from tests.recordings import variants
from tests.recordings.variants import CONTAINERS, PLAIN, READABLE, REFUSED, Container, Layout, Scan
from zloam_monitor.recordings import Refused, bags, stream
from zloam_monitor.recordings.sweeps import Sweep, Sweeper, Timing

NO_MODEL = Timing()


@pytest.fixture(scope="module")
def scans(build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> list[Scan]:
    return variants.decoded(build, capture.pcap, tmp_path_factory.mktemp("decoded"))[:14]


def read(path: Path, timing: Timing = NO_MODEL, topic: str = "") -> list[Sweep]:
    with bags.opened(path) as bag:
        return list(Sweeper(timing).sweeps(bag.messages(bag.choose(topic))))


def assert_same(sweeps: Iterable[Sweep], scans: list[Scan], within_ns: int = 0) -> None:
    sweeps = list(sweeps)
    assert len(sweeps) == len(scans)
    for sweep, scan in zip(sweeps, scans, strict=True):
        points = sweep.points
        assert len(points) == len(scan.xyz)
        # Ordered by laser and time: points of the same instant may be swapped.
        order = np.lexsort((points["time_ns"], points["ring"]))
        same = np.lexsort((scan.time_ns, scan.ring))
        points, xyz = points[order], scan.xyz[same]
        for axis, name in enumerate("xyz"):
            np.testing.assert_array_equal(points[name], xyz[:, axis])
        np.testing.assert_array_equal(points["ring"], scan.ring[same])
        np.testing.assert_array_equal(points["intensity"], scan.intensity[same])
        instants_ns = points["time_ns"].astype(np.int64) + sweep.stamp_ns
        assert abs(instants_ns - (scan.time_ns[same] + scan.stamp_ns)).max() <= within_ns


@pytest.mark.parametrize("name", READABLE)
def test_what_follows_from_the_data_is_settled(
    scans: list[Scan], tmp_path: Path, name: str
) -> None:
    layout, within_ns = READABLE[name]
    path = variants.write(tmp_path / "bag", scans, layout)
    if layout.origin == "start":  # the sensor's clock is fitted to the headers' stamps
        within_ns += 1000
    assert_same(read(path), scans, within_ns)


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_is_refused_with_what_settles_it(
    scans: list[Scan], tmp_path: Path, name: str
) -> None:
    layout, words = REFUSED[name]
    path = variants.write(tmp_path / "bag", scans, layout)
    with pytest.raises(Refused) as refused:
        read(path)
    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize("container", CONTAINERS, ids=lambda c: c.name)
def test_every_kind_of_file(scans: list[Scan], tmp_path: Path, container: Container) -> None:
    name = "bag.bag" if container.version == 1 else "bag"
    path = variants.write(tmp_path / name, scans[:4], PLAIN, container)
    assert bags.is_recording(path)
    assert_same(read(path), scans[:4])


@pytest.mark.parametrize("suffix", ["mcap", "db3"])
def test_a_single_file_without_its_folder(scans: list[Scan], tmp_path: Path, suffix: str) -> None:
    container = next(c for c in CONTAINERS if c.name == {"mcap": "mcap", "db3": "sqlite3"}[suffix])
    folder = variants.write(tmp_path / "bag", scans[:4], PLAIN, container)
    (single,) = folder.glob(f"*.{suffix}")
    alone = single.rename(tmp_path / f"drive.{suffix}")
    assert_same(read(alone), scans[:4])


def test_the_time_model_stands_for_times(scans: list[Scan], tmp_path: Path) -> None:
    """A VLP-16 rotates clockwise, and sweeps are cut in front: times by azimuth agree to a
    hundredth of a revolution."""
    path = variants.write(tmp_path / "bag", scans, Layout(time=("", "")))
    sweeps = read(path, Timing("clockwise", seam_deg=0.0))
    for sweep, scan in list(zip(sweeps, scans, strict=True))[1:-1]:
        order = np.argsort(scan.time_ns, kind="stable")
        azimuth = np.degrees(np.arctan2(scan.xyz[order, 1], scan.xyz[order, 0])) % 360.0
        inside = (azimuth > 5.0) & (azimuth < 355.0)
        instants = {
            tuple(p): t
            for p, t in zip(
                scan.xyz[order][inside].tolist(), scan.time_ns[order][inside], strict=True
            )
        }
        points = sweep.points
        found = np.stack([points["x"], points["y"], points["z"]], axis=-1).tolist()
        off = [
            t - instants[tuple(p)]
            for p, t in zip(found, points["time_ns"], strict=True)
            if tuple(p) in instants
        ]
        assert np.ptp(off) < 0.02 * variants.PERIOD_NS


def test_deskewed_clouds_hold_for_one_instant(scans: list[Scan], tmp_path: Path) -> None:
    path = variants.write(tmp_path / "bag", scans, Layout(time=("", "")))
    for sweep, scan in zip(read(path, Timing("deskewed")), scans, strict=True):
        assert sweep.deskewed
        assert sweep.stamp_ns == scan.stamp_ns
        assert not sweep.points["time_ns"].any()


def test_left_out_clouds_do_not_stretch_a_turn(scans: list[Scan], tmp_path: Path) -> None:
    path = variants.write(tmp_path / "bag", scans[1::3], PLAIN)
    sweeps = read(path)
    assert len(sweeps) == len(scans[1::3])
    for sweep in sweeps:
        assert abs(sweep.period_ns - variants.PERIOD_NS) < 0.02 * variants.PERIOD_NS


def test_a_part_of_the_view(scans: list[Scan], tmp_path: Path) -> None:
    """A quarter of a revolution takes a quarter of its time."""

    def ahead(scan: Scan) -> Scan:
        kept = scan.xyz[:, 0] > abs(scan.xyz[:, 1])
        return Scan(
            scan.stamp_ns, scan.xyz[kept], scan.intensity[kept], scan.ring[kept], scan.time_ns[kept]
        )

    quarter = [ahead(scan) for scan in scans]
    path = variants.write(tmp_path / "bag", quarter, Layout(time=("time", "f4"), unit_ns=1e9))
    assert_same(read(path), quarter, 20)


def test_of_several_topics_one_must_be_named(scans: list[Scan], tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with variants.Recorder(CONTAINERS[3], path) as bag:
        for scan in scans[:3]:
            bag.put_cloud("/front/points", scan, PLAIN)
            bag.put_cloud("/rear/points", scan, PLAIN)
    with pytest.raises(Refused, match=r"driver\.topic=/front/points"):
        read(path)
    assert_same(read(path, topic="/rear/points"), scans[:3])
    with pytest.raises(Refused, match="/nowhere"):
        read(path, topic="/nowhere")


#: how drivers of sensors without rings lay out their points
WITHOUT_RINGS = {
    "another frame": PLAIN,
    "livox: line, timestamp in double ns": Layout(
        time=("timestamp", "f8"), origin="epoch", ring=("line", "u1"), ring_of=lambda r: r % 4
    ),
    "no ring, float s": Layout(time=("time", "f4"), unit_ns=1e9, ring=("", "")),
}


@pytest.mark.parametrize("name", WITHOUT_RINGS)
def test_points_on_no_cones_have_no_rings(scans: list[Scan], tmp_path: Path, name: str) -> None:
    """With the sensor on its side, each laser's elevations span the whole range, so no rings are
    found."""
    turned = [
        Scan(s.stamp_ns, s.xyz[:, [2, 0, 1]], s.intensity, s.ring, s.time_ns) for s in scans[1:5]
    ]
    path = variants.write(tmp_path / "bag", turned, WITHOUT_RINGS[name])
    sweeps = read(path)
    assert len(sweeps) == len(turned)
    for sweep, scan in zip(sweeps, turned, strict=True):
        points = sweep.points
        assert (sweep.rings, len(points)) == (0, len(scan.xyz))
        assert not points["ring"].any()
        instants_ns = points["time_ns"].astype(np.int64) + sweep.stamp_ns
        # A double in ns since the epoch has steps of 256 ns.
        assert abs(instants_ns - (scan.time_ns + scan.stamp_ns)).max() <= 256
        assert abs(sweep.period_ns - variants.PERIOD_NS) < 2_000_000


@pytest.mark.parametrize("container", [CONTAINERS[0], CONTAINERS[3], CONTAINERS[6]])
def test_livox_messages(scans: list[Scan], tmp_path: Path, container: Container) -> None:
    turned = [
        Scan(s.stamp_ns, s.xyz[:, [2, 0, 1]], s.intensity, s.ring, s.time_ns) for s in scans[1:4]
    ]
    path = tmp_path / ("bag.bag" if container.version == 1 else "bag")
    with variants.Recorder(container, path) as bag:
        for scan in turned:
            bag.put_livox("/livox/lidar", scan)
    for sweep, scan in zip(read(path), turned, strict=True):
        points = sweep.points
        order = np.argsort(scan.time_ns, kind="stable")
        assert (sweep.rings, sweep.stamp_ns) == (0, scan.stamp_ns + scan.time_ns.min())
        np.testing.assert_array_equal(points["x"], scan.xyz[order, 0])
        np.testing.assert_array_equal(points["time_ns"], scan.time_ns[order] - scan.time_ns.min())
        np.testing.assert_array_equal(points["intensity"], np.floor(scan.intensity[order]))


def test_times_of_points_without_rings_that_fit_no_unit_are_refused(
    scans: list[Scan], tmp_path: Path
) -> None:
    turned = [
        Scan(s.stamp_ns, s.xyz[:, [2, 0, 1]], s.intensity, s.ring, s.time_ns) for s in scans[1:5]
    ]
    layout = Layout(time=("time", "f4"), unit_ns=3e4, ring=("", ""))
    with pytest.raises(Refused, match="no unit"):
        read(variants.write(tmp_path / "bag", turned, layout))
    with pytest.raises(Refused, match="single cloud"):
        read(variants.write(tmp_path / "single", turned[:1], WITHOUT_RINGS["no ring, float s"]))


def test_a_bag_that_was_cut_off(scans: list[Scan], tmp_path: Path) -> None:
    """The part before the cut is used, or the library's error is passed on; never a traceback."""
    folder = variants.write(tmp_path / "bag", scans, PLAIN, CONTAINERS[6])
    (single,) = folder.glob("*.mcap")
    data = single.read_bytes()
    for share in (0.0, 0.3, 0.6, 0.99):
        cut = tmp_path / f"cut{share}.mcap"
        cut.write_bytes(data[: max(64, int(share * len(data)))])
        out = io.BytesIO()
        code = stream.write(cut, "", Timing(), out)
        kinds = []
        out.seek(0)
        while head := out.read(16):
            _, kind, size = struct.unpack("<4sIQ", head)
            kinds.append((kind, out.read(size)))
        last, said = kinds[-1]
        assert last == (stream.END if code == 0 else stream.REFUSAL)
        assert code == 0 or said
        if code == 0:
            assert any(kind == stream.REMARK for kind, _ in kinds)


@pytest.mark.parametrize("container", [CONTAINERS[0], CONTAINERS[3], CONTAINERS[6]])
def test_ouster_packets_come_as_they_were(tmp_path: Path, container: Container) -> None:
    sent = [(1_700_000_000_000_000_000 + 1000 * i, bytes([i]) * (48 + 100 * i)) for i in range(5)]
    path = tmp_path / ("bag.bag" if container.version == 1 else "bag")
    with variants.Recorder(container, path) as bag:
        bag.put_ouster("/ouster/lidar_packets", sent)
        bag.put_ouster("/ouster/imu_packets", sent[:1])
    out = io.BytesIO()
    assert stream.write(path, "/ouster/lidar_packets", Timing(), out) == 0
    out.seek(0)
    came = []
    while head := out.read(stream.HEAD.size):
        _, kind, size = stream.HEAD.unpack(head)
        data = out.read(size)
        if kind == stream.PACKETS:
            stamp_ns, length, *_ = stream.PACKET_HEAD.unpack_from(data)
            came.append((stamp_ns, data[stream.PACKET_HEAD.size :]))
            assert length == len(came[-1][1])
    assert came == sent
    with pytest.raises(Refused, match="several topics"):
        read(path)
