"""What a person types becomes a command, and what was changed becomes options of a replay."""

from __future__ import annotations

from typing import Any

import pytest

from zloam_monitor.chain import ChainError
from zloam_monitor.records import RevisionRecord
from zloam_monitor.settings import as_set_at, pairs


def revision(rev: int, run: int, from_sweep: int, values: dict[str, Any]) -> RevisionRecord:
    return RevisionRecord("mapping", rev, run, from_sweep, values, "a", 1)


def test_pairs_keep_the_value_as_it_was_typed() -> None:
    assert pairs(["a.b=[1, 2]", "c=x=y", "d="]) == {"a.b": "[1, 2]", "c": "x=y", "d": ""}


@pytest.mark.parametrize("text", ["a", "=1", ""])
def test_what_is_no_pair_is_refused(text: str) -> None:
    with pytest.raises(ChainError, match="key=value is expected"):
        pairs([text])


def test_a_replay_is_given_what_was_in_force() -> None:
    found = [
        revision(1, run=6, from_sweep=40, values={"a": True}),
        revision(2, run=7, from_sweep=30, values={"a": False, "b": [1, 2.5]}),
    ]
    assert as_set_at(found, run=7) == ["0:a=true", "30:a=false", "30:b=[1, 2.5]"]
    assert as_set_at([revision(1, run=0, from_sweep=9, values={"c": "x"})], run=7) == ["9:c=x"]
