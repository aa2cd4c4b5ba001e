"""What stages say of themselves while they run, shown once: reasons in their statuses, and warnings
and errors in their logs. What differs by numbers only is one remark; what several stages say is one
line."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from zloam_monitor.records import StatusRecord

#: one that was away for so long is news again
AWAY_SECONDS = 10.0
#: health words of a stage whose reason matters
TROUBLED = ("degraded", "failed")
_WARNING = re.compile(r"^\S+Z (?:warning|error)\s+(?P<text>\S+: .*)$")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


@dataclass
class _Remark:
    text: str
    last: float
    times: int = 1


class Logs:
    """New warnings in the files of a folder; what was there before this began is left out."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[Path, int] = {}

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
    """Keeps what was said, and what of it is news."""

    def __init__(self) -> None:
        self._known: dict[str, _Remark] = {}

    def news(self, texts: Iterable[str], now: float) -> list[str]:
        """Those that were not said before, or not for a while."""
        found = []
        for text in texts:
            kind = _NUMBER.sub("#", text)
            known = self._known.get(kind)
            if known is None or now - known.last > AWAY_SECONDS:
                found.append(text)
            if known is None:
                self._known[kind] = _Remark(text, now)
            else:
                known.times, known.last = known.times + 1, now
        return [text for text, _ in _joined((text, 1) for text in found)]

    def summary(self) -> list[str]:
        """Each cause with its first text, and how often it was said."""
        return [
            text + (f" (said {times} times)" if times > 1 else "")
            for text, times in _joined(self.counted())
        ]

    def counted(self) -> list[tuple[str, int]]:
        """The first text of each kind, and how often it was said."""
        return [(remark.text, remark.times) for remark in self._known.values()]


def _joined(said: Iterable[tuple[str, int]]) -> list[tuple[str, int]]:
    """`stage: words` of several as `stage, stage: words`, with the most often it was said."""
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
    """`stage: reason`, one for each reason of a stage."""
    return [
        f"{status.stage}: {reason}"
        for status in statuses
        if status.health in healths
        for reason in status.reason.split("; ")
        if reason
    ]
