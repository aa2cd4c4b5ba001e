"""`set`: changes a running stage's configuration (protocols.md, section 13), as an operator."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

from zloam_monitor.chain import ChainError
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.records import ReplyRecord, RevisionRecord

#: a link takes a moment to come up; then an instance that is there answers at once
PATIENCE_SECONDS = 5.0


def pairs(texts: Iterable[str]) -> dict[str, str]:
    """key=value texts; the stage judges the values."""
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise ChainError(f"set: '{text}': key=value is expected")
        found[key] = value
    return found


def change(link: Link, stage: str, values: dict[str, str]) -> ReplyRecord:
    """The stage's answer; raises when there is none."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while (reply := link.command(stage, "set", dict(values))) is None:
        if time.monotonic() > deadline:
            raise ChainError(f"set: no instance of {stage} answered")
        time.sleep(0.1)
    return reply


def set_values(keys: Keys, endpoints: list[str], stage: str, texts: Sequence[str]) -> int:
    """Prints what the stage said; 0 when it accepted."""
    values = pairs(texts)
    session = open_session(endpoints)
    link = Link(session, keys)
    try:
        reply = change(link, stage, values)
    finally:
        link.close()
        session.close()
    print(reply.message)
    return 0 if reply.ok else 1


def _text(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_text(each) for each in value) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def as_set_at(revisions: Iterable[RevisionRecord], run: int | None) -> list[str]:
    """The changes in force in a run, for a replay of it: texts for the stages' --set-at. Each
    revision carries all that was changed so far; those of earlier runs hold from the start on."""
    return [
        f"{revision.from_sweep if revision.run in (0, run) else 0}:{key}={_text(value)}"
        for revision in revisions
        for key, value in revision.values.items()
    ]
