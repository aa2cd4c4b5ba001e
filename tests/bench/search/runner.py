"""Runs zloam-offline over drives, two at a time, and judges each."""

from __future__ import annotations

import concurrent.futures
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.acceptance.framework import Skip
from tests.bench.search import judge
from tests.bench.search.judge import Verdict
from tests.bench.search.sets import DataSet, Places, ran
from zloam_monitor import trajectory

JOBS = 2


@dataclass(frozen=True)
class Row:
    """The result of one drive; `failure` is the reason if there is no verdict."""

    name: str
    verdict: Verdict | None
    failure: str
    seconds: float


def folder_of(name: str) -> str:
    """Name of the folder for a drive's files."""
    return name.replace("/", "-every")


def run(data: DataSet, places: Places, binary: Path, out: Path, more: tuple[str, ...] = ()) -> Row:
    """Runs and judges one drive; an exception becomes the row's failure."""
    began = time.monotonic()
    found, failure = None, ""
    try:
        drive = data.make(places)
        folder = out / folder_of(data.name)
        ran(binary, drive.input, folder, *_options(drive.arguments), *_options(more))
        truth = trajectory.read(drive.truth or folder / "truth.tum")
        found = judge.verdict(folder, truth, data.open_direction)
    except Skip as skip:
        failure = f"skipped: {skip}"
    except Exception as error:
        failure = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    return Row(data.name, found, failure, time.monotonic() - began)


def _options(arguments: tuple[str, ...]) -> Iterator[str]:
    """Splits --set=KEY=VALUE into the two arguments that the program takes."""
    for argument in arguments:
        option, equals, value = argument.partition("=")
        yield option
        if equals:
            yield value


def run_all(sets: list[DataSet], each: Callable[[DataSet], Row], jobs: int = JOBS) -> Iterator[Row]:
    """The rows in the given order, each as soon as it is there."""
    with concurrent.futures.ThreadPoolExecutor(min(jobs, JOBS)) as pool:
        yield from pool.map(each, sets)


HEAD = (
    f"{'drive':<18} {'odom':>8} {'map':>8} {'fused':>8} {'worst':>7} | {'poses':>5} {'ok':>5} "
    f"{'degen':>5} {'pred':>4} {'lost':>4} {'othr':>4} {'jump':>4} | {'silent':>6} {'1st':>4} "
    f"{'by m':>7} {'vague':>5} {'false':>5} | {'reg':>5} {'odo':>5} {'map ms':>6}"
)


def line(row: Row) -> str:
    """The row for the terminal; * marks a fused pose above the limit of issue 36."""
    v = row.verdict
    if v is None:
        return f"{row.name:<18} {row.failure}"
    mark = " " if v.within_bound else "*"
    return (
        f"{row.name:<18} {v.odometry_m:8.4f} {v.map_m:8.4f} {v.fused_m:8.4f}{mark}{v.worst_m:7.3f} "
        f"| {v.poses:5d} {v.ok:5d} {v.degenerate:5d} {v.predicted:4d} {v.lost:4d} {v.other:4d} "
        f"{v.jumps:4d} | {v.silent:6d} {v.first_silent:4d} {v.worst_silent_m:7.3f} {v.vague:5d} "
        f"{v.false_flags:5d} | {v.registration_ms:5.2f} {v.odometry_ms:5.2f} {v.mapping_ms:6.2f}"
    )


def write_json(path: Path, rows: list[Row], binary: Path, more: tuple[str, ...]) -> None:
    """Writes all figures."""
    drives = [
        {"drive": r.name, "failure": r.failure, **(r.verdict.as_dict() if r.verdict else {})}
        for r in rows
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    said = {"binary": str(binary), "more": more, "drives": drives}
    path.write_text(json.dumps(said, indent=1) + "\n")
