"""What the doctor has heard of a robot, and what it finds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from zloam_monitor.records import PoseRecord, StatusRecord
from zloam_monitor.tokens import Claim
from zloam_monitor.watch import STALE_SECONDS


@dataclass(frozen=True)
class Finding:
    """A finding, and what to do about it."""

    what: str
    do: str
    #: False: the robot works, but could work better.
    is_fault: bool = True

    def __str__(self) -> str:
        return f"- {self.what}\n  {self.do}"


@dataclass(frozen=True)
class Heard:
    """Statuses at the beginning and end of the listening time, and the poses in between."""

    robot: str
    seconds: float
    before: dict[tuple[str, str], StatusRecord]
    after: dict[tuple[str, str], StatusRecord]
    #: (stage, instance) -> seconds since its last status.
    silent_s: dict[tuple[str, str], float]
    #: Instances with a liveliness token.
    living: set[tuple[str, str]]
    poses: Sequence[PoseRecord]
    configs: dict[str, dict[str, Any]]
    garbage: int = 0
    #: Mapped poses, as mapping publishes them.
    mapped: Sequence[PoseRecord] = ()
    #: How much longer than at first a status takes to arrive here, s.
    late_s: float = 0.0
    #: Tokens that no instance declared that answers.
    strangers: frozenset[Claim] = frozenset()
    #: Living stages that did not tell their configuration.
    unanswered: frozenset[str] = frozenset()

    def alive(self) -> list[StatusRecord]:
        return [s for who, s in self.after.items() if who in self.living]

    def of(self, stage: str) -> list[StatusRecord]:
        """Newest statuses of the instances of a stage that still publish them, standbys too."""
        return [
            status
            for (name, _), status in self.after.items()
            if name == stage and self.silent_s[(name, status.instance)] <= STALE_SECONDS
        ]

    def more(self, who: tuple[str, str], name: str) -> float:
        """Increase of a figure while listening."""
        before = self.before.get(who)
        return self.after[who].figures.get(name, 0.0) - (
            before.figures.get(name, 0.0) if before else 0.0
        )


Rule = Callable[[Heard], Iterable[Finding]]
