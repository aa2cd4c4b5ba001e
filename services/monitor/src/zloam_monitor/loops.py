"""Loops of a robot's graph: asks for them, adds and removes one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass

from zloam_monitor import messages, records
from zloam_monitor.chain import ChainError
from zloam_monitor.link import Link
from zloam_monitor.records import ReplyRecord
from zloam_monitor.settings import commanded

#: Names of the values of LoopVerdict in the schemas.
VERDICTS = (
    "accepted",
    "alone",
    "little overlap",
    "weak",
    "not unique",
    "impossible",
    "taken back",
    "removed",
)


@dataclass(frozen=True)
class LoopRecord:
    """Two submaps, by the sweeps of their frames, that may show the same place."""

    from_sweep: int
    to_sweep: int
    verdict: str
    overlap: float
    residual_m: float
    chi2: float

    def __str__(self) -> str:
        return (
            f"{self.from_sweep} to {self.to_sweep}: {self.verdict}, overlap {self.overlap:.2f}, "
            f"residual {self.residual_m:.3f} m, chi2 {self.chi2:.1f}"
        )


def _record(payload: bytes) -> LoopRecord:
    loop = messages.decode("Loop", payload)
    return LoopRecord(
        loop.FromSweep(),
        loop.ToSweep(),
        records.name_of(VERDICTS, loop.Verdict()),
        loop.Overlap(),
        loop.ResidualM(),
        loop.Chi2(),
    )


def known(link: Link) -> list[LoopRecord]:
    """Loops that are or were in force, or wait for another one, in the order of their sweeps."""
    if "graph" not in link.living():
        raise ChainError("loop list: no graph answers; start the robot with --graph (GRAPH=1)")
    found = []
    for payload in link.get(link.keys.graph_loop):
        with contextlib.suppress(*messages.DECODE_ERRORS):  # A stranger's.
            found.append(_record(payload))
    return sorted(found, key=lambda loop: (loop.to_sweep, loop.from_sweep))


def lines(found: Iterable[LoopRecord]) -> list[str]:
    return [str(loop) for loop in found] or ["no loops"]


def add(link: Link, from_sweep: int, to_sweep: int, force: bool) -> ReplyRecord:
    """Adds the loop between two submaps if it is verified, or in any case."""
    ends = {"from_sweep": from_sweep, "to_sweep": to_sweep}
    return commanded(link, "graph", "add", {**ends, **({"force": True} if force else {})})


def remove(link: Link, from_sweep: int, to_sweep: int) -> ReplyRecord:
    """Takes the loop between two submaps out of force."""
    return commanded(link, "graph", "remove", {"from_sweep": from_sweep, "to_sweep": to_sweep})
