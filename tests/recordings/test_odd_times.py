"""Times that clouds have now and then: of clocks that start again or are set, of clouds without
returns, and times that are none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.lib import recfunctions
from numpy.typing import NDArray

from tests.recordings import made
from tests.recordings.made import AUTO, streamed, texts
from tests.recordings.test_folders import EXACT
from tests.recordings.variants import CONTAINERS, PERIOD_NS, Layout, Recorder, Scan
from zloam_monitor.recordings import Refused, stream
from zloam_monitor.recordings.folders import Table
from zloam_monitor.recordings.sweeps import Sweep, Sweeper, Timing

COUNT, ODD = 20, 15
HOUR_US = 3600 * 10**6
STEPS_NS = [PERIOD_NS] * (COUNT - 1)


def read(
    points: Sequence[NDArray[Any]], stamps_ns: Sequence[int], timing: Timing = AUTO
) -> tuple[list[Sweep], list[str]]:
    sweeper = Sweeper(timing)
    clouds = [
        Table(stamp_ns, each, len(each), 1)
        for stamp_ns, each in zip(stamps_ns, points, strict=True)
    ]
    return list(sweeper.sweeps(clouds)), sweeper.remarks()


def steps_ns(sweeps: Sequence[Sweep]) -> list[int]:
    return [int(each) for each in np.diff([sweep.stamp_ns for sweep in sweeps])]


def counted(scan: Scan, values: NDArray[np.int64], length: int) -> NDArray[Any]:
    """Points with a counter of 32 bits instead of times."""
    points = recfunctions.drop_fields(made.table(scan), "time", usemask=False)
    counts = (values % length).astype(np.uint32)
    return np.asarray(recfunctions.append_fields(points, "t", counts, usemask=False))


@pytest.mark.parametrize(("unit_ns", "length"), [(1000, HOUR_US), (1000, 2**32), (1, 2**32)])
@pytest.mark.parametrize("into_sweep", [0.0, 0.37])
def test_a_counter_that_starts_again_runs_on(unit_ns: int, length: int, into_sweep: float) -> None:
    scans = made.scans(COUNT)
    begin = length - round((ODD + into_sweep) * PERIOD_NS) // unit_ns
    points = [
        counted(scan, begin + (scan.stamp_ns - made.BEGIN_NS + scan.time_ns) // unit_ns, length)
        for scan in scans
    ]
    sweeps, remarks = read(points, [scan.stamp_ns for scan in scans])
    assert not remarks
    assert steps_ns(sweeps) == STEPS_NS
    for sweep, scan in zip(sweeps, scans, strict=True):
        off_ns = np.abs(np.sort(scan.time_ns) - sweep.points["time_ns"].astype(np.int64))
        assert off_ns.max() < unit_ns


@pytest.mark.parametrize("epoch_ns", [0, 37 * 10**9], ids=["of the headers", "TAI"])
def test_an_empty_cloud_is_where_it_would_have_points(epoch_ns: int) -> None:
    """The headers are those of the ends: the points' times are before them, or of an own clock."""
    scans = made.scans(COUNT)
    points = [made.table(scan) for scan in scans]
    for each in points:
        each["time"] -= 0.1
    if epoch_ns:
        points = [
            np.asarray(
                recfunctions.append_fields(
                    recfunctions.drop_fields(each, "time", usemask=False),
                    "timestamp",
                    1e-9 * (scan.stamp_ns + epoch_ns + scan.time_ns),
                    usemask=False,
                )
            )
            for scan, each in zip(scans, points, strict=True)
        ]
    points[ODD] = points[ODD][:0]
    sweeps, remarks = read(points, [scan.stamp_ns + PERIOD_NS for scan in scans])
    assert not remarks
    assert len(sweeps[ODD].points) == 0
    # A double in s since 1970 has steps of 240 ns, a float of 0.1 s of 7 ns.
    np.testing.assert_allclose(steps_ns(sweeps), STEPS_NS, rtol=0, atol=500)


def test_a_clock_that_is_set_back_is_refused() -> None:
    scans = made.scans(COUNT)
    stamps_ns = [s.stamp_ns - (10**10 if n >= ODD else 0) for n, s in enumerate(scans)]
    with pytest.raises(Refused, match=r"cloud 15, counted from 0: its time is 9\.900 s before"):
        read([made.table(scan) for scan in scans], stamps_ns)


@pytest.mark.parametrize("odd", [0, 3, ODD])
@pytest.mark.parametrize("late", [0, 2], ids=["twice", "late"])
def test_a_cloud_that_comes_twice_or_late_counts_once(odd: int, late: int) -> None:
    scans = made.scans(COUNT)
    sent = [*scans[: odd + late + 1], *scans[odd : odd + 1], *scans[odd + late + 1 :]]
    sweeps, remarks = read([made.table(s) for s in sent], [s.stamp_ns for s in sent])
    assert steps_ns(sweeps) == STEPS_NS
    assert remarks == ["1 clouds left out, as they came twice or late by their times"]


@pytest.mark.parametrize("count", [2, 3, COUNT])
def test_stamps_that_stand_still_are_refused(count: int) -> None:
    points = [made.table(scan) for scan in made.scans(count)]
    with pytest.raises(Refused, match="do not ascend"):
        read(points, [made.BEGIN_NS] * count)


@pytest.mark.parametrize("odd", [3, ODD])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_point_without_a_time_is_left_out(odd: int, value: float) -> None:
    scans = made.scans(COUNT)
    points = [made.table(scan) for scan in scans]
    points[odd]["time"][7] = value
    sweeps, (remark,) = read(points, [scan.stamp_ns for scan in scans])
    assert remark == "1 returns left out, as their times (field time) are not finite"
    assert steps_ns(sweeps) == STEPS_NS
    assert [len(s.points) for s in sweeps] == [made.POINTS - (n == odd) for n in range(COUNT)]


def test_clouds_without_any_time_are_refused() -> None:
    scans = made.scans(COUNT)
    points = [made.table(scan) for scan in scans]
    for each in points:
        each["time"] = np.nan
    with pytest.raises(Refused, match="field time: no time"):
        read(points, [scan.stamp_ns for scan in scans])


def test_files_without_a_field_of_the_first_one_are_refused() -> None:
    scans = made.scans(COUNT)
    points = [made.table(scan) for scan in scans]
    points[ODD] = np.asarray(recfunctions.drop_fields(points[ODD], "intensity", usemask=False))
    with pytest.raises(Refused, match="a file without the field intensity"):
        read(points, [scan.stamp_ns for scan in scans])


@pytest.mark.parametrize(
    ("field", "less"), [("ring", Layout(ring=("", ""))), ("t", Layout(time=("", "")))]
)
def test_a_topic_whose_fields_change_is_refused_by_name(
    tmp_path: Path, field: str, less: Layout
) -> None:
    with Recorder(CONTAINERS[3], tmp_path / "bag") as bag:
        for number, scan in enumerate(made.scans(COUNT)):
            bag.put_cloud("/points", scan, Layout() if number < ODD else less)
    said = texts(streamed(tmp_path / "bag"), stream.REFUSAL)
    assert said == f"a cloud without the field {field} of the first one"


def test_sweeps_that_are_too_long_are_refused(tmp_path: Path) -> None:
    stamped, numbered = tmp_path / "stamped", tmp_path / "numbered"
    for folder, names in ((stamped, (0, 5, 10)), (numbered, (0, 1, 2))):
        folder.mkdir()
        for name, scan in zip(names, made.scans(3), strict=True):
            seconds = 1_600_000_000 if folder is stamped else 0
            EXACT["pcd-binary"](folder / str(seconds + name), scan)
    for folder, timing in (
        (stamped, Timing("deskewed")),
        (numbered, Timing("deskewed", period_s=5.0)),
    ):
        assert "a cloud every 5 s" in texts(streamed(folder, timing), stream.REFUSAL)
    # With times of the points, a gap between the clouds does not matter.
    assert len(streamed(stamped)[stream.SWEEP]) == 3


def test_clouds_of_a_sensor_that_starts_up_are_left_out() -> None:
    scans = made.scans(45)
    points = [made.table(scan)[: 0 if n < 25 else None] for n, scan in enumerate(scans)]
    stamps_ns = [scan.stamp_ns for scan in scans]
    sweeps, remarks = read(points, stamps_ns)
    assert remarks == ["the first 20 clouds left out, as they have no return"]
    assert [sweep.stamp_ns for sweep in sweeps] == stamps_ns[20:]
    assert [len(sweep.points) for sweep in sweeps] == [0] * 5 + [made.POINTS] * 20
    with pytest.raises(Refused, match="there is no return in its clouds"):
        read(points[:25], stamps_ns[:25])
