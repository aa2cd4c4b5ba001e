"""Writes files that appear complete or not at all: to a temporary name, then renamed."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Adds the path to failures of writing, which, unlike those of opening, name no file."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


@contextmanager
def written_whole(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Opens a temporary file, which gets its final name if the block ends without an exception.
    Text is UTF-8 on every machine; bytes of a name that are none are escaped. A folder
    or a device of this name is refused, not replaced."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EEXIST, "There already, and no file that could be replaced", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    encoding, errors = (None, None) if "b" in mode else ("utf-8", "backslashreplace")
    try:
        with named(path), temporary.open(mode, encoding=encoding, errors=errors) as out:
            yield out
            out.flush()
            os.fsync(out.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
