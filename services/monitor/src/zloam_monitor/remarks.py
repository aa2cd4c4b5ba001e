"""Reports what stages say about themselves during a run, each remark once: reasons in their
statuses, and warnings and errors in their logs. Texts that differ only in numbers are one remark;
the same remark of several stages is one line."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from zloam_monitor.records import StatusRecord

#: A remark that has been absent for this long is reported again.
AWAY_SECONDS = 10.0
#: Health of a stage at which its reason is reported.
TROUBLED = ("degraded", "failed")
_WARNING = re.compile(r"^\S+Z (?:warning|error)\s+(?P<text>\S+: .*)$")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
#: Topic at the beginning of a reason, as in `imu file: ...` (Stage::degraded).
_TOPIC = r"[a-z][^\s;:,]*(?: [^\s;:,]+){0,3}: "
#: Between two reasons of a status. A reason may have semicolons of its own.
_NEXT = re.compile(rf"; (?={_TOPIC})")
#: Stage and topic before a text. The log has the text without the topic.
_HEAD = re.compile(rf"^([^\s:]+: ){_TOPIC}(?=.)")


@dataclass
class _Remark:
    text: str
    last: float
    times: int = 1


class Logs:
    """New warnings and errors in the log files of a folder. Lines that are in a file already belong
    to an earlier run."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read = {path: path.stat().st_size for path in folder.glob("*.log")}

    def new_warnings(self) -> list[str]:
        found = []
        for path in sorted(self._folder.glob("*.log")):
            with path.open("rb") as log:
                log.seek(self._read.get(path, 0))
                data = log.read()
            whole = data[: data.rfind(b"\n") + 1]
            self._read[path] = self._read.get(path, 0) + len(whole)
            lines = whole.decode(errors="replace").splitlines()
            found += [match["text"] for line in lines if (match := _WARNING.match(line))]
        return found


class Remarks:
    """Remembers remarks, to report each one once."""

    def __init__(self) -> None:
        self._known: dict[str, _Remark] = {}

    def news(self, texts: Iterable[str], now: float) -> list[str]:
        """The texts that are new, or have been absent for a while."""
        found = []
        for text in texts:
            kind = _NUMBER.sub("#", _HEAD.sub(r"\1", text))
            known = self._known.get(kind)
            if known is None or now - known.last > AWAY_SECONDS:
                found.append(text)
            if known is None:
                self._known[kind] = _Remark(text, now)
            else:
                known.times, known.last = known.times + 1, now
        return [text for text, _ in _joined((text, 1) for text in found)]

    def summary(self) -> list[str]:
        """The first text of each remark, and how often it occurred."""
        return [
            text + (f" (said {times} times)" if times > 1 else "")
            for text, times in _joined(self.counted())
        ]

    def counted(self) -> list[tuple[str, int]]:
        """The first text of each remark and stage, and how often it occurred."""
        return [(remark.text, remark.times) for remark in self._known.values()]


def _joined(said: Iterable[tuple[str, int]]) -> list[tuple[str, int]]:
    """Joins `stage: words` of several stages to `stage, stage: words`, with the largest count."""
    stages: dict[str, list[str]] = {}
    words: dict[str, tuple[str, int]] = {}
    for text, times in said:
        stage, colon, rest = text.partition(": ")
        kind = _NUMBER.sub("#", rest) if colon else text
        stages.setdefault(kind, []).append(stage)
        first, most = words.get(kind, (rest if colon else "", 0))
        words[kind] = first, max(most, times)
    return [
        (", ".join(stages[kind]) + (f": {rest}" if rest else ""), times)
        for kind, (rest, times) in words.items()
    ]


def reasons(statuses: Iterable[StatusRecord], healths: tuple[str, ...] = TROUBLED) -> list[str]:
    """`stage: reason` for each reason of a stage with one of these healths."""
    return [
        f"{status.stage}: {reason}"
        for status in statuses
        if status.health in healths
        for reason in reasons_in(status)
    ]


def reasons_in(status: StatusRecord) -> list[str]:
    """The reasons of a status, each with its topic."""
    return [reason for reason in _NEXT.split(status.reason) if reason]
