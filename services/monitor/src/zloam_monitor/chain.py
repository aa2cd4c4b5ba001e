"""The five stages on this machine, connected peer to peer without a router."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from zloam_monitor import places, robot_file
from zloam_monitor.failures import Explained
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.ports import Ports
from zloam_monitor.processes import Processes, free_base_port, free_port
from zloam_monitor.records import StatusRecord
from zloam_monitor.stages import CONFIGURED, STAGES, standby_of

if TYPE_CHECKING:
    from typing import Self

#: Stages that can have a standby: it learns all that they know from the published messages.
STOOD_BY = ("registration", "odometry", "mapping", "integration")
#: Consumers start first, so that the first sweep finds its subscribers.
START_ORDER = STAGES[::-1]
READY_SECONDS = 60.0
#: Time for the stages' last statuses to arrive here after the processes have ended.
LAST_WORDS_SECONDS = 0.3


class ChainError(Explained):
    """The chain does not work as it should; the text says what is known."""


class BinariesMissing(Explained):
    """The stages are not built."""


#: Programs that not every robot needs: beginning of the name -> make target that builds them.
TARGETS = {"graph": "graph", "aloam": "aloam", "calibrate": "graph", "sessions": "graph"}


def binary(build: Path, name: str) -> Path:
    """Path of a program in a build folder."""
    path = build / "bin" / f"zloam-{name}"
    if not path.is_file():
        # Optional programs have make targets of their own.
        target = next((t for n, t in TARGETS.items() if name.startswith(n)), "build")
        raise BinariesMissing(f"{path} does not exist: {_source(build, target)}")
    return path


def readers(build: Path) -> dict[str, Path]:
    """Stage -> program, of the stages that read a robot's file. Those beside the chain are left out
    if they are not built."""
    beside = [stage for stage in CONFIGURED if stage not in STAGES]
    built = [stage for stage in beside if (build / "bin" / f"zloam-{stage}").is_file()]
    return {stage: binary(build, stage) for stage in (*STAGES, *built)}


def _source(build: Path, target: str) -> str:
    """Advice on how to get a program."""
    if build != places.BUNDLED:
        return f"build it first (make {target})"
    packages = {"aloam": "a checkout has it", "graph": "the Debian package and a checkout have it"}
    return f"this package does not contain it; {packages.get(target, 'install the package again')}"


class Chain:
    """Starts, watches and ends the stages; `link` receives what any third party would."""

    def __init__(
        self,
        build: Path,
        config: Path,
        robot: str,
        settings: Sequence[str],
        logs: Path,
        sensor: str = "lidar",
        set_at: Sequence[str] = (),
        ports: Ports | None = None,
        programs: Mapping[str, str] | None = None,
        beside: Sequence[str] = (),
        replay: bool = False,
    ) -> None:
        """Without `ports` the stages listen on free ports of this machine. `programs`: stage ->
        program that replaces its own (methods.py). `beside`: optional stages, which are started
        first and must also reach the end of the run. `replay`: the stages wait for `link`."""
        chosen = programs or {}
        connects = robot_file.connects(config, list(settings))
        self.processes = Processes()
        self.ports = ports or Ports(free_base_port())
        self._own_port = free_port()
        self.exit_codes: dict[str, int] = {}
        #: Memory share of each stage in MiB, measured by stop() before it ends them.
        self.pss_mib: dict[str, float] = {}
        #: stage -> environment variables in addition to those of this process.
        self.environments: dict[str, dict[str, str]] = {}
        self._commands = {
            stage: self._command(
                binary(build, chosen.get(stage, stage)), config, settings, set_at, connects
            )
            for stage in (*STAGES, *beside)
        }
        #: Name of a standby -> its stage.
        self._standbys: dict[str, str] = {}
        self._beside = tuple(beside)
        self._logs = logs
        keys = Keys(robot, sensor)
        session = open_session([], self._own_endpoint(), shared_memory=not replay)
        self.link = Link(session, keys)

    @property
    def base_port(self) -> int:
        return self.ports.base

    def _own_endpoint(self) -> str:
        """The stages connect to this endpoint at their start, so that this process misses none of
        a run's messages."""
        return f"tcp/127.0.0.1:{self._own_port}"

    def _command(
        self,
        program: Path,
        config: Path,
        settings: Sequence[str],
        set_at: Sequence[str],
        connects: Sequence[str],
    ) -> list[str]:
        """connects: endpoints that the user wants the stages to connect to, beside this process."""
        command = [str(program), "--config", str(config)]
        endpoints = json.dumps([*connects, self._own_endpoint()])
        own = (*self.ports.settings(), f"zenoh.connect={endpoints}")
        for setting in (*settings, *own):
            command += ["--set", setting]
        for change in set_at:
            command += ["--set-at", change]
        return command

    def __enter__(self) -> Self:
        try:
            readers = (*self._beside, *START_ORDER[:-1])
            for stage in (*readers, START_ORDER[-1]):
                if stage == "driver":
                    self._wait_for(readers)
                self.start(stage)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def start(self, stage: str, log: str | None = None) -> None:
        """Starts a stage, or starts it again; `log`: name of its log file without .log."""
        path = self._logs / f"{log or stage}.log"
        if stage in self._standbys:
            # Readers know second copies by instance, term and number; each start counts from 0.
            instance = f"{stage}-{time.time_ns() // 10**6}"
            command = self._command_as(self._standbys[stage], instance)
        else:
            command = self._commands[stage]
        self.processes.start(stage, command, path, self.environments.get(stage))

    def start_standbys(self) -> None:
        """Starts a standby of each stage that can have one (recovery.standby). To restart a
        standby, call start() with its name."""
        self._standbys = {standby_of(stage): stage for stage in STOOD_BY}
        for name in self._standbys:
            self.start(name)

    def _command_as(self, stage: str, instance: str) -> list[str]:
        """Command of a stage under another instance name, listening on a free port."""
        own = ["--instance", instance, "--set", "zenoh.listen=[tcp/127.0.0.1:0]"]
        return self._commands[stage] + own

    def start_replica(
        self, stage: str, instance: str, environment: dict[str, str] | None = None
    ) -> None:
        """Starts another instance of a stage under its own name, listening on a free port."""
        log = self._logs / f"{instance}.log"
        self.processes.start(instance, self._command_as(stage, instance), log, environment)

    def close(self) -> None:
        """Ends all stages, then the link."""
        if self.processes.running:
            self.exit_codes = self.processes.stop()
        if self.link.session is not None:
            self.link.close()
            self.link.session.close()
            self.link.session = None

    def stop(self) -> dict[str, int]:
        """Sends SIGTERM, waits, and returns the exit code of each stage. Statuses that the stages
        send while ending are still received."""
        self.pss_mib = self.processes.pss_mib()
        self.exit_codes = self.processes.stop()
        quiet = time.monotonic() + LAST_WORDS_SECONDS
        while time.monotonic() < quiet:
            self.link.poll(LAST_WORDS_SECONDS)
        return self.exit_codes

    def check(self) -> None:
        """Raises if a stage has died. The driver may end: with a finite source it exits when the
        sinks report the end of the run, perhaps before their statuses arrive here."""
        self.processes.check(may_end=("driver",))

    def wait_ready(self) -> None:
        """Waits until every stage has sent a status; raises if one fails to start."""
        self._wait_for(STAGES)

    def wait_linked(self) -> None:
        """Waits until every stage also has its subscribers, so that none misses the beginning of
        what a sensor sends from now on. A replay's driver waits for them by itself."""
        self._wait_for(STAGES, lambda status: status.health in ("ready", "degraded"))

    def _wait_for(
        self, stages: Sequence[str], good: Callable[[StatusRecord], bool] = lambda status: True
    ) -> None:
        deadline = time.monotonic() + READY_SECONDS

        def is_missing(stage: str) -> bool:
            status = self.link.stage(stage)
            return status is None or not good(status)

        while missing := [stage for stage in stages if is_missing(stage)]:
            self.link.poll(0.1)
            self.processes.check(may_end=("driver",))
            if time.monotonic() > deadline:
                known = self.processes.running
                said = [known[stage].last_lines() for stage in missing if stage in known]
                raise ChainError(
                    f"no sign of {', '.join(missing)} within {READY_SECONDS:.0f} s:\n"
                    + "\n".join(said)
                )

    def finished(self) -> bool:
        """True if the last stages of the data flow have processed the last sweep of the run."""
        last = ("integration", "mapping", *self._beside)
        found = [self.link.stage(stage) for stage in last]
        return all(s is not None and s.end_of_run for s in found)

    def statuses(self) -> dict[str, StatusRecord]:
        """The newest status of each stage; after stop() its last one."""
        return self.link.newest_statuses()

    def progress(self) -> tuple[int, int]:
        """(poses, newest mapped sweep): at least one grows while the chain is working."""
        mapping = self.link.stage("mapping")
        mapped = mapping.last_sweep if mapping is not None else None
        return len(self.link.poses), -1 if mapped is None else mapped
