"""`replay`: publishes a recording again, for `watch`, `foxglove` and other subscribers.

It replaces the robot: it has its stages' liveliness tokens, and answers queries as they did.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import compose, ending, messages, records, terminal
from zloam_monitor.failures import Misuse
from zloam_monitor.keys import TILES, Keys
from zloam_monitor.link import open_session
from zloam_monitor.recordings import Refused
from zloam_monitor.recordings.robot_log import Extent, Logged, RobotLog
from zloam_monitor.records import PoseRecord
from zloam_monitor.terminal import ProgressLine
from zloam_monitor.watch import STALE_SECONDS

STATUS, CONFIG = "zloam.msg.Status", "zloam.msg.EffectiveConfig"
REVISION, TILE, POSE = "zloam.msg.ConfigRevision", "zloam.msg.MapTile", "zloam.msg.MapPose"
PATH = "zloam.msg.Path"
#: When the replay begins later, of these messages before its begin all changes, the newest
#: configurations and tiles, and the path come first.
STANDING = (REVISION, CONFIG, TILE, POSE, PATH)
#: Time in which links come up, to the robot if it is present and to programs that wait.
LINK_SECONDS = 1.0
LOOK_SECONDS = 0.2


@dataclass(frozen=True)
class Options:
    """Options of a replay."""

    path: Path
    #: 1: as recorded.
    rate: float = 1.0
    #: Part of the recording, in seconds since its begin.
    begin_s: float = 0.0
    end_s: float | None = None
    #: Name for the robot; empty: the recorded one.
    robot: str = ""
    connect: tuple[str, ...] = ()
    listen: str = ""


class _Path:
    """The mapped poses of a run in one map, as mapping answers with them."""

    def __init__(self) -> None:
        #: Run and map.
        self._of = (0, 0)
        self._rows = bytearray()
        self._last = -1

    def extend(self, pose: PoseRecord) -> None:
        at = (tuple(pose.translation), tuple(pose.quaternion))
        row = np.array([(pose.instant_ns, pose.sweep, at)], messages.STAMPED_POSE)
        self._add(pose.run, pose.map_id, row)

    def begin(self, payload: bytes) -> None:
        """The path from before the recording. It may be logged after poses that it contains, and
        after later ones, which were mapped while it was on its way."""
        run, rows = records.path(payload)
        header = messages.header_of(payload)
        of = run, 0 if header is None else header.MapId()
        if of != self._of:
            self._add(*of, rows)
            return
        there = self._poses()
        self._rows, self._last = bytearray(), -1
        self._add(*of, rows)
        self._add(*of, there)

    def _add(self, run: int, map_id: int, rows: NDArray[Any]) -> None:
        if (run, map_id) != self._of:
            self._of, self._rows, self._last = (run, map_id), bytearray(), -1
        new = rows[rows["sweep"].astype(np.int64) > self._last]
        if len(new):
            self._rows += new.tobytes()
            self._last = int(new["sweep"][-1])

    def _poses(self) -> NDArray[Any]:
        return np.frombuffer(bytes(self._rows), messages.STAMPED_POSE)

    def message(self) -> bytes:
        run, map_id = self._of
        return compose.path(compose.HeaderValues(run, 0, 0, map_id=map_id), self._poses())


class Stand:
    """The session that publishes and answers in place of the robot."""

    def __init__(self, log: RobotLog, options: Options) -> None:
        about = log.about
        if about is None:
            raise Refused("it is no recording of `zloam record`: zloam demo --bag replays others")
        self._recorded = about["robot"]
        self.keys = Keys(options.robot or about["robot"], about.get("sensor", "lidar"))
        self.session = open_session(list(options.connect), options.listen)
        self._alone()
        self._newest: dict[str, bytes] = {}
        #: Key and payload of each change.
        self._changes: dict[tuple[str, bytes], None] = {}
        #: Mapped poses before this time are not published, but part of the path.
        self.begin_ns = 0
        self._path = _Path()
        self._tokens: dict[tuple[str, str], Any] = {}
        #: (stage, instance) with a token -> time of its newest status; None: none has come yet.
        self._heard_ns: dict[tuple[str, str], int | None] = {}
        self._encodings = {
            f"zloam.msg.{table}": messages.encoding(table) for table in messages.KINDS
        }
        #: The map so far, by its tiles' keys: the views query it.
        self._tiles: dict[str, bytes] = {}
        self._map_id: int | None = None
        keys = self.keys
        answered = (
            keys.every_status,
            keys.every_config,
            keys.every_revision,
            keys.tiles,
            keys.path_map,
        )
        self._queryables = [self.session.declare_queryable(k, self._answer) for k in answered]
        self.published = 0
        #: Tiles without which no key can be made.
        self.unreadable = 0

    def _alone(self) -> None:
        """Refuses if the robot itself is present, as messages of the two would be mixed."""
        deadline = time.monotonic() + LINK_SECONDS
        while time.monotonic() < deadline:
            replies = self.session.liveliness().get(self.keys.every_alive, timeout=LINK_SECONDS)
            if any(reply.ok is not None for reply in replies):
                self.session.close()
                raise Refused(
                    f"robot {self.keys.robot} is there and alive: give the recording another name "
                    "by --robot"
                )
            time.sleep(0.1)

    def close(self) -> None:
        self.session.close()

    def put(self, logged: Logged) -> None:
        """Publishes a message on its key below the robot's name."""
        try:
            key = self._key(logged)
        except messages.DECODE_ERRORS:
            # A recorder writes all that comes on the robot's keys, also what a stranger publishes.
            self.unreadable += 1
            return
        if key is None:
            return
        if logged.schema == REVISION:
            self._changes[key, logged.payload] = None
        if logged.schema in (STATUS, CONFIG):
            self._newest[key] = logged.payload
            self._declare(key, logged.log_ns if logged.schema == STATUS else None)
        if key == self.keys.map_odometry and logged.log_ns < self.begin_ns:
            return
        if logged.schema != CONFIG:  # Stages only answer queries with it.
            self.session.put(key, logged.payload, encoding=self._encodings.get(logged.schema, ""))
        self.published += 1

    def _key(self, logged: Logged) -> str | None:
        """The key of a message; None: a topic of the scene, not a message of the robot."""
        begin = f"loam/{self._recorded}/"
        if not logged.topic.startswith(begin):
            return None
        rest = logged.topic.removeprefix(begin)
        if rest == TILES:
            return self._kept_tile(logged.payload)
        key = self.keys.below(rest)
        with contextlib.suppress(*messages.DECODE_ERRORS):  # A stranger's.
            if key == self.keys.map_odometry:
                self._path.extend(records.map_pose(logged.payload))
            elif key == self.keys.path_map:
                self._path.begin(logged.payload)
        # Stages only answer queries with a path.
        return None if key == self.keys.path_map else key

    def _kept_tile(self, payload: bytes) -> str:
        """Keeps a tile of the map for queries; returns its key. The first tile of another map ends
        the one before."""
        tile = records.tile(payload)
        key = self.keys.tile(tile.layer, tile.index)
        if tile.map_id != self._map_id:
            self._map_id = tile.map_id
            self._tiles = {}
        self._tiles[key] = payload
        return key

    def _declare(self, key: str, status_ns: int | None) -> None:
        """Declares an instance's token, for the key of its status or configuration. One whose
        statuses end has ended: the token goes, as it did then."""
        who = _instance(key)
        if who is None:
            return
        if who not in self._tokens:
            token = self.keys.below(f"service/{who[0]}/{who[1]}/alive")
            self._tokens[who] = self.session.liveliness().declare_token(token)
        self._heard_ns.setdefault(who, None)
        if status_ns is None:
            return
        self._heard_ns[who] = status_ns
        for other, heard_ns in list(self._heard_ns.items()):
            if heard_ns is None:
                self._heard_ns[other] = status_ns
            elif status_ns - heard_ns > 1e9 * STALE_SECONDS:
                self._tokens.pop(other).undeclare()
                del self._heard_ns[other]

    def _answer(self, query: Any) -> None:
        if query.key_expr.intersects(_expression(self.keys.path_map)):
            query.reply(self.keys.path_map, self._path.message())
        for key, payload in [*self._newest.items(), *self._changes, *self._tiles.items()]:
            ended = (who := _instance(key)) is not None and who not in self._tokens
            if not ended and query.key_expr.intersects(_expression(key)):
                query.reply(key, payload)


def _instance(key: str) -> tuple[str, str] | None:
    """(stage, instance) of the key of a status or configuration; None: another key."""
    parts = key.split("/")
    return (parts[-3], parts[-2]) if "service" in parts else None


def _expression(key: str) -> Any:
    import zenoh

    return zenoh.KeyExpr(key)


def _from(
    log: RobotLog, begin_ns: int, end_ns: int, goes_on: Callable[[], bool]
) -> Iterator[Logged]:
    """The standing messages before begin_ns, then all messages until end_ns."""
    standing: dict[tuple[str, bytes], Logged] = {}
    tiles: dict[tuple[str, tuple[int, int, int]], Logged] = {}
    map_id: int | None = None
    for logged in log.found(STANDING, end_ns=begin_ns):
        if not goes_on():
            return
        if logged.schema in (POSE, PATH):
            # At once, as there may be many.
            if logged.topic.endswith(("/map/odometry", "/path/map")):
                yield logged
            continue
        if logged.schema != TILE:
            standing[logged.topic, logged.payload if logged.schema == REVISION else b""] = logged
            continue
        try:
            tile = records.tile(logged.payload)
        except messages.DECODE_ERRORS:
            continue
        # As in every view, the first tile of another map ends the one before.
        if tile.map_id != map_id:
            map_id = tile.map_id
            tiles.clear()
        tiles[(tile.layer, tile.index)] = logged
    yield from standing.values()
    yield from tiles.values()
    yield from log.found(begin_ns=begin_ns, end_ns=end_ns + 1)


def _span(extent: Extent, options: Options) -> tuple[int, int]:
    """Begin and end of the wanted part in ns; raises Misuse if nothing lies between them."""
    if any(map(math.isnan, (options.rate, options.begin_s, options.end_s or 0.0))):
        raise Misuse("--rate, --from and --to: numbers are expected, not nan")
    # Limited first, as a user may write `inf`, of which no integer can be made.
    begin_ns = extent.begin_ns + round(1e9 * min(extent.seconds, options.begin_s))
    end_ns = extent.end_ns
    if options.end_s is not None:
        end_ns = extent.begin_ns + round(1e9 * max(0.0, min(extent.seconds, options.end_s)))
    if begin_ns >= end_ns:
        raise Misuse(
            f"{options.path} is {extent.seconds:.1f} s long: nothing lies from "
            f"{options.begin_s:g} s to {1e-9 * (end_ns - extent.begin_ns):g} s"
        )
    return begin_ns, end_ns


def replay(options: Options) -> int:
    """Replays a recording until its end or Ctrl-C; returns 1 if something in it was unreadable."""
    log = RobotLog(options.path)
    extent = log.extent()
    begin_ns, end_ns = _span(extent, options)
    stand = Stand(log, options)
    stand.begin_ns = begin_ns
    try:
        with ending.until_told() as goes_on:
            print(f"robot {stand.keys.robot} at {options.listen}; Ctrl-C ends", flush=True)
            found = _from(log, begin_ns, end_ns, goes_on)
            _publish(stand, found, options, (extent.begin_ns, begin_ns), goes_on)
    finally:
        stand.close()
    terminal.last_words(f"{stand.published} messages published")
    remarks = list(log.remarks)
    if stand.unreadable:
        remarks.append(f"{stand.unreadable} tiles could not be read: they are left out")
    for remark in remarks:
        terminal.last_words(remark)
    return 1 if remarks else 0


def _publish(
    stand: Stand,
    logged: Iterator[Logged],
    options: Options,
    begins_ns: tuple[int, int],
    goes_on: Callable[[], bool],
) -> None:
    """Publishes at the recording's times. begins_ns: begin of the recording, which the shown time
    counts from, and begin of the replay."""
    line = ProgressLine()
    whole_ns, begin_ns = begins_ns
    began: float | None = None
    for each in logged:
        # Begin the time at the first message of the part, as finding it takes time.
        if began is None and each.log_ns >= begin_ns:
            began = time.monotonic()
        due = (began or 0.0) + 1e-9 * max(0, each.log_ns - begin_ns) / options.rate
        while goes_on() and (left := due - time.monotonic()) > 0:
            time.sleep(min(left, LOOK_SECONDS))
        if not goes_on():
            break
        stand.put(each)
        line.show(f"{1e-9 * (each.log_ns - whole_ns):.1f} s, {stand.published} messages")
    line.end()
