"""Folders of clouds, one sweep per file: PCD, PLY, LAS and LAZ."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.point_files import READERS
from zloam_monitor.recordings import Refused, bags, first_line
from zloam_monitor.recordings.bags import Bag, Topic

#: Stamp of the first cloud if nothing says when the clouds were recorded.
FIRST_NS = 1_000_000_000 * 10**9
#: Number of digits of a time since 1970 -> its unit in ns.
EPOCH_NS = {10: 10**9, 13: 10**6, 16: 10**3, 19: 1}
FEWEST_DIGITS = min(EPOCH_NS)
#: Files with one time per cloud, in the folder or above it.
STAMP_FILES = ("times.txt", "timestamps.txt", "stamps.txt")
#: Farther than any lidar's range; larger coordinates are those of a map.
FARTHEST_M = 10_000.0


@dataclass(frozen=True)
class Table:
    """Points of one file, structured by the names of its fields; size of an organised cloud."""

    stamp_ns: int
    points: NDArray[Any]
    width: int
    height: int


def clouds_in(path: Path) -> list[Path]:
    """Clouds of a folder, sorted by the numbers in their names; hidden files are ignored."""
    if not path.is_dir():
        return []
    found = [p for p in path.iterdir() if p.suffix.lower() in READERS and p.name[0] != "."]
    return sorted(found, key=lambda p: (_numbers(p.stem), p.name))


def _numbers(stem: str) -> list[int]:
    """A time in s with decimals is one number: of 0.25 and 0.5, as Python prints them, the first
    has the greater decimals. Behind another sign they may be ns without leading zeros."""
    time = time_ns(stem) if re.search(r"\d\.\d+$", stem) else None
    return [int(n) for n in re.findall(r"\d+", stem)] if time is None else [time]


def is_recording(path: Path) -> bool:
    return bags.is_recording(path) or bool(clouds_in(path))


def time_ns(text: str) -> int | None:
    """Time since 1970 in ns; the unit (s, ms, us, ns, s with a fraction) follows from the number of
    digits. None: no time. Numbers of scans have leading zeros (KITTI's have ten digits), times have
    none."""
    match = re.fullmatch(r"\D*?([1-9]\d{9,18})(?:[._-](\d{1,9}))?", text)
    if match is None or len(match[1]) not in EPOCH_NS:
        return None
    whole = int(match[1]) * EPOCH_NS[len(match[1])]
    if match[2] is None:
        return whole
    return whole + int(match[2].ljust(9, "0")) if len(match[1]) == 10 else None


def _times_in_names(paths: list[Path]) -> list[int] | None:
    times = [time_ns(p.stem) for p in paths]
    return None if None in times else [t for t in times if t is not None]


def _times_in_file(folder: Path, count: int) -> tuple[Path, list[int]] | None:
    for name in STAMP_FILES:
        for path in (folder / name, folder.parent / name):
            if path.is_file():
                lines = _utf8(path).split()
                if len(lines) != count:
                    raise Refused(f"{path} has {len(lines)} times for {count} clouds")
                try:
                    return path, [time_ns(t) or _number_ns(t) for t in lines]
                except ValueError as error:
                    raise Refused(f"{path}: {error}") from error
    return None


def _number_ns(text: str) -> int:
    """Time since 1970 as any number, such as 1.4036e+09 of numpy.savetxt; or, with fewer digits
    before the point than such a time has, seconds since the recording's start."""
    try:
        number = Decimal(text)
    except InvalidOperation:
        number = Decimal("nan")
    digits = number.adjusted() + 1 if number.is_finite() else FEWEST_DIGITS + 1
    if digits < FEWEST_DIGITS:
        return FIRST_NS + round(number * 10**9)
    if digits not in EPOCH_NS or number < 0:
        raise ValueError(f"{text} is no time")
    return round(number * EPOCH_NS[digits])


def _utf8(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise Refused(f"{path}: is not UTF-8 text, as which it must be saved") from error


def _times_by_number(paths: list[Path], period_ns: int) -> list[int]:
    """Times from the numbers in the names: a missing file leaves a gap, but a regular step, as of
    every n-th file of a recording, counts as one period."""
    numbers = [re.findall(r"\d+", p.stem) for p in paths]
    if not all(numbers):
        return [FIRST_NS + i * period_ns for i in range(len(paths))]
    last = [int(n[-1]) for n in numbers]
    step = max(1, int(np.median(np.diff(last)))) if len(last) > 1 else 1
    return [FIRST_NS + (n - last[0]) * period_ns // step for n in last]


@dataclass
class Folder:
    """A folder with the interface of a bag that has one topic."""

    path: Path
    period_ns: int
    #: Text that says what the stamps are taken from.
    said: str = ""
    #: The stamps are assumed, as nothing says when the clouds were recorded.
    assumed: bool = False
    unread: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._paths = clouds_in(self.path)
        self.topics = [
            Topic(self.path.resolve().name, f"{self._paths[0].suffix[1:]} files", len(self._paths))
        ]
        self._stamps = self._stamped()
        if (np.diff(self._stamps) <= 0).any():
            raise Refused(f"the clouds' times do not ascend ({self.said})")

    def _stamped(self) -> list[int]:
        if (times := _times_in_names(self._paths)) is not None:
            self.said = "stamps by the files' names"
            return times
        if (found := _times_in_file(self.path, len(self._paths))) is not None:
            self.said = f"stamps by {found[0].name}"
            return found[1]
        self.assumed = True
        self.said = (
            f"no stamps: neither names that are times nor {', '.join(STAMP_FILES)}; a cloud every "
            f"{1e-9 * self.period_ns:g} s is taken (driver.scan_period_s)"
        )
        return _times_by_number(self._paths, self.period_ns)

    def choose(self, name: str) -> Topic:
        if name not in ("", self.topics[0].name):
            raise Refused(f"driver.topic={name}: a folder of files has no topics")
        return self.topics[0]

    def choose_imu(self, name: str) -> str:
        raise Refused(
            f"a folder of files has no inertial readings{f' {name}' if name else ''}: name a file "
            "of them (driver.imu=file, driver.imu_path)"
        )

    def messages(self, topic: Topic, imu: str = "") -> Iterator[Any]:
        """Clouds in their order; unreadable files are left out and reported by remarks()."""
        assert topic in self.topics
        assert not imu
        self.unread.clear()
        for path, stamp_ns in zip(self._paths, self._stamps, strict=True):
            try:
                points, width, height = READERS[path.suffix.lower()](path)
            except Exception as error:  # Each library has error types of its own.
                self.unread.append(f"{path.name}: {first_line(error)}")
                continue
            yield Table(stamp_ns, _within_reach(points, path), width, height)
        if len(self.unread) == len(self._paths):
            raise Refused(f"none of its files can be read; {self.unread[0]}")

    def remarks(self) -> list[str]:
        """Texts about irregularities; complete after the last message."""
        said = [self.said] if self.assumed else []
        if not self.unread:
            return said
        more = f", and {len(self.unread) - 1} more" if len(self.unread) > 1 else ""
        return [*said, f"left out, as it can't be read: {self.unread[0]}{more}"]


def _within_reach(points: NDArray[Any], path: Path) -> NDArray[Any]:
    """Refuses a map by its middle coordinates: a single far point is an error of the sensor."""
    names = points.dtype.names or ()
    for name in ("x", "y", "z"):
        if name not in names:
            continue
        far = np.abs(points[name].astype(np.float64))
        far = far[np.isfinite(far)]
        if len(far) and (middle := float(np.median(far))) > FARTHEST_M:
            raise Refused(
                f"{path.name}: half of its points have {name} beyond {middle:.0f} m: these are "
                "coordinates of a map, and not of the sensor, or not in metres"
            )
    return points


@contextmanager
def opened(path: Path, period_s: float) -> Iterator[Bag | Folder]:
    """Opens a folder of clouds, or a bag; raises Refused or OSError."""
    if clouds_in(path):
        yield Folder(path, round(1e9 * period_s))
        return
    with bags.opened(path) as bag:
        yield bag
