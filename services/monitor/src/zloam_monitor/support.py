"""Collects in one file what is needed to analyse a fault: report, logs, configuration, versions and
the machine. Poses, maps and pictures are left out, as they show the geometry of a place."""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from zloam_monitor.failures import FileTrouble
from zloam_monitor.files import written_whole
from zloam_monitor.link import LinkError
from zloam_monitor.messages import DECODE_ERRORS
from zloam_monitor.version import version

if TYPE_CHECKING:
    from zloam_monitor.discovery import Found

#: Files of a run's folder that are included.
TOLD = ("report.json", "logs/*.log")
#: Keys of the report that say where a robot was, or how far it went; they are removed.
GEOMETRY = ("path_m",)
#: Of a longer log, only the end is included.
MOST_LOG_BYTES = 5_000_000
#: What asking a robot may raise if it, or the link to it, ends meanwhile.
VANISHED: tuple[type[Exception], ...] = (LinkError, zenoh.ZError, *DECODE_ERRORS)


class SupportError(FileTrouble):
    """There is nothing to collect; the text says why."""


def _machine() -> dict[str, Any]:
    memory = Path("/proc/meminfo")
    total = memory.read_text().splitlines()[0].split(":")[1].strip() if memory.exists() else ""
    return {
        "zloam": version(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "processors": os.cpu_count(),
        "memory": total,
        "shared memory (bytes free)": _free("/dev/shm"),
        "UDP receive buffer, largest": _line("/proc/sys/net/core/rmem_max"),
    }


def _free(path: str) -> int:
    try:
        found = os.statvfs(path)
    except OSError:
        return 0
    return found.f_bavail * found.f_frsize


def _line(path: str) -> str:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""


def _without_geometry(report: Path) -> str:
    text = report.read_text(errors="replace")
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        values = None
    if isinstance(values, dict):
        return json.dumps({k: v for k, v in values.items() if k not in GEOMETRY}, indent=1)
    # A damaged report may be the fault itself: all of it but the lines with these keys.
    lines = text.splitlines(keepends=True)
    return "".join(line for line in lines if not any(key in line for key in GEOMETRY))


def _end_of(path: Path) -> bytes:
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - MOST_LOG_BYTES))
        return file.read()


def _entries(
    run: Path, config: Path | None, robots: list[dict[str, Any]]
) -> Iterator[tuple[str, bytes]]:
    yield "machine.json", json.dumps(_machine(), indent=1).encode()
    for pattern in TOLD:
        for path in sorted(run.glob(pattern)):
            name = str(path.relative_to(run))
            yield (
                name,
                _without_geometry(path).encode() if path.suffix == ".json" else _end_of(path),
            )
    if config is not None:
        yield f"robot/{config.name}", config.read_bytes()
    for number, robot in enumerate(robots):
        yield f"live/{number}.json", json.dumps(robot, indent=1, default=str).encode()


def write(
    out: Path, run: Path, config: Path | None = None, robots: list[dict[str, Any]] | None = None
) -> list[str]:
    """Writes the file; returns the names of its contents."""
    if not run.is_dir():
        raise SupportError(f"{run}: no such folder; the one that a run has left is expected")
    found = list(_entries(run, config, robots or []))
    if len(found) - len(failures(robots or [])) < 2:
        raise SupportError(f"{run}: neither report.json nor logs are in it, and no robot answers")
    with written_whole(out, "wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in found:
            made.writestr(name, content)
    return [name for name, _ in found]


def live(endpoints: list[str]) -> list[dict[str, Any]]:
    """Statuses and configurations of the robots that answer; in place of those that could not be
    asked there is an `error`, also if endpoints are named and nothing answers there."""
    from zloam_monitor import discovery

    wanted = [discovery.endpoint_of(each) for each in endpoints]
    if not wanted:
        return [_asked(found) for found in discovery.robots()]
    try:
        return [_asked(found) for found in discovery.present(wanted)]
    except discovery.NothingAnswers as error:
        return [{"endpoint": ", ".join(wanted), "error": str(error)}]


def failures(robots: list[dict[str, Any]]) -> list[str]:
    """Texts about the robots that could not be asked, or not completely."""
    return [
        f"{robot.get('robot', robot.get('endpoint'))}: {robot['error']}"
        for robot in robots
        if "error" in robot
    ]


def _asked(found: Found) -> dict[str, Any]:
    """One robot, which may vanish while it is asked."""
    from zloam_monitor import discovery

    told: dict[str, Any] = {
        "robot": found.robot,
        "endpoint": found.endpoint,
        "stages": found.stages,
    }
    try:
        with discovery.linked_to(found) as link:
            link.query_statuses()
            statuses = {k: dataclasses.asdict(v) for k, v in link.newest_statuses().items()}
            told |= {"statuses": statuses, "configurations": link.query_configs()}
            silent = sorted(link.unanswered)
    except VANISHED as error:
        return {**told, "error": str(error) or type(error).__name__}
    if not statuses:
        return {**told, "error": "it was found, but no stage gave its status"}
    if silent:
        return {**told, "error": f"no configuration came of {', '.join(silent)}"}
    return told
