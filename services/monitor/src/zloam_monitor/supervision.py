"""Restarts a stage of a live run that ended by itself, with growing pauses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from zloam_monitor.processes import Processes, describe_code

#: First and longest pause before a restart; it doubles each time.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
#: After a stage has run for this long, the first pause applies again.
STEADY_S = 60.0


class Startable(Protocol):
    """The part of a chain that supervision needs."""

    processes: Processes

    def start(self, stage: str, log: str | None = None) -> None: ...


@dataclass
class _Fallen:
    """A stage that has ended at least once."""

    began: float
    pause_s: float = FIRST_PAUSE_S
    #: Time of the next restart; None while the stage runs.
    again_at: float | None = None


class Supervisor:
    """Supervises all stages of a chain."""

    def __init__(self, chain: Startable) -> None:
        self._chain = chain
        self._fallen: dict[str, _Fallen] = {}

    def look(self, now: float) -> list[str]:
        """Restarts stages that are due; returns texts about stages that ended."""
        said = []
        for stage, process in list(self._chain.processes.running.items()):
            code = process.code()
            if code is None:
                continue
            known = self._fallen.setdefault(stage, _Fallen(now))
            if known.again_at is None:
                if now - known.began > STEADY_S:
                    known.pause_s = FIRST_PAUSE_S
                known.again_at = now + known.pause_s
                said.append(
                    f"{stage} ended with {describe_code(code)}, and is started again in "
                    f"{known.pause_s:.0f} s; its last words:\n{process.last_lines()}"
                )
            elif now >= known.again_at:
                process.wait(0.0)
                known.pause_s = min(2 * known.pause_s, LONGEST_PAUSE_S)
                said += self._start(stage, known, now)
        return said

    def _start(self, stage: str, known: _Fallen, now: float) -> list[str]:
        """Restarts a stage; a text if the system refuses, which must not end the other stages."""
        try:
            self._chain.start(stage)
        except OSError as error:
            known.again_at = now + known.pause_s
            return [f"{stage} can't be started ({error}): next attempt in {known.pause_s:.0f} s"]
        known.began, known.again_at = now, None
        return []
