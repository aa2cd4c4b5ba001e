"""Decides which files of a folder a run may replace: only those that an earlier run wrote there.

A marker file in the folder lists them. A file that is not listed, or that was changed since, is
never touched; neither is an input of the run.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from zloam_monitor.files import written_whole

MARKER = ".zloam-files.json"
LOCK = ".zloam-lock"

#: Size and modification time in ns. None: claimed by a run that did not reach its end.
Stamp = tuple[int, int] | None

#: Folders that this process writes into -> descriptor of the lock file.
_held: dict[Path, int] = {}


class NotOurs(RuntimeError):
    """A file or another run is in the way; the text says which, and what to do."""


def _stamp(path: Path) -> Stamp:
    status = path.lstat()
    return status.st_size, status.st_mtime_ns


def _marked(folder: Path) -> dict[str, Stamp]:
    """Contents of the marker; an unreadable marker counts as empty."""
    try:
        read = json.loads((folder / MARKER).read_text(encoding="utf-8"))
        return {str(n): None if s is None else (int(s[0]), int(s[1])) for n, s in read.items()}
    except (OSError, ValueError, TypeError, AttributeError, IndexError):
        return {}


def _mark(folder: Path, marked: dict[str, Stamp]) -> None:
    with written_whole(folder / MARKER) as out:
        json.dump(marked, out, indent=1, sort_keys=True)
        out.write("\n")


def _is_ours(path: Path, marked: dict[str, Stamp], name: str) -> bool:
    if name not in marked or path.is_symlink() or not path.is_file():
        return False
    return marked[name] is None or marked[name] == _stamp(path)


def _hold(folder: Path) -> None:
    """Locks the folder for this process: only one program at a time writes into a folder."""
    if folder in _held:
        return
    descriptor = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise NotOurs(f"{folder}: another run writes here: choose another folder (OUT=)") from error
    _held[folder] = descriptor


def let_go() -> None:
    """Releases all locks, as the end of this process would."""
    while _held:
        os.close(_held.popitem()[1])


@dataclass(frozen=True)
class Claim:
    """Names in a folder that are reserved for this run until record()."""

    folder: Path
    names: tuple[str, ...]
    #: Files that were in the folder when the names were claimed.
    others: frozenset[str]

    def record(self, patterns: Iterable[str] = ()) -> None:
        """Marks the files of this run: those claimed, and new files that match a pattern."""
        found = {n for n in self.names if (self.folder / n).is_file()}
        for pattern in patterns:
            matching = self.folder.glob(pattern)
            found |= {str(p.relative_to(self.folder)) for p in matching} - self.others
        marked = {n: s for n, s in _marked(self.folder).items() if n not in self.names}
        _mark(self.folder, marked | {n: _stamp(self.folder / n) for n in found})


def claim(folder: Path, names: Iterable[str], inputs: Iterable[Path] = ()) -> Claim:
    """Removes files that an earlier run left under these names. Refuses if such a file was not
    written by a run, or is an input of this run."""
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    _hold(folder)
    wanted = tuple(names)
    marked = _marked(folder)
    read = {path.resolve() for path in inputs}
    there = [n for n in wanted if os.path.lexists(folder / n)]
    if used := [n for n in there if (folder / n).resolve() in read]:
        raise NotOurs(
            f"{folder / used[0]} is an input of this run, which would replace it: choose another "
            "folder for the output (OUT=)"
        )
    if others := [n for n in there if not _is_ours(folder / n, marked, n)]:
        raise NotOurs(
            f"{folder}: {', '.join(others)} would be replaced, but no earlier run made it, or it "
            "was changed since: move it away or choose another folder (OUT=)"
        )
    for name in there:
        (folder / name).unlink()
    _remove_numbered(folder, marked, wanted, read)
    everything = {str(p.relative_to(folder)) for p in (*folder.glob("*"), *folder.glob("*/*"))}
    kept = {n: s for n, s in marked.items() if os.path.lexists(folder / n) and n not in wanted}
    _mark(folder, kept | dict.fromkeys(wanted))
    return Claim(folder, wanted, frozenset(everything))


def _remove_numbered(
    folder: Path, marked: dict[str, Stamp], wanted: tuple[str, ...], read: set[Path]
) -> None:
    """Removes numbered files of an earlier run, e.g. trajectory_2.tum beside trajectory.tum."""
    stems = {(Path(n).stem, Path(n).suffix) for n in wanted}
    for name in marked:
        path = folder / name
        stem, _, number = path.stem.rpartition("_")
        of_ours = number.isdecimal() and (stem, path.suffix) in stems
        if of_ours and _is_ours(path, marked, name) and path.resolve() not in read:
            path.unlink()
