"""`follow`: one run of stages that somebody else started (containers, other machines)."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zloam_monitor import outputs, report
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.report import Run
from zloam_monitor.terminal import ProgressLine

#: whose word is waited for before the source may start
CONSUMERS = ("registration", "odometry", "mapping", "integration")
SINKS = ("mapping", "integration")
#: files of a run are written at its end; they and the last statuses need a moment
SETTLE_SECONDS = 2.0


@dataclass(frozen=True)
class FollowOptions:
    """What is followed, and where the report goes."""

    keys: Keys
    connect: list[str]
    out: Path
    title: str
    truth: list[Path] = field(default_factory=list)
    #: is touched as soon as all consumers were heard
    ready_file: Path | None = None


def _say_ready(link: Link, ready_file: Path | None) -> None:
    if ready_file is None or ready_file.exists():
        return
    if all(link.stage(stage) is not None for stage in CONSUMERS):
        ready_file.touch()


def _finished(link: Link) -> bool:
    found = [link.stage(stage) for stage in SINKS]
    return all(s is not None and s.end_of_run for s in found) and bool(link.poses)


def _wait(link: Link, options: FollowOptions, line: ProgressLine) -> float:
    """Until the run's end; wall seconds since its first pose."""
    began: float | None = None
    while not _finished(link):
        link.poll(0.2)
        _say_ready(link, options.ready_file)
        if link.poses:
            began = began or time.monotonic()
            line.show(f"sweep {max(link.poses) + 1}, {len(link.poses)} poses")
    return time.monotonic() - (began or time.monotonic())


def follow(options: FollowOptions) -> dict[str, Any]:
    """Waits for a run and its end; writes report and picture; returns the report."""
    claim = outputs.claim_own(options.out, options.truth)
    line = ProgressLine()
    session = open_session(options.connect)
    link = Link(session, options.keys)
    try:
        wall_s = _wait(link, options, line)
        line.end()
        settled = time.monotonic() + SETTLE_SECONDS
        while time.monotonic() < settled:
            link.poll(0.2)
        link.query_statuses()
        link.query_revisions()
        link.poll()
        configs = link.query_configs()
        known = [path for path in options.truth if path.exists()]
        truths = outputs.truths_of_base(known, outputs.mounting(configs))
        seen = Run.heard(link, wall_s, truths=truths)
    finally:
        link.close()
        session.close()
    try:
        found = outputs.write_all(options.out, options.title, seen, stages_write_here=False)
    finally:
        claim.record()
    print(report.table(found))
    return found
