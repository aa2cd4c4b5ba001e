"""The loops of a robot's graph, as `zloam loop list` names them."""

from __future__ import annotations

import re

import flatbuffers
import pytest

from fake_session import FakeSession, linked, needs_schemas
from zloam_monitor import loops, messages
from zloam_monitor.chain import ChainError


def a_loop(older: int, newer: int, verdict: int = 0) -> bytes:
    b = flatbuffers.Builder(0)
    code = messages.module("Loop")
    code.Start(b)
    code.AddFromSweep(b, older)
    code.AddToSweep(b, newer)
    code.AddVerdict(b, verdict)
    b.Finish(code.End(b), messages.KINDS["Loop"].identifier)
    return bytes(b.Output())


def test_what_a_stranger_answers_is_left_out() -> None:
    needs_schemas()
    session = FakeSession(alive=("graph",))
    answers = [a_loop(3, 9), b"no loop at all", a_loop(1, 9, 7), a_loop(2, 5, 99)]
    session.rounds[session.keys.graph_loop] = [answers]
    found = [
        (each.from_sweep, each.to_sweep, each.verdict) for each in loops.known(linked(session))
    ]
    assert found == [(2, 5, "99"), (1, 9, "removed"), (3, 9, "accepted")]


def test_verdicts_are_those_of_the_schema() -> None:
    needs_schemas()
    values = vars(messages.module("LoopVerdict").LoopVerdict)
    named = {name: value for name, value in values.items() if isinstance(value, int)}
    said = {re.sub(r"(?<!^)([A-Z])", r" \1", name).lower(): n for name, n in named.items()}
    assert said == {name: number for number, name in enumerate(loops.VERDICTS)}


def test_a_robot_without_a_graph_is_told() -> None:
    with pytest.raises(ChainError, match="start the robot with --graph"):
        loops.known(linked(FakeSession()))
