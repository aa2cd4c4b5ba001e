"""Maps that runs have stored in folders (--map), processed by zloam-sessions: merges several maps
by the places that they share, or closes the loops of one."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zloam_monitor import maps
from zloam_monitor.chain import binary
from zloam_monitor.failures import Explained, Misuse
from zloam_monitor.files import written_whole
from zloam_monitor.processes import describe_code

POINTS, GRAPH, REPORT = "map.pcd", "graph.g2o", "sessions.json"
#: Exit code if a map shares too little with the others, or is damaged.
INCOMPLETE = 1


class SessionsError(Explained):
    """A map cannot be read or merged; zloam-sessions has said why."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.exit_code = code if code > 0 else 1


@dataclass(frozen=True)
class Merged:
    """Results of zloam-sessions."""

    folder: Path
    report: dict[str, Any]
    complete: bool


def merge(build: Path, folders: Sequence[Path], out: Path, quiet: bool) -> Merged:
    """Merges maps; messages of zloam-sessions go to this program's standard error."""
    command = [str(binary(build, "sessions")), *map(str, folders), "--out", str(out)]
    done = subprocess.run([*command, *(["--quiet"] if quiet else [])], check=False)
    if done.returncode not in (0, INCOMPLETE):
        said = "nothing was written"
        if done.returncode < 0:
            said = f"zloam-sessions ended with {describe_code(done.returncode)}: no map was written"
        raise SessionsError(said, done.returncode)
    report = json.loads((out / REPORT).read_text(encoding="utf-8"))
    return Merged(out, report, done.returncode == 0)


@contextmanager
def opened(build: Path, folder: Path) -> Iterator[Merged]:
    """One map with its loops closed; the files are removed after the block."""
    with tempfile.TemporaryDirectory() as scratch:
        yield merge(build, [folder], Path(scratch), quiet=True)


def lines(merged: Merged) -> list[str]:
    """Text for a person."""
    said = []
    for session in merged.report["sessions"]:
        seconds = 1e-9 * (session["to_ns"] - session["from_ns"])
        said.append(
            f"{session['folder']}: {session['submaps']} submaps, {session['way_m']:.0f} m of way "
            f"in {seconds:.0f} s, {session['points']} points"
        )
        if session["damaged"]:
            said.append(
                f"  damaged: {session['unread_bytes']} bytes and {session['unread_files']} files "
                f"of it can't be read; records of an unknown format: {session['unread_records']}"
            )
        if not session["joined"]:
            said.append("  not joined: it shares too little with the others")
        elif len(merged.report["sessions"]) > 1:
            x, y, z = session["T_world_map"]["xyz_m"]
            said.append(f"  its origin lies at {x:.2f}, {y:.2f}, {z:.2f} m")
    loops = merged.report["loops"]
    between = sum(each["from_session"] != each["to_session"] for each in loops)
    said.append(f"loops: {len(loops)}, {between} of them between two maps")
    return said


#: Extension -> file of zloam-sessions that is copied.
COPIED = {".g2o": GRAPH, ".tum": "submaps_1.tum"}


def exportable(to: Path, voxel_m: float | None) -> None:
    """Raises if nothing could be written, so that a command can refuse before its work."""
    if to.suffix.lower() not in (*maps.WRITERS, *COPIED):
        raise Misuse(f"{to}: {', '.join((*maps.WRITERS, '.g2o'))} or .tum is expected")
    if voxel_m is None:
        return
    if to.suffix.lower() in COPIED:
        raise Misuse(f"--voxel: {to} gets poses, not points; leave it out")
    maps.check_voxel(voxel_m)


def export(merged: Merged, to: Path, voxel_m: float) -> str:
    """Writes the format of the extension, which is exportable; returns a text about the contents.
    Points: one per voxel of this edge."""
    if name := COPIED.get(to.suffix.lower()):
        with (merged.folder / name).open("rb") as made, written_whole(to, "wb") as out:
            shutil.copyfileobj(made, out)
        return f"{merged.report['sessions'][0]['submaps']} poses"
    points = maps.thinned(maps.read(merged.folder / POINTS), voxel_m)
    maps.write(to, points)
    return "\n".join([f"{len(points)} points", *maps.losses(to, points)])
