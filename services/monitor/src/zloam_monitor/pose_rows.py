"""Reads rows of numbers from pose files of other programs, and refuses what is not a pose.

Columns are separated by blanks, tabs, commas or semicolons; `#` begins a comment. A byte order
mark and other encodings in comments are ignored, and so is one line of column names, unless it
names another order of the columns. Columns that it names after TUM's are not read.
"""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.failures import FileTrouble

Array = NDArray[np.float64]

#: Largest stamp in 64 bits.
LATEST_NS = int(np.iinfo(np.int64).max)
NS_PER_S = 1_000_000_000
#: Seconds since 1970 stay below this until the year 5138, so a greater number has another unit.
LARGEST_SECONDS = 1e11
#: Deviation from unit length of a quaternion or rotation written with two digits.
UNIT_TOLERANCE = 0.01
#: Last letters of the names of a TUM file's columns; the time's is none of them.
TUM_ORDER = ".xyzxyzw"
#: Before the last number: some programs end each line with commas.
_EMPTY_CELL = re.compile(r"^\s*[,;]|[,;]\s*[,;]\s*[^,;\s]")
#: Unit at the end of a column's name.
_UNIT = re.compile(r"\s*(\[.*\]|\(.*\)|_m)$")


class TrajectoryError(FileTrouble, ValueError):
    """A trajectory file that cannot be used, with the reason."""


@dataclass(frozen=True)
class Row:
    """Cells of one line, and its location for messages."""

    where: str
    cells: list[str]


def read_rows(path: Path) -> tuple[list[Row], Array]:
    """All rows, which have the same number of columns, and their numbers, which are finite."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise TrajectoryError(f"{path}: {error.strerror}") from error
    text = _text(data)
    # No text has the character NUL; UTF-16 has it as a byte.
    if "\0" in text:
        raise TrajectoryError(
            f"{path}: is no text; a trajectory in TUM or KITTI format is expected"
        )
    rows = [
        Row(f"{path}, line {number}", cells)
        for number, line in enumerate(text.splitlines(), 1)
        if (cells := _cells(line, f"{path}, line {number}"))
    ]
    names = _names(path, text.splitlines())
    if rows and not any(_is_number(cell) for cell in rows[0].cells):
        rows = rows[1:]  # The first row has names of columns.
    if not rows:
        raise TrajectoryError(f"{path}: no poses")
    if names.startswith(TUM_ORDER):
        rows = [Row(row.where, row.cells[: len(TUM_ORDER)]) for row in rows]
    for row in rows:
        if len(row.cells) != len(rows[0].cells):
            raise TrajectoryError(
                f"{row.where}: {len(row.cells)} columns, {len(rows[0].cells)} in the first pose"
            )
    return rows, np.array([_numbers(row) for row in rows])


def _text(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    return data.decode("utf-8-sig", errors="replace")


def _names(path: Path, lines: list[str]) -> str:
    """The axes of the named columns, a letter each; empty: no names. Refuses names, also in a
    comment, that say another order than TUM's: a quaternion with w first has unit length, too."""
    letters = ""
    for number, line in enumerate(lines, 1):
        named = line.strip().lstrip("#%").strip()
        if not named:
            continue
        if _is_number(re.split(r"[,;\s]", named)[0]):
            break  # The first pose.
        names = re.split(r"[,;]", named) if re.search(r"[,;]", named) else named.split()
        letters = "".join(_axis(name) for name in names)
        if letters != TUM_ORDER and sorted(letters) == sorted(TUM_ORDER):
            raise TrajectoryError(
                f"{path}, line {number}: the columns are {', '.join(n.strip() for n in names)}; "
                "TUM's are the time, x, y, z, qx, qy, qz, qw: bring them into this order"
            )
    return letters


def _axis(name: str) -> str:
    """The axis at the end of a column's name, before its unit; "." if there is none."""
    letter = _UNIT.sub("", name.strip()).lower()[-1:]
    return letter if letter and letter in TUM_ORDER else "."


def _cells(line: str, where: str) -> list[str]:
    values = line.partition("#")[0]
    if ";" in values and "," in values:
        raise TrajectoryError(f"{where}: decimal commas; write numbers with a point")
    if _EMPTY_CELL.search(values):
        raise TrajectoryError(f"{where}: a cell without a number")
    return values.replace(",", " ").replace(";", " ").split()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(row: Row) -> list[float]:
    numbers = []
    for cell in row.cells:
        if not _is_number(cell) or not np.isfinite(float(cell)):
            raise TrajectoryError(f"{row.where}: '{cell}' is no finite number; leave the line out")
        numbers.append(float(cell))
    return numbers


def unit_quaternions(rows: list[Row], quaternions: Array) -> None:
    """Refuses quaternions that are not of unit length."""
    lengths = np.linalg.norm(quaternions, axis=1)
    for i in np.flatnonzero(np.abs(lengths - 1.0) > UNIT_TOLERANCE)[:1]:
        raise TrajectoryError(
            f"{rows[i].where}: the quaternion (columns 5 to 8) has length {lengths[i]:.3g}, not 1"
        )


def unit_rotations(rows: list[Row], rotations: Array) -> None:
    """Refuses matrices that are not rotations, e.g. reflections."""
    off = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2))
    wrong = (off > UNIT_TOLERANCE) | (np.linalg.det(rotations) < 0)
    for i in np.flatnonzero(wrong)[:1]:
        raise TrajectoryError(f"{rows[i].where}: the left three columns are no rotation")


def parse_stamp(text: str) -> int:
    """Seconds as text to ns, exact when written with up to nine digits."""
    return _scaled(text, NS_PER_S)


def _scaled(text: str, unit_ns: int) -> int:
    return int((Decimal(text) * unit_ns).to_integral_value())


def _times(rows: list[Row], unit_ns: int) -> NDArray[np.int64]:
    times = [_scaled(row.cells[0], unit_ns) for row in rows]
    for row, time in zip(rows, times, strict=True):
        if abs(time) > LATEST_NS:
            raise TrajectoryError(f"{row.where}: {row.cells[0]} is no time, in s, ms, us or ns")
    return np.array(times, np.int64)


def stamps_ns(rows: list[Row], values: Array) -> NDArray[np.int64]:
    """Stamps of a whole file in s, or in ms, us or ns since 1970, which are too large for s."""
    largest = float(np.abs(values).max())
    if largest < LARGEST_SECONDS:
        return _times(rows, NS_PER_S)
    for unit_ns in (1_000_000, 1_000, 1):
        if largest * unit_ns < min(LARGEST_SECONDS * NS_PER_S, np.iinfo(np.int64).max):
            return _times(rows, unit_ns)
    raise TrajectoryError(f"{rows[0].where}: {largest:g} is no time, in s, ms, us or ns")
