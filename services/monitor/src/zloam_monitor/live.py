"""`run`: the five stages on a live sensor; reports what is missing, writes files at Ctrl-C."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from zloam_monitor import ending, outputs, remarks, run_recording, terminal
from zloam_monitor.chain import Chain
from zloam_monitor.claims import Claim
from zloam_monitor.link import Link
from zloam_monitor.ports import Ports
from zloam_monitor.remarks import Logs, Remarks
from zloam_monitor.report import Run
from zloam_monitor.supervision import Supervisor
from zloam_monitor.terminal import ProgressLine
from zloam_monitor.watch import state_line

#: Time without a sweep after which this is reported.
QUIET_SECONDS = 3.0
#: Advice if no packets come.
NO_PACKETS_HELP = (
    "check that the sensor has power and spins, that its web page names this host as destination, "
    "that the port is the same, and that no firewall drops UDP"
)
NO_SCANNER_HELP = (
    "check that the scanner has power and is connected, that driver.path is its address or device, "
    "and what the driver's log says of its replies"
)
NO_MESSAGES_HELP = "check that a program publishes the sensor's packets there"


@dataclass(frozen=True)
class LiveOptions:
    """Options of a live run."""

    build: Path
    out: Path
    config: Path
    robot: str
    sensor: str = "lidar"
    settings: list[str] = field(default_factory=list)
    #: stage -> program that replaces its own.
    programs: dict[str, str] = field(default_factory=dict)
    #: Duration of the run; None: until Ctrl-C.
    seconds: float | None = None
    #: None: any free ports.
    ports: Ports | None = None
    #: MCAP file for all published messages.
    record: Path | None = None
    #: Start a second instance of each stage, which takes over when the first one dies.
    standby: bool = False
    #: Optional stages beside the chain.
    beside: tuple[str, ...] = ()


def data_place(configs: dict[str, dict[str, Any]]) -> tuple[str, str]:
    """Where the sensor's data come in by the stages' configurations, and what to check there."""
    driver = {k: v for config in configs.values() for k, v in config.items()}
    source = driver.get("driver.source")
    if source == "scip":
        return str(driver.get("driver.path")), NO_SCANNER_HELP
    if source == "zenoh":
        return "the sensor's key packets", NO_MESSAGES_HELP
    return f"UDP {driver.get('driver.port', 2368)}", NO_PACKETS_HELP


class Diagnosis:
    """Finds what is missing from what the link receives, and describes it as texts."""

    def __init__(self, place: str, advice: str) -> None:
        self._place, self._advice = place, advice
        self._sweeps = 0
        self._moved = self._began = time.monotonic()

    def words(self, link: Link, now: float) -> list[str]:
        """Descriptions of what is missing; empty if all is well."""
        driver = link.stage("driver")
        sweeps = driver.published.get(link.keys.sweep, 0) if driver is not None else 0
        if sweeps != self._sweeps:
            self._sweeps, self._moved = sweeps, now
        healths: tuple[str, ...] = remarks.TROUBLED
        if now - self._began > QUIET_SECONDS:
            healths = (*healths, "starting")
        said = remarks.reasons(link.statuses.values(), healths)
        quiet = now - self._moved
        if quiet > QUIET_SECONDS and not any(each.startswith("driver:") for each in said):
            what = "no packets" if self._sweeps == 0 else "no more sweeps"
            said.insert(0, f"{what} on {self._place} for {quiet:.0f} s: {self._advice}")
        return said


class _Interrupt:
    """Notes that a signal asked for the end; the loop then ends after its current step."""

    def __init__(self) -> None:
        self.asked = False

    def ask(self, number: int) -> None:
        self.asked = True


def _watch(
    chain: Chain, options: LiveOptions, interrupt: _Interrupt, noted: Remarks, logs: Logs
) -> float:
    line = ProgressLine()
    supervisor = Supervisor(chain)
    diagnosis = Diagnosis(*data_place(chain.link.query_configs()))
    began = time.monotonic()
    with _until_unheard():
        print("running; Ctrl-C writes trajectory and map and ends")
        while not interrupt.asked:
            chain.link.poll(0.2)
            now = time.monotonic()
            if options.seconds is not None and now - began > options.seconds:
                break
            said = [*diagnosis.words(chain.link, now), *logs.new_warnings()]
            for news in (*supervisor.look(now), *noted.news(said, now)):
                line.end()
                print(news, flush=True)
            line.show(state_line(chain.link, now))
        line.end()
    return time.monotonic() - began


@contextmanager
def _until_unheard() -> Iterator[None]:
    """Ends the block when the reader of the output has ended: then the run ends in order, as with a
    terminal that is closed."""
    try:
        yield
    except BrokenPipeError:
        terminal.silence()
        with suppress(BrokenPipeError):  # The same reader, with 2>&1.
            print("the reader of the output has ended: so does the run", file=sys.stderr)


def run(options: LiveOptions) -> dict[str, Any]:
    """Runs until Ctrl-C and returns the report; raises if a stage dies."""
    with outputs.claim(options.out, [options.config]) as claim:
        return outputs.write_all(options.out, "live run", _heard(options, claim))


def _heard(options: LiveOptions, claim: Claim) -> Run:
    """Starts the stages, and returns what was received from them until Ctrl-C."""
    settings = [*outputs.stage_settings(options.out), *options.settings]
    if options.standby:
        settings.append("recovery.standby=true")
    logs = Logs(outputs.Files(options.out).logs)
    chain = Chain(
        options.build,
        options.config,
        options.robot,
        settings,
        outputs.Files(options.out).logs,
        options.sensor,
        ports=options.ports,
        programs=options.programs,
        beside=options.beside,
    )
    # The chain opens its session when it is constructed, so it must be closed even if not entered.
    with closing(chain), run_recording.beside(chain.link, options.record) as recording, chain:
        chain.wait_ready()
        if options.standby:
            chain.start_standbys()
        if recording:
            recording.begin()
        claim.begin()
        print(chain.ports.announcement(options.robot), flush=True)
        interrupt, noted = _Interrupt(), Remarks()
        with ending.handled(interrupt.ask, ending.TOLD):
            wall_s = _watch(chain, options, interrupt, noted, logs)
            terminal.last_words("writing trajectory and map")
            chain.link.query_statuses()
            chain.link.query_revisions()
            codes = chain.stop()
            lacks = recording.end() if recording else []
        seen = Run.heard(chain.link, wall_s, codes, pss_mib=chain.pss_mib)
        return replace(seen, remarks=noted.summary(), not_recorded=lacks)
