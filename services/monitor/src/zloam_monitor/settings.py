"""Commands to running stages: `set` changes a configuration (docs/protocol.md, section 13), `save`
writes files, `reset` empties the map, `place` says where in it the robot is."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from zloam_monitor.chain import ChainError
from zloam_monitor.link import BUSY_SECONDS, PATIENCE_SECONDS, Link
from zloam_monitor.records import ReplyRecord, RevisionRecord
from zloam_monitor.stages import ROWS

#: where a setting begins, or one that holds from a sweep on
_BEGIN = re.compile(r"\s+(?=(?:[0-9]+:)?(?:robot|[a-z_]+(?:\.[a-z0-9_]+)+)=)")


def several(text: str) -> list[str]:
    """`key=value key=value` as single settings; a value may hold blanks, but for ` key=`."""
    return [each.strip() for each in _BEGIN.split(text.strip()) if each.strip()]


def existing_files(text: str) -> list[Path]:
    """Names of files with blanks between them, and perhaps in them: the longest that exist."""
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
    """key=value texts; the stage judges the values."""
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise ChainError(f"set: '{text}': key=value is expected")
        found[key] = value
    return found


def commanded(link: Link, stage: str, verb: str, arguments: Mapping[str, Any]) -> ReplyRecord:
    """The stage's answer; raises when there is none."""
    asked = time.monotonic()
    while (reply := link.command(stage, verb, dict(arguments))) is None:
        patience = BUSY_SECONDS if stage in link.living() else PATIENCE_SECONDS
        if time.monotonic() > asked + patience:
            raise ChainError(f"{verb}: no instance of {stage} answered")
        time.sleep(0.1)
    return reply


def change(link: Link, stage: str, values: dict[str, str]) -> ReplyRecord:
    """The stage's answer to `set`; raises when there is none."""
    return commanded(link, stage, "set", values)


def set_values(link: Link, stage: str, values: dict[str, str]) -> int:
    """Prints what the stage said; 0 when it accepted."""
    reply = change(link, stage, values)
    print(reply.message)
    return 0 if reply.ok else 1


def save(link: Link, folder: Path | None) -> int:
    """Map and trajectories, into a folder or where the stages' configuration says."""
    targets = {"mapping": "map.pcd", "integration": ""}
    codes = []
    for stage, name in targets.items():
        path = {} if folder is None else {"path": str(folder / name)}
        reply = commanded(link, stage, "save", path)
        print(f"{stage}: {reply.message}")
        codes.append(0 if reply.ok else 1)
    return max(codes)


def reset(link: Link, stages: Iterable[str]) -> int:
    """Empties what the stages have gathered."""
    codes = []
    for stage in stages:
        reply = commanded(link, stage, "reset", {})
        print(f"{stage}: {reply.message}")
        codes.append(0 if reply.ok else 1)
    return max(codes)


def hand_over(link: Link, stage: str, to: str | None) -> int:
    """Lets an instance that stands by go on with a stage's work."""
    able = [row.name for row in ROWS.values() if row.in_chain and row.reads and not row.replicas]
    if stage not in able:
        raise ChainError(f"handover: {stage}: one of {', '.join(able)} is expected")
    reply = commanded(link, stage, "handover", {} if to is None else {"to": to})
    print(reply.message)
    return 0 if reply.ok else 1


def place(link: Link, x_m: float, y_m: float, yaw_deg: float) -> int:
    """Tells mapping where base_link is in the map."""
    reply = commanded(link, "mapping", "place", {"x_m": x_m, "y_m": y_m, "yaw_deg": yaw_deg})
    print(reply.message)
    return 0 if reply.ok else 1


def show(link: Link, stage: str | None, key: str | None) -> int:
    """The values in force."""
    configs = link.query_configs()
    if stage is not None and stage not in configs:
        raise ChainError(f"get: {stage} does not answer; {', '.join(sorted(configs))} do")
    shown = 0
    for name, values in sorted(configs.items()):
        for each, value in sorted(values.items()):
            if stage in (None, name) and (key is None or each == key or each.startswith(f"{key}.")):
                print(f"{name} {each}={_text(value)}")
                shown += 1
    if not shown:
        raise ChainError(f"get: no key {key}; without a key all are listed")
    return 0


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
