"""`follow`: accompanies one run of stages that were started elsewhere (containers, machines)."""

from __future__ import annotations

import fcntl
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from zloam_monitor import outputs, references, report
from zloam_monitor.chain import ChainError
from zloam_monitor.claims import Claim
from zloam_monitor.files import written_whole
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.report import Run
from zloam_monitor.stages import ACK, ROWS, STAGES
from zloam_monitor.terminal import ProgressLine

#: The source may start when all of these stages were heard.
CONSUMERS = tuple(stage for stage in STAGES if ROWS[stage].reads)
SINKS = tuple(stage for stage in STAGES if ACK in ROWS[stage].writes)
#: Stages write their files at the end of a run; the files and the last statuses need a moment.
SETTLE_SECONDS = 2.0
#: Processes that end with the run look for its end once a second, and all end at the same time.
NOTICE_SECONDS = 2.0
#: A stage takes at most 9 s to end.
END_SECONDS = 20.0
#: Suffix of a file beside the end file; each process that ends with the run locks it until then.
RUNNING_SUFFIX = ".running"
#: Last messages of ended processes take a moment to come through Docker.
SAID_SECONDS = 1.0


@dataclass(frozen=True)
class FollowOptions:
    """Which run is followed, and where the report is written."""

    keys: Keys
    connect: list[str]
    out: Path
    title: str
    truth: list[Path] = field(default_factory=list)
    #: Touched as soon as all consumers were heard.
    ready_file: Path | None = None
    #: Written at the end, for processes that end with the run; follow waits for them.
    ended_file: Path | None = None
    #: Limit from all consumers being heard to the first pose; None: no limit.
    patience_s: float | None = None


def _all_heard(link: Link, ready_file: Path | None) -> bool:
    """True if all consumers were heard; touches the ready file if so."""
    if not all(link.stage(stage) is not None for stage in CONSUMERS):
        return False
    if ready_file is not None:
        ready_file.touch()
    return True


def _finished(link: Link) -> bool:
    """The sinks have said the end of the run whose poses came: stages that stay after a run say the
    end of that one until their first status in the next."""
    if not link.poses:
        return False
    found = [link.stage(stage) for stage in SINKS]
    return all(s is not None and s.end_of_run and s.run == link.run for s in found)


def _wait(link: Link, options: FollowOptions, line: ProgressLine, claim: Claim) -> float:
    """Waits for the end of the run, which begins with its first pose; returns the wall time since
    then, s."""
    ready: float | None = None
    began: float | None = None
    while not _finished(link):
        link.poll(0.2)
        if ready is None and _all_heard(link, options.ready_file):
            ready = time.monotonic()
        if newest := link.poses.last():
            if began is None:
                began = time.monotonic()
                # Its stages write here, too: no earlier report may come beside their files.
                claim.begin()
            line.show(f"sweep {newest.sweep + 1}, {len(link.poses)} poses")
        elif ready and options.patience_s and time.monotonic() - ready > options.patience_s:
            raise ChainError(
                f"no pose within {options.patience_s:.0f} s after all stages were ready: "
                "see what the driver says"
            )
    return time.monotonic() - (began or time.monotonic())


def _all_ended(running_file: Path) -> bool:
    """True if no process holds the lock any more (deploy/docker/with-run)."""
    if not running_file.exists():
        return True
    with running_file.open() as held:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def _let_end(ended_file: Path | None, seconds: float = END_SECONDS) -> None:
    """Announces the end of the run and waits until its processes have ended, so that the table is
    printed after their output."""
    if ended_file is None:
        return
    with written_whole(ended_file) as out:
        out.write(f"{math.ceil(time.time() + NOTICE_SECONDS)}\n")
    running_file = ended_file.with_name(ended_file.name + RUNNING_SUFFIX)
    deadline = time.monotonic() + seconds
    while not _all_ended(running_file):
        if time.monotonic() > deadline:
            print(f"not all of the run have ended within {seconds:.0f} s: see who still runs")
            return
        time.sleep(0.1)
    time.sleep(SAID_SECONDS)


@contextmanager
def others_end(ended_file: Path | None) -> Iterator[None]:
    """On an error here the other processes end: they wait for the end file in any case."""
    try:
        yield
    except Exception:
        _let_end(ended_file)
        raise


def follow(options: FollowOptions) -> dict[str, Any]:
    """Waits for a run and its end, writes report and picture, prints the table, and returns the
    report."""
    with others_end(options.ended_file):
        found = _follow(options)
    _let_end(options.ended_file)
    print(report.table(found))
    return found


def _follow(options: FollowOptions) -> dict[str, Any]:
    references.check(options.truth)
    with outputs.claim_own(options.out, options.truth) as claim:
        seen = _heard(options, claim)
        return outputs.write_all(options.out, options.title, seen, stages_write_here=False)


def _heard(options: FollowOptions, claim: Claim) -> Run:
    """What was received from the stages until the end of the run."""
    line = ProgressLine()
    session = open_session(options.connect)
    link = Link(session, options.keys)
    try:
        wall_s = _wait(link, options, line, claim)
        line.end()
        settled = time.monotonic() + SETTLE_SECONDS
        while time.monotonic() < settled:
            link.poll(0.2)
        link.query_statuses()
        link.query_revisions()
        link.poll()
        configs = link.query_configs()
        truths, lacks = references.of_base(options.truth, configs)
        return replace(Run.heard(link, wall_s, truths=truths), no_reference=lacks)
    finally:
        link.close()
        session.close()
