"""Figures of the report use sweeps with ascending stamps; the others are reported."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from zloam_monitor import html_report, outputs, pose_health, report
from zloam_monitor.keys import Keys
from zloam_monitor.records import PoseRecord
from zloam_monitor.report import Run
from zloam_monitor.trajectory import from_records

STEP_NS = 100_000_000


def run_with(instants_ns: list[int]) -> Run:
    """A robot that moves 1 m per sweep; a sweep whose stamp goes back is 1000 m away."""
    latest = -1
    poses = {}
    for sweep, instant in enumerate(instants_ns):
        x = float(sweep) if instant > latest else 1000.0
        latest = max(latest, instant)
        poses[sweep] = PoseRecord(
            run=1,
            sweep=sweep,
            instant_ns=instant,
            translation=np.array([x, 0.0, 0.0]),
            quaternion=np.array([0.0, 0.0, 0.0, 1.0]),
            health=0,
            last_packet_ns=0,
            end_of_run=False,
            trace=(),
        )
    heard = from_records({n: (p.instant_ns, p.translation, p.quaternion) for n, p in poses.items()})
    return Run(Keys("robot", "lidar"), {}, poses, {}, heard, heard, wall_s=1.0)


class Reader(HTMLParser):
    """Text of a page, and the addresses that it loads."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.text = ""
        self.asks: list[str] = []
        self.open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)
        self.asks += [v or "" for name, v in attrs if name in ("src", "href")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Does nothing, as such a tag leaves no element open."""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_says_what_the_report_says(tmp_path: Path) -> None:
    run = run_with([STEP_NS * i for i in range(11)])
    run = replace(run, remarks=["<script>alert(1)</script> & more"], exit_codes={"driver": 0})
    run = replace(run, set_too_late=["900:mapping.stride=2"])
    found = outputs.write_all(tmp_path, "A <b>drive</b>", run)
    read = Reader((tmp_path / "report.html").read_text())
    assert read.open == []
    assert "A <b>drive</b>" in read.text
    assert "<script>alert(1)</script> & more" in read.text
    assert report.summary_line(found) in read.text
    assert pose_health.line(found["health"]) in read.text
    assert "11 of 11 poses ok, 0 degenerate, 0 predicted, 0 lost" in read.text
    assert "900:mapping.stride=2" in read.text
    assert "the run ended before these changes: 900:mapping.stride=2" in report.table(found)
    # The stages' files are missing here.
    assert len(report.complaints(found)) >= 1
    assert all(each in read.text for each in report.complaints(found))
    assert [each[:22] for each in read.asks] == ["data:image/png;base64,"]


def test_a_folder_without_a_run_is_said(tmp_path: Path) -> None:
    with pytest.raises(html_report.NoRun, match=r"no report\.json"):
        html_report.write(tmp_path, "nothing")


def test_ascending_stamps_are_no_complaint() -> None:
    found = report.build(run_with([STEP_NS * i for i in range(11)]))
    assert found["path_m"] == pytest.approx(10.0)
    assert found["realtime_factor"] == pytest.approx(1.1)
    assert found["stamps_went_back"] == []


def test_stamps_that_go_back_are_said_and_left_out() -> None:
    instants = [STEP_NS * i for i in range(11)]
    instants[5] = instants[4]
    instants[7] = -30 * STEP_NS
    found = report.build(run_with(instants))
    assert found["stamps_went_back"] == [5, 7]
    assert found["path_m"] == pytest.approx(10.0)
    assert "2 stamps are not after those before, first of sweep 5" in str(found["identities"])
    assert not report.accounted(found)


def test_the_page_has_the_remarks_of_the_errors(tmp_path: Path) -> None:
    """An error over a part of the drive would else be taken for that of the whole."""
    run = run_with([STEP_NS * i for i in range(11)])
    half = run_with([STEP_NS * i for i in range(6)]).trajectory
    found = outputs.write_all(tmp_path, "drive", replace(run, truths={"half.tum": half}))
    remark = found["references"]["half.tum"]["pose"]["remark"]
    assert remark
    assert remark in report.table(found)
    assert f"pose against half.tum: {remark}" in Reader((tmp_path / "report.html").read_text()).text
