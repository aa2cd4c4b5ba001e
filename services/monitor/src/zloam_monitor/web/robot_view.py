"""Contents of the page for one robot."""

from __future__ import annotations

import base64
import secrets
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import zenoh
from numpy.typing import NDArray

from zloam_monitor import doctor, se3, thin
from zloam_monitor.clouds import Tile
from zloam_monitor.heard import Finding
from zloam_monitor.latency import samples
from zloam_monitor.link import Link
from zloam_monitor.map_copy import MapCopy
from zloam_monitor.pose_health import position_sigma_m
from zloam_monitor.records import PoseRecord, StatusRecord, pose_health
from zloam_monitor.stages import ROWS, STAGES
from zloam_monitor.watch import STALE_SECONDS

#: Time for which the doctor listens for its findings.
LISTEN_SECONDS = 10.0
#: Time for what has changed in the map; what does not come within it comes with the next look.
MAP_SECONDS = 20.0
#: Interval of a thin view's findings, which use received messages only.
THIN_SECONDS = 1.0
#: close() waits at most this long for each of the view's threads: a stage may hang.
CLOSE_SECONDS = 5.0
#: A pose of this age is no longer current; the same as OLD_S in page.js.
OLD_SECONDS = 2.0
#: Time covered by the history of latency and rate.
HISTORY_SECONDS = 120
#: Limits on the points of the path and on the cells of the map; both are thinned to them.
MOST_PATH = 600
MOST_CELLS = 20_000
#: Possible edges of the map's cells, m; the first with few enough cells is used.
CELLS_M = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)


@dataclass(frozen=True)
class _Look:
    """What was heard of the robot until now. Times are of this host's monotonic clock."""

    pose: PoseRecord | None
    #: Time at which the newest pose came.
    posed_s: float
    path: list[list[float]]
    #: Stage -> its newest status, and when it came.
    stages: dict[str, tuple[StatusRecord, float]]


class RobotView:
    """Follows one robot in a thread of its own; state() and map_view() may be called from any
    thread. Another thread waits for answers, which may take minutes if a stage hangs."""

    def __init__(self, link: Link) -> None:
        self._link = link
        #: For queries: a link may be used by one thread only.
        self._asking = Link(link.session, link.keys, newest=0)
        self._copy = MapCopy(self._asking)
        self._lock = threading.Lock()
        self._ends = threading.Event()
        self._path: list[tuple[int, float, float]] = []
        self._every = 1
        self._newest = -1
        #: Map of the path, and the sweep after which its poses begin.
        self._map_id: int | None = None
        self._map_from = -1
        self._began_s = self._newest_s = time.monotonic()
        self._run: int | None = None
        self._history: deque[dict[str, Any]] = deque(maxlen=HISTORY_SECONDS)
        self._noted_s = 0.0
        self._findings: list[dict[str, Any]] = []
        self._judged = False
        self._looked = _Look(None, self._newest_s, [], {})
        # Begins with a random number: a page compares it with that of a previous view.
        self._map: dict[str, Any] = {"version": secrets.randbits(32), "cells": ""}
        self._asker: threading.Thread | None = None
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    @property
    def name(self) -> str:
        return self._link.keys.robot

    def close(self) -> None:
        self._ends.set()
        self._thread.join(CLOSE_SECONDS)
        if self._asker is not None:
            self._asker.join(CLOSE_SECONDS)

    def state(self) -> dict[str, Any]:
        """Ages are those at the call, so that what no longer moves is seen to be old."""
        now = time.monotonic()
        with self._lock:
            look = self._looked
            more = {
                "history": list(self._history),
                "map_version": self._map["version"],
                "findings": self._findings,
                "judged": self._judged,
            }
        return {**self._described(look, now), **more}

    def map_view(self) -> dict[str, Any]:
        with self._lock:
            return self._map

    def is_gone(self) -> bool:
        """No stage is heard: the robot has ended, or is to be reached in another way now."""
        with self._lock:
            stages = self._looked.stages
        newest_s = max([self._began_s, *(came_s for _, came_s in stages.values())])
        return time.monotonic() - newest_s > STALE_SECONDS

    def silence(self) -> str | None:
        """Advice if a thin view gets no preview; else None."""
        return thin.silence(self._link)

    def _follow(self) -> None:
        if self._link.thin:
            self._follow_thin()
            return
        # The first look compares with what the stages counted before.
        self._link.query_statuses()
        while not self._ends.is_set():
            hearing, answers = doctor.Hearing(self._link), self._asked()
            while self._look() and (hearing.seconds < LISTEN_SECONDS or not answers.done()):
                self._link.poll(0.2)
            if not self._ends.is_set():
                self._judge(self._found(hearing, answers))

    def _asked(self) -> Future[doctor.Answers]:
        """The answers that _ask() will have; its thread does not keep this program from ending."""
        answers: Future[doctor.Answers] = Future()

        def ask() -> None:
            try:
                answers.set_result(self._ask())
            except Exception as error:
                answers.set_exception(error)

        self._asker = threading.Thread(target=ask, daemon=True)
        self._asker.start()
        return answers

    def _ask(self) -> doctor.Answers:
        """Asks the robot for its map, and for what the doctor needs after LISTEN_SECONDS."""
        claims = self._asking.claims()
        self._draw_map(_points(self._copy.update(MAP_SECONDS)))
        if self._ends.wait(LISTEN_SECONDS):
            raise CancelledError
        return doctor.Answers.of(self._asking, claims)

    def _found(self, hearing: doctor.Hearing, answers: Future[doctor.Answers]) -> list[Finding]:
        heard = hearing.heard()
        try:
            said = answers.result()
        except zenoh.ZError as error:
            return [Finding(f"no query can be sent: {error}", "see the link to the robot")]
        except Exception as error:  # The robot is followed on.
            told = "".join(traceback.format_exception(error))
            print(f"{self.name}: an error in this program:\n{told}", file=sys.stderr, flush=True)
            return [
                Finding(f"its answers can't be judged: {error!r}", "see what zloam web printed")
            ]
        heard = replace(heard, garbage=heard.garbage + self._asking.garbage)
        return [*doctor.findings(said.added_to(heard, self._link.late)), *self._lacking()]

    def _lacking(self) -> Iterator[Finding]:
        if self._copy.lacking:
            yield Finding(
                f"{self._copy.lacking} tiles of the map have not come yet, or are not the newest",
                "the page asks for them again; over a thin link zloam web --thin shows all of it",
                is_fault=False,
            )

    def _follow_thin(self) -> None:
        link, drawn = self._link, -1
        while not self._ends.is_set():
            before, begun = dict(link.statuses), time.monotonic()
            while time.monotonic() - begun < THIN_SECONDS and self._look():
                link.poll(0.2)
            silent = thin.finding(link)
            heard = thin.heard(link, before, THIN_SECONDS)
            self._judge([*([silent] if silent else []), *doctor.findings_of_statuses(heard)])
            if link.preview.version != drawn:
                drawn = link.preview.version
                # Previews name their map, so one without blocks is of an empty map: after a reset.
                self._draw_map(link.preview.spread_points(), may_be_empty=True)

    def _judge(self, findings: list[Finding]) -> None:
        found = [{"what": each.what, "do": each.do, "fault": each.is_fault} for each in findings]
        with self._lock:
            self._findings, self._judged = found, True

    def _draw_map(self, xyz: NDArray[Any], may_be_empty: bool = False) -> None:
        """Updates the map; unless it may be empty, keeps the previous one if nobody answers."""
        drawn = _top_view(xyz)
        with self._lock:
            is_map = drawn["cells"] or may_be_empty
            if is_map and drawn["cells"] != self._map["cells"]:
                self._map = {**drawn, "version": self._map["version"] + 1}

    def _look(self) -> bool:
        """Updates what state() shows; called several times a second. False: the view ends."""
        self._extend_path()
        link, now = self._link, time.monotonic()
        stages = {s: (status, link.heard_s(status)) for s, status in link.newest_statuses().items()}
        path = [[x, y] for _, x, y in self._path]
        look = _Look(link.poses.last(), self._newest_s, path, stages)
        with self._lock:
            self._looked = look
            if now - self._noted_s >= 1.0:
                self._noted_s = now
                # The latency of an old pose is not the current one.
                timed = look.pose if now - look.posed_s <= OLD_SECONDS else None
                taken = _latency(timed, link.mapped.last())
                noted = {"stages": taken, "rate": link.posed.per_s(now)}
                self._history.append(noted)
        return not self._ends.is_set()

    def _extend_path(self) -> None:
        link = self._link
        if link.run != self._run:
            self._run, self._newest, self._map_id = link.run, -1, None
            self._begin_path(after=-1)
        self._follow_map()
        for sweep in sorted(n for n in link.poses if n > self._newest):
            self._newest, self._newest_s = sweep, time.monotonic()
            if sweep > self._map_from and sweep % self._every == 0:
                x, y, _ = link.poses[sweep].translation
                self._path.append((sweep, round(float(x), 2), round(float(y), 2)))
        while len(self._path) > MOST_PATH:
            self._every *= 2
            self._path = [point for point in self._path if point[0] % self._every == 0]

    def _follow_map(self) -> None:
        """Begins another path with another map, e.g. after `zloam reset`: its frame is another one.
        Fused poses do not name their map, so mapped poses tell. The fused pose of the new map's
        first sweep came before mapping had corrected it."""
        naming = self._link.poses if self._link.thin else self._link.mapped
        newest = naming.last()
        if newest is None or newest.map_id in (0, self._map_id):
            return
        if self._map_id is not None:
            self._begin_path(min(n for n, p in naming.items() if p.map_id == newest.map_id))
        self._map_id = newest.map_id

    def _begin_path(self, after: int) -> None:
        self._path.clear()
        self._every, self._map_from = 1, after

    def _described(self, look: _Look, now: float) -> dict[str, Any]:
        link = self._link
        rates = [link.taken.kb_s(now), self._asking.taken.kb_s(now)]
        known = [rate for rate in rates if rate is not None]
        return {
            "robot": self.name,
            "pose": _pose(look.pose) if look.pose is not None else None,
            "age_s": round(now - look.posed_s, 1),
            "rate": link.posed.per_s(now),
            "path": look.path,
            "stages": [_stage(stage, look.stages.get(stage), now) for stage in STAGES],
            "thin": link.thin,
            "kb_s": sum(known) if known else None,
        }


def _latency(pose: PoseRecord | None, mapped: PoseRecord | None) -> dict[str, float]:
    """Time of each stage for the newest pose, ms. A fused pose does not wait for mapping: that time
    is the newest mapped pose's, unless mapping no longer follows."""
    if pose is None:
        return {}
    is_current = (
        mapped is not None
        and mapped.run == pose.run
        and pose.instant_ns - mapped.instant_ns <= OLD_SECONDS * 1e9
    )
    whole, _ = samples([pose], [mapped] if mapped is not None and is_current else [])
    return {stage: round(times_ms[-1], 2) for stage, times_ms in whole.items()}


def _pose(pose: PoseRecord) -> dict[str, Any]:
    rotation = se3.matrices(pose.translation[None], pose.quaternion[None])[0]
    sigma_m = position_sigma_m(pose)
    return {
        "sweep": pose.sweep,
        "xyz": [round(float(v), 3) for v in pose.translation],
        "yaw_deg": round(float(np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))), 1),
        "health": pose_health(pose.health),
        "degenerate": pose.degenerate,
        "sigma_m": None if sigma_m is None else round(sigma_m, 4),
    }


def _stage(stage: str, heard: tuple[StatusRecord, float] | None, now: float) -> dict[str, Any]:
    """heard: the stage's newest status, and when it came."""
    said: dict[str, Any] = {"name": stage, "about": ROWS[stage].summary, "health": "silent"}
    if heard is None:
        return {**said, "reason": "nothing heard of it"}
    status, came_s = heard
    silent_s = max(0.0, now - came_s)
    stale = silent_s > STALE_SECONDS
    dropped = {r: n for each in status.inputs for r, n in each.dropped.items() if n}
    return {
        **said,
        "health": "silent" if stale else status.health,
        "reason": f"nothing heard for {silent_s:.0f} s" if stale else status.reason,
        "queued": sum(each.queued for each in status.inputs),
        "dropped": dropped,
        "memory_mib": round(status.rss_mib["end"]),
        "cpu_s": round(status.cpu_ms / 1000.0, 1),
    }


def _points(tiles: list[Tile]) -> NDArray[Any]:
    """Points of the tiles, as rows x, y, z."""
    points = [tile.points for tile in tiles if len(tile.points)]
    found = [np.stack([each[axis] for axis in ("x", "y", "z")], axis=-1) for each in points]
    return np.concatenate(found) if found else np.empty((0, 3))


def _top_view(xyz: NDArray[Any]) -> dict[str, Any]:
    """Cells of the map that contain points, seen from above. Each is three int16: x and y relative
    to the middle one of the cells, and the height range of its points, dm."""
    if len(xyz) == 0:
        return {"cells": "", "cell_m": CELLS_M[0], "origin": [0, 0]}
    for cell_m in CELLS_M:
        cells, high_m = _cells(xyz, cell_m)
        if len(cells) <= MOST_CELLS:
            break
    origin = cells[len(cells) // 2]
    near = (np.abs(cells - origin) < 2**15).all(axis=1)
    rows = np.column_stack([cells - origin, np.minimum(10.0 * high_m, 1000.0)])[near]
    packed = base64.b64encode(rows.astype("<i2").tobytes()).decode()
    return {"cells": packed, "cell_m": cell_m, "origin": [int(v) for v in origin]}


def _cells(xyz: NDArray[Any], cell_m: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices along x and y of cells that contain points, and the height range of each, m."""
    index = np.floor(xyz[:, :2] / cell_m).astype(np.int64)
    cells, of_point = np.unique(index, axis=0, return_inverse=True)
    lowest = np.full(len(cells), np.inf)
    highest = np.full(len(cells), -np.inf)
    np.minimum.at(lowest, of_point.ravel(), xyz[:, 2])
    np.maximum.at(highest, of_point.ravel(), xyz[:, 2])
    return cells, highest - lowest
