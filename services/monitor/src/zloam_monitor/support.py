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
from typing import Any

from zloam_monitor.files import written_whole
from zloam_monitor.version import version

#: Files of a run's folder that are included.
TOLD = ("report.json", "logs/*.log")
#: Keys of the report that say where a robot was, or how far it went; they are removed.
GEOMETRY = ("path_m",)
#: Of a longer log, only the end is included.
MOST_LOG_BYTES = 5_000_000


class SupportError(ValueError):
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
    try:
        values = json.loads(report.read_text())
    except ValueError:
        return report.read_text(errors="replace")
    return json.dumps({k: v for k, v in values.items() if k not in GEOMETRY}, indent=1)


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
    if len(found) < 2:
        raise SupportError(f"{run}: neither report.json nor logs are in it, and no robot answers")
    with written_whole(out, "wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in found:
            made.writestr(name, content)
    return [name for name, _ in found]


def live(endpoints: list[str]) -> list[dict[str, Any]]:
    """Statuses and configurations of the robots that answer."""
    from zloam_monitor import discovery

    told = []
    for found in discovery.robots(endpoints):
        with discovery.linked(found.robot, [found.endpoint]) as link:
            link.query_statuses()
            statuses = {k: dataclasses.asdict(v) for k, v in link.newest_statuses().items()}
            told.append(
                {
                    "robot": found.robot,
                    "endpoint": found.endpoint,
                    "stages": found.stages,
                    "statuses": statuses,
                    "configurations": link.query_configs(),
                }
            )
    return told
