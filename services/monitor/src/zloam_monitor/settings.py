"""Commands to running stages: `set` changes the configuration (docs/protocol.md, section 13),
`save` writes files, `reset` empties the map, `place` tells where the robot is in the map."""

from __future__ import annotations

import difflib
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from zloam_monitor.chain import ChainError
from zloam_monitor.failures import Misuse
from zloam_monitor.link import BUSY_SECONDS, PATIENCE_SECONDS, Link
from zloam_monitor.records import ReplyRecord, RevisionRecord, StatusRecord
from zloam_monitor.stages import ROWS

#: Names are listed in a message if there are at most so many.
MOST_LISTED = 12

#: (stage, reply) for each stage that was asked, in the order of the replies.
Replies = Iterator[tuple[str, ReplyRecord]]
#: Blanks before a setting, KEY=VALUE or SWEEP:KEY=VALUE.
_BEGIN = re.compile(r"\s+(?=(?:[0-9]+:)?(?:robot|[a-z_]+(?:\.[a-z0-9_]+)+)=)")


def several(text: str) -> list[str]:
    """Splits `key=value key=value`; a value may contain blanks, unless ` key=` follows them."""
    return [each.strip() for each in _BEGIN.split(text.strip()) if each.strip()]


def existing_files(text: str) -> list[Path]:
    """Splits names of files at blanks. A name may contain blanks: the longest one that exists is
    taken."""
    words = text.split(" ")
    found = []
    while words:
        ends = range(len(words), 0, -1)
        end = next((e for e in ends if Path(" ".join(words[:e])).is_file()), 1)
        if name := " ".join(words[:end]):
            found.append(Path(name))
        words = words[end:]
    return found


def pairs(texts: Iterable[str]) -> dict[str, str]:
    """Splits key=value texts; the stage checks the values."""
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise Misuse(f"set: '{text}': key=value is expected")
        found[key] = value
    return found


def meant(name: str, known: Iterable[str]) -> str:
    """Words after a name that may be mistyped: the nearest of the known ones; empty if it is one of
    them. A robot may have stages that are not in this list, so this is no reason to refuse one."""
    names = list(known)
    if name in names:
        return ""
    nearest = _nearest(name, names, 3)
    if not nearest:
        # The end of a key without its section is what is remembered of it.
        nearest = [each for each in names if name and name in each][:3]
    if nearest:
        return " (did you mean " + " or ".join(f"'{each}'" for each in nearest) + "?)"
    return f" (there are {', '.join(names)})" if len(names) <= MOST_LISTED else ""


def stage_and_pairs(stage: str, texts: Iterable[str]) -> dict[str, str]:
    """The values for a stage; refuses a command line that does not begin with a stage."""
    given = list(texts)
    key, equals, _ = stage.partition("=")
    if equals:
        # A key begins with its stage's name, but for those that several stages have.
        section = key.split(".")[0]
        whose = next(iter(_nearest(section, ROWS, 1)), "STAGE")
        raise Misuse(f"set: a stage comes first: zloam set {whose} {' '.join([stage, *given])}")
    if not given:
        raise Misuse(f"set: KEY=VALUE is missing; zloam get {stage} lists keys and values")
    return pairs(given)


def _nearest(name: str, known: Iterable[str], most: int) -> list[str]:
    return difflib.get_close_matches(name, list(known), n=most, cutoff=0.6)


def commanded(link: Link, stage: str, verb: str, arguments: Mapping[str, Any]) -> ReplyRecord:
    """Sends a command and returns the stage's reply; raises if there is none."""
    asked = time.monotonic()
    while (reply := link.command(stage, verb, dict(arguments))) is None:
        patience = BUSY_SECONDS if stage in link.living() else PATIENCE_SECONDS
        if time.monotonic() > asked + patience:
            raise ChainError(f"{verb}: no instance of {stage} answered{meant(stage, ROWS)}")
        time.sleep(0.1)
    return reply


def change(link: Link, stage: str, values: dict[str, str]) -> ReplyRecord:
    """Sends `set` and returns the stage's reply; raises if there is none."""
    return commanded(link, stage, "set", values)


def save(link: Link, folder: Path | None) -> Replies:
    """Makes the stages write map and trajectories, into the folder or where they are configured
    to."""
    for stage, name in (("mapping", "map.pcd"), ("integration", "")):
        path = {} if folder is None else {"path": str(folder / name)}
        yield stage, commanded(link, stage, "save", path)


def reset(link: Link, stages: Iterable[str]) -> Replies:
    """Makes the stages discard what they have accumulated."""
    for stage in stages:
        yield stage, commanded(link, stage, "reset", {})


def hand_over(link: Link, stage: str, to: str | None) -> ReplyRecord:
    """Makes a standby instance take over a stage's work. If no instance of the stage works, because
    a stranger's token silences it, makes one of them work in spite of it."""
    able = [row.name for row in ROWS.values() if row.in_chain and row.reads and not row.replicas]
    single = [row.name for row in ROWS.values() if not row.replicas]
    unable = ChainError(f"handover: {stage}: one of {', '.join(able)} is expected")
    if stage not in single:
        raise unable
    deadline = time.monotonic() + BUSY_SECONDS
    while True:
        there = instances(link, stage)
        if not all(status.is_silent for status in there):
            if stage not in able:
                raise unable
            return commanded(link, stage, "handover", {} if to is None else {"to": to})
        for status in there:
            if to in (None, status.instance):
                reply = _take_over(link, stage, status.instance)
                if reply is not None:
                    return reply
        if time.monotonic() > deadline:
            named = "no instance" if to is None else f"no instance {to}"
            raise ChainError(f"handover: {named} of {stage} answered")
        time.sleep(0.2)


def instances(link: Link, stage: str) -> list[StatusRecord]:
    """Statuses of a stage's instances that live, the one that has run for longest first."""
    claims = link.claims()
    living = [
        status
        for status in link.answering()
        if status.stage == stage and any(claim.is_of(status) for claim in claims)
    ]
    return sorted(living, key=lambda status: (status.started_ns, status.instance))


def _take_over(link: Link, stage: str, instance: str) -> ReplyRecord | None:
    """Asks an instance itself; None: it did not answer."""
    for reply in link.replies(link.keys.takeover(stage, instance), seconds=PATIENCE_SECONDS):
        if reply.ok is not None:
            term = reply.ok.payload.to_string()
            return ReplyRecord(True, f"{instance} works now, term {term}", {})
        return ReplyRecord(False, reply.err.payload.to_string(), {})
    return None


def place(link: Link, x_m: float, y_m: float, yaw_deg: float) -> ReplyRecord:
    """Tells mapping where base_link is in the map."""
    return commanded(link, "mapping", "place", {"x_m": x_m, "y_m": y_m, "yaw_deg": yaw_deg})


def in_force(link: Link, stage: str | None, key: str | None) -> dict[str, dict[str, Any]]:
    """Stage -> key -> value; of one stage or all, of one key, of a section, or of all keys."""
    configs = link.query_configs()
    if stage is not None and stage not in configs:
        known = {each for values in configs.values() for each in values}
        if key is None and any(_below(each, stage) for each in known):
            raise ChainError(f"get: '{stage}' is a key: zloam get {_owner(configs, stage)} {stage}")
        raise ChainError(
            f"get: {stage} does not answer; {', '.join(sorted(configs))} do{meant(stage, ROWS)}"
        )
    found = {
        name: {
            each: value
            for each, value in sorted(values.items())
            if key is None or _below(each, key)
        }
        for name, values in sorted(configs.items())
        if stage in (None, name)
    }
    if not any(found.values()):
        lacking = "".join(f"; {line}" for line in unanswered(link, stage))
        keys = (each for name, of in configs.items() if stage in (None, name) for each in of)
        near = meant(key or "", sorted(set(keys)))
        raise ChainError(f"get: no key {key}{near}; without a key all are listed{lacking}")
    return found


def _below(key: str, section: str) -> bool:
    return key == section or key.startswith(f"{section}.")


def _owner(configs: Mapping[str, Mapping[str, Any]], key: str) -> str:
    """The stage that has a key, or a section of keys."""
    return next(name for name, of in sorted(configs.items()) if any(_below(k, key) for k in of))


def unanswered(link: Link, stage: str | None) -> list[str]:
    """Texts about the stages whose values are missing in the answer for one stage or all."""
    missing = sorted(link.unanswered) if stage is None else []
    return [f"{each} is alive, but did not answer: its values are missing" for each in missing]


def lines(values: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Text for a person."""
    return [
        f"{stage} {key}={_text(value)}"
        for stage, of_stage in values.items()
        for key, value in of_stage.items()
    ]


def _text(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_text(each) for each in value) + "]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def as_set_at(revisions: Iterable[RevisionRecord], run: int | None) -> list[str]:
    """The changes in force in a run as texts for the stages' --set-at, to replay the run. Each
    revision contains all changes so far; those of earlier runs hold from sweep 0."""
    return [
        f"{revision.from_sweep if revision.run in (0, run) else 0}:{key}={_text(value)}"
        for revision in revisions
        for key, value in revision.values.items()
    ]


def changes(
    revisions: Iterable[RevisionRecord], run: int | None, last_sweep: int
) -> tuple[list[str], list[str]]:
    """The changes of a run as as_set_at() gives them: those in force up to its last sweep, and
    those that it ended before."""
    in_time, late = list[RevisionRecord](), list[str]()
    held: dict[str, Any] = {}
    for revision in revisions:
        if revision.run not in (0, run) or revision.from_sweep <= last_sweep:
            in_time.append(revision)
        else:
            new = {k: v for k, v in revision.values.items() if k not in held or held[k] != v}
            late += as_set_at([replace(revision, values=new)], run)
        held.update(revision.values)
    return as_set_at(in_time, run), late
