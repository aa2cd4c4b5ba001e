"""A stage of a live run that ends by itself is started again, later each time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from zloam_monitor.processes import Processes, describe_code

#: until the first start again, and the longest; doubled each time
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
#: who has run so long begins with the first pause
STEADY_S = 60.0


class Startable(Protocol):
    """What is supervised."""

    processes: Processes

    def start(self, stage: str, log: str | None = None) -> None: ...


@dataclass
class _Fallen:
    """A stage that ended."""

    began: float
    pause_s: float = FIRST_PAUSE_S
    #: when it is started again; None while it runs
    again_at: float | None = None


class Supervisor:
    """Looks after all stages of a chain."""

    def __init__(self, chain: Startable) -> None:
        self._chain = chain
        self._fallen: dict[str, _Fallen] = {}

    def look(self, now: float) -> list[str]:
        """What there is to say; starts what is due."""
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
                self._chain.start(stage)
                known.pause_s = min(2 * known.pause_s, LONGEST_PAUSE_S)
                known.began, known.again_at = now, None
        return said
