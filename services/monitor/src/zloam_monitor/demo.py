"""`demo`: replays one recording through the five stages; writes files, a table and the error."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from zloam_monitor import (
    beside_run,
    config_check,
    outputs,
    references,
    remarks,
    report,
    run_recording,
)
from zloam_monitor.chain import Chain, ChainError, binary
from zloam_monitor.claims import Claim
from zloam_monitor.failures import Misuse
from zloam_monitor.ports import Ports
from zloam_monitor.remarks import Logs, Remarks
from zloam_monitor.report import Run
from zloam_monitor.sources import Source, SourceError
from zloam_monitor.stages import STAGES
from zloam_monitor.terminal import ProgressLine
from zloam_monitor.watch import rate_text

#: Interval at which received messages are read. In a fast replay, waking up for each message took
#: a sixth of a core from the stages; this takes a tenth.
LOOK_SECONDS = 0.1
#: Limit on a time without progress, at full pace. Longer than the stages' own limit
#: (recovery.replay_limit_s), whose message names sweep and stage.
STALL_SECONDS = 150.0


@dataclass(frozen=True)
class DemoOptions:
    """Options of a demo."""

    build: Path
    out: Path
    source: Source
    config: Path
    robot: str
    sensor: str = "lidar"
    rate: str = "max"
    settings: list[str] = field(default_factory=list)
    truth: list[Path] = field(default_factory=list)
    picture: bool = True
    #: SWEEP:KEY=VALUE: changes that take effect at a sweep.
    set_at: list[str] = field(default_factory=list)
    #: None: any free ports.
    ports: Ports | None = None
    #: stage -> program that replaces its own.
    programs: dict[str, str] = field(default_factory=dict)
    #: MCAP file for all published messages.
    record: Path | None = None
    #: Show the run on a page, and record it for Rerun.
    view: bool = False
    #: Optional stages beside the chain.
    beside: tuple[str, ...] = ()


def _line(chain: Chain, source: Source, now: float) -> str:
    link = chain.link
    newest = link.poses.last()
    if newest is None:
        return "no pose yet"
    drops = sum(
        count
        for status in link.statuses.values()
        for each in status.inputs
        for reason, count in each.dropped.items()
        if reason != "duplicate"
    )
    whole = f" of {source.sweeps}" if source.sweeps else ""
    return f"sweep {newest.sweep + 1}{whole}, {rate_text(link, now)}{drops} dropped"


def _patience_s(configs: Mapping[str, Mapping[str, Any]]) -> float:
    """Limit on a time without progress: none at a pace, at which the driver waits through the
    recording's own pauses."""
    rate = configs.get("driver", {}).get("driver.rate", "max")
    return STALL_SECONDS if rate == "max" else math.inf


def _follow(
    chain: Chain,
    source: Source,
    line: ProgressLine,
    noted: Remarks,
    logs: Logs,
    patience_s: float,
) -> float:
    """Waits for the end of the run; returns the wall time in seconds."""
    began = time.monotonic()
    moved, seen = began, chain.progress()
    while not chain.finished():
        time.sleep(LOOK_SECONDS)
        chain.link.poll()
        chain.check()
        now, progress = time.monotonic(), chain.progress()
        if progress != seen:
            moved, seen = now, progress
        if now - moved > patience_s:
            raise ChainError(_stalled(chain, patience_s))
        said = [*remarks.reasons(chain.link.statuses.values()), *logs.new_warnings()]
        for news in noted.news(said, now):
            line.end()
            print(news, flush=True)
        line.show(_line(chain, source, now))
    return time.monotonic() - began


def _stalled(chain: Chain, patience_s: float) -> str:
    said = [
        f"  {s.stage}: {s.health}{', ' + s.reason if s.reason else ''}, last sweep {s.last_sweep}"
        for s in chain.link.statuses.values()
    ]
    return f"nothing moved for {patience_s:.0f} s:\n" + "\n".join(said)


def run(options: DemoOptions) -> dict[str, Any]:
    """Runs the demo and returns the report; raises if something goes wrong."""
    source = options.source
    inputs = [*source.there(options.truth), *source.files, options.config]
    for path in inputs:
        # The driver would refuse it only after all stages have started.
        if not path.exists():
            raise SourceError(f"{path}: No such file or directory")
    if source.simulation:
        _check(options)
    with outputs.claim(options.out, inputs, [path.name for path in source.made]) as claim:
        source.make()
        return outputs.write_all(options.out, options.source.title, _heard(options, claim))


def _check(options: DemoOptions) -> None:
    """Lets the stages refuse a setting before the minute that a simulation may take. A recording is
    there, and the stages check at once."""
    stages = (*STAGES, *options.beside)
    programs = {each: binary(options.build, options.programs.get(each, each)) for each in stages}
    settings = [*options.source.driver_settings(options.rate), *options.settings]
    if said := config_check.refusals(programs, options.config, settings, options.set_at):
        raise Misuse("\n".join(said))


def _heard(options: DemoOptions, claim: Claim) -> Run:
    """Runs all stages, and returns what was received from them until the end of the recording."""
    files = outputs.Files(options.out)
    settings = [
        *outputs.stage_settings(options.out),
        *options.source.driver_settings(options.rate),
        *options.settings,
    ]
    line, noted, logs = ProgressLine(), Remarks(), Logs(files.logs)
    chain = Chain(
        options.build,
        options.config,
        options.robot,
        settings,
        files.logs,
        options.sensor,
        options.set_at,
        options.ports,
        options.programs,
        options.beside,
        replay=True,
    )
    # The chain opens its session when it is constructed, so it must be closed even if not entered.
    with closing(chain), run_recording.beside(chain.link, options.record) as recording, chain:
        chain.wait_ready()
        if recording:
            recording.begin()
        claim.begin()
        print(chain.ports.announcement(options.robot), flush=True)
        configs = chain.link.query_configs()
        with beside_run.shown(chain.ports.endpoint, options.out, options.view) as unseen:
            try:
                patience_s = _patience_s(configs)
                wall_s = _follow(chain, options.source, line, noted, logs, patience_s)
            finally:
                line.end()
        chain.link.query_statuses()
        chain.link.query_revisions()
        if recording:
            recording.catch_up()
        codes = chain.stop()
        lacks = [*unseen, *(recording.end() if recording else [])]
        truths, no_reference = references.of_base(options.truth, configs)
        noted.news([*remarks.reasons(chain.statuses().values()), *logs.new_warnings()], 0.0)
        seen = Run.heard(chain.link, wall_s, codes, truths, chain.pss_mib)
        return replace(seen, remarks=noted.summary(), not_recorded=lacks, no_reference=no_reference)


def finish(found: dict[str, Any], out: Path) -> int:
    """Prints the table; returns 0 only if everything is accounted for."""
    print(report.table(found))
    print(f"files: {out}/")
    return report.exit_code(found)
