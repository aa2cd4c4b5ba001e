"""Decides which files of a folder a run may replace: only those that an earlier run wrote there.

A marker file in the folder lists them. A file that is not listed, or that was changed since, is
never touched; neither is an input of the run. The earlier run's files are only set aside until the
new run has begun, so that a run that is refused or fails to start leaves the folder as it was.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from zloam_monitor.failures import FileTrouble
from zloam_monitor.files import written_whole

if TYPE_CHECKING:
    from typing import Self

MARKER = ".zloam-files.json"
LOCK = ".zloam-lock"
#: Folder with the earlier run's files and marker, until the new run has begun.
BEFORE = ".zloam-before"

#: Size and modification time in ns. None: claimed by a run that did not reach its end.
Stamp = tuple[int, int] | None

#: Folders that this process writes into -> descriptor of the lock file.
_held: dict[Path, int] = {}


class NotOurs(FileTrouble):
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
    try:
        _put_back(folder)  # If the last run was killed before it had begun.
    except BaseException:
        os.close(descriptor)
        raise
    _held[folder] = descriptor


def let_go() -> None:
    """Releases all locks, as the end of this process would."""
    while _held:
        os.close(_held.popitem()[1])


class Claim:
    """Names in a folder that are reserved for a run. Leaving the block marks the files of a run
    that has begun; if it has not, the files of the run before are put back."""

    def __init__(self, folder: Path, names: tuple[str, ...], patterns: tuple[str, ...]) -> None:
        self._folder, self._names, self._patterns = folder, names, patterns
        self._others = self._matching()
        self._begun = False

    def _matching(self) -> set[str]:
        """Files in the folder that match a pattern."""
        found = (path for pattern in self._patterns for path in self._folder.glob(pattern))
        return {str(path.relative_to(self._folder)) for path in found}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._begun and (self._folder / BEFORE).is_dir():
            for name in self._made():
                (self._folder / name).unlink()
            _put_back(self._folder)
        else:
            # Without an earlier run, the files of a failed start stay, e.g. its logs.
            with suppress(OSError):  # On a full disk they stay marked as those of a run.
                self._record()

    def begin(self) -> None:
        """The run has begun: removes the files of the run before."""
        self._begun = True
        _discard(self._folder / BEFORE)

    def _made(self) -> set[str]:
        """Files of this run: those claimed, and new files that match a pattern."""
        claimed = {n for n in self._names if (self._folder / n).is_file()}
        return claimed | (self._matching() - self._others)

    def _record(self) -> None:
        marked = {n: s for n, s in _marked(self._folder).items() if n not in self._names}
        _mark(self._folder, marked | {n: _stamp(self._folder / n) for n in self._made()})


def claim(
    folder: Path, names: Iterable[str], inputs: Iterable[Path] = (), patterns: Iterable[str] = ()
) -> Claim:
    """Sets aside the files that an earlier run left under these names, and those that it marked and
    that match a pattern. Refuses if a file under such a name was not written by a run, or is an
    input of this run."""
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    _hold(folder)
    wanted, matched = tuple(names), tuple(patterns)
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
    further = [
        n
        for n in marked
        if n not in there
        and any(PurePath(n).match(pattern) for pattern in matched)
        and _is_ours(folder / n, marked, n)
        and (folder / n).resolve() not in read
    ]
    _set_aside(folder, [*there, *further], marked)
    kept = {n: s for n, s in marked.items() if os.path.lexists(folder / n) and n not in wanted}
    _mark(folder, kept | dict.fromkeys(wanted))
    return Claim(folder, wanted, matched)


def _set_aside(folder: Path, names: list[str], marked: dict[str, Stamp]) -> None:
    """Moves files to BEFORE. The marker there comes first, so that a program that is killed between
    two files loses none."""
    if not names:
        return
    before = folder / BEFORE
    before.mkdir()
    _mark(before, {n: marked[n] for n in names})
    for name in names:
        (before / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).replace(before / name)


def _put_back(folder: Path) -> None:
    """Moves the files in BEFORE back to the folder; files of a run that did not begin give way.
    Refuses if it can't be known which they are, as they are nowhere else."""
    before = folder / BEFORE
    earlier = _marked(before)
    if not earlier and (before / MARKER).exists():
        raise NotOurs(
            f"{before / MARKER} can't be read, which lists the files of an earlier run that were "
            f"set aside: move what you need out of {before}, and remove that folder"
        )
    back = {n: s for n, s in earlier.items() if os.path.lexists(before / n)}
    for name in back:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (before / name).replace(folder / name)
    if back:
        now = {n: s for n, s in _marked(folder).items() if os.path.lexists(folder / n)}
        _mark(folder, now | back)
    _discard(before)


def _discard(before: Path) -> None:
    """Removes the folder BEFORE, its marker first: without it, nothing is put back from there."""
    if before.is_dir():
        (before / MARKER).unlink(missing_ok=True)
        shutil.rmtree(before)
