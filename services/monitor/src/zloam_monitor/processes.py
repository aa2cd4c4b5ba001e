"""The stages as processes: starts, watches and ends them; each has a log file."""

from __future__ import annotations

import itertools
import os
import re
import signal
import socket
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from zloam_monitor.failures import Explained
from zloam_monitor.stages import PORT_ORDER

LOG_LINES = 12
#: Stages that keep what mapping publishes when it is stopped.
KEEPERS = ("store", "graph")
#: Environment variable with the descriptor of a pipe that closes when this program ends.
PARENT_PIPE = "ZLOAM_PARENT_PIPE"
_PSS_LINE = re.compile(r"^Pss:\s+(\d+) kB$", re.MULTILINE)
#: Meaning of a stage's exit code.
EXIT_CODES = {0: "ended well", 1: "failed", 2: "configuration refused", 3: "file or port"}


class StageDied(Explained):
    """A stage ended on its own; the text shows its last log lines."""

    def __init__(self, stage: str, code: int, log: str) -> None:
        super().__init__(f"{stage} ended with {describe_code(code)}:\n{log}")
        self.stage = stage
        self.code = code
        self.exit_code = code if code in (2, 3) else 1


def describe_code(code: int) -> str:
    """Text for an exit code."""
    if code < 0:
        return f"signal {signal.Signals(-code).name}"
    return f"exit code {code} ({EXIT_CODES.get(code, 'unknown')})"


def free_base_port(count: int = len(PORT_ORDER)) -> int:
    """First of `count` consecutive ports that are free on the loopback interface."""
    start = 20_000 + (os.getpid() * 61) % 9_000
    base: int
    for base in itertools.chain(range(start, 32_000, count), range(20_000, start, count)):
        if all(is_free(base + i) for i in range(count)):
            return base
    raise RuntimeError("no free ports on 127.0.0.1")


def free_port() -> int:
    """A port that is free on the loopback interface."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listen_error(port: int, host: str = "127.0.0.1") -> OSError | None:
    """Why no program could listen on this port; None: one could. IPv6 addresses stand in brackets,
    as in an endpoint."""
    try:
        found = socket.getaddrinfo(host.strip("[]"), None, type=socket.SOCK_STREAM)
    except OSError as error:
        return error
    except UnicodeError as error:  # Of a name like a..b.
        return OSError(f"no name of a host: {error}")
    last = None
    # Like Zenoh, which listens on the first of a name's addresses that can be used.
    for family, kind, _, _, address in found:
        try:
            # A kernel without IPv6 refuses the socket itself.
            with socket.socket(family, kind) as probe:
                # Like a listener's socket, which may use a port in TIME_WAIT.
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind((address[0], port, *address[2:]))
        except OSError as error:
            last = error
        else:
            return None
    return last


def is_free(port: int, host: str = "127.0.0.1") -> bool:
    """True if a program could listen on this port."""
    return listen_error(port, host) is None


def endpoints(base_port: int) -> list[str]:
    """Endpoints on which the stages listen."""
    return [f"tcp/127.0.0.1:{base_port + i}" for i in range(len(PORT_ORDER))]


def _pss_mib(pid: int) -> float | None:
    try:
        told = _PSS_LINE.search(Path(f"/proc/{pid}/smaps_rollup").read_text())
    except OSError:
        return None
    return int(told[1]) / 1024.0 if told else None


@dataclass
class Process:
    """One stage; its standard output and error go to the log."""

    stage: str
    command: list[str]
    log_path: Path
    #: Added to the environment of this process.
    environment: dict[str, str] = field(default_factory=dict)
    _process: subprocess.Popen[bytes] = field(init=False)
    _log: IO[bytes] = field(init=False)
    _alive: int = field(init=False)

    def __post_init__(self) -> None:
        self.log_path.parent.mkdir(parents=True, exist_ok=True)
        # A stage that is started again appends to its log.
        self._log = self.log_path.open("ab")
        # The other end closes when this program ends for whatever reason, and the stage then ends.
        inherited, self._alive = os.pipe()
        try:
            # A new session: Ctrl-C reaches only this program, which then ends the stages in order.
            self._process = subprocess.Popen(
                self.command,
                stdout=self._log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env={**os.environ, **self.environment, PARENT_PIPE: str(inherited)},
                pass_fds=[inherited],
            )
        except OSError:
            self._close()
            raise
        finally:
            os.close(inherited)

    @property
    def pid(self) -> int:
        return self._process.pid

    def code(self) -> int | None:
        """Exit code; None while the stage runs; -signal if a signal killed it."""
        return self._process.poll()

    def last_lines(self, count: int = LOG_LINES) -> str:
        try:
            lines = self.log_path.read_text(errors="replace").splitlines()
        except OSError as error:  # Removed during the run, for example.
            lines = [str(error)]
        return "\n".join("  " + line for line in lines[-count:]) or "  (no output)"

    def send(self, signal_number: int) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal_number)

    def wait(self, seconds: float) -> int | None:
        try:
            return self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return None
        finally:
            if self._process.poll() is not None and not self._log.closed:
                self._close()

    def _close(self) -> None:
        self._log.close()
        os.close(self._alive)


class Processes:
    """All stages of one chain."""

    def __init__(self) -> None:
        self.running: dict[str, Process] = {}

    def start(
        self,
        stage: str,
        command: list[str],
        log_path: Path,
        environment: dict[str, str] | None = None,
    ) -> Process:
        process = Process(stage, command, log_path, environment or {})
        self.running[stage] = process
        return process

    def check(self, may_end: tuple[str, ...] = ()) -> None:
        """Raises StageDied if a stage has ended unexpectedly."""
        for stage, process in self.running.items():
            code = process.code()
            if code is not None and not (code == 0 and stage in may_end):
                raise StageDied(stage, code, process.last_lines())

    def pss_mib(self) -> dict[str, float]:
        """Memory (proportional set size) of the stages that still run: pages that several processes
        map count proportionally. Stages for which the kernel does not report it are left out."""
        found = {stage: _pss_mib(process.pid) for stage, process in self.running.items()}
        return {stage: mib for stage, mib in found.items() if mib is not None}

    def stop(self, seconds: float = 20.0) -> dict[str, int]:
        """Ends all stages, those that keep what others publish at their end last; returns the exit
        codes in the order of the start."""
        keepers = [stage for stage in self.running if stage.partition("-")[0] in KEEPERS]
        others = [stage for stage in self.running if stage not in keepers]
        ended = self._stopped(others, seconds) | self._stopped(keepers, seconds)
        codes = {stage: ended[stage] for stage in self.running}
        self.running.clear()
        return codes

    def _stopped(self, stages: list[str], seconds: float) -> dict[str, int]:
        """Sends SIGTERM, and after `seconds` SIGKILL to the rest."""
        for stage in stages:
            self.running[stage].send(signal.SIGTERM)
        deadline = time.monotonic() + seconds
        codes = {}
        for stage in stages:
            process = self.running[stage]
            code = process.wait(max(0.1, deadline - time.monotonic()))
            if code is None:
                process.send(signal.SIGKILL)
                code = process.wait(10.0)
            codes[stage] = -signal.SIGKILL if code is None else code
        return codes
