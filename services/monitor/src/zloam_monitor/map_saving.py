"""`map save`: queries the map of a running robot over Zenoh and writes it on this machine."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from zloam_monitor import clouds, maps
from zloam_monitor.link import BUSY_SECONDS, PATIENCE_SECONDS, Link
from zloam_monitor.map_copy import MapCopy
from zloam_monitor.maps import MapError, PointMap
from zloam_monitor.settings import in_force

#: Pause between queries: links to the stages come up one after the other, and a busy robot may fail
#: to answer.
PAUSE_S = 0.2
#: Limit on one attempt to get the tiles: on a slow link they take minutes.
ATTEMPT_S = 600.0
#: Keys of mapping's configuration that determine the points of the map.
PARAMETERS = ("mapping.tile_edge_m", "mapping.leaf_edge_m", "mapping.leaf_plane_m")


@dataclass(frozen=True)
class Saved:
    """Description of the file that was written."""

    file: Path
    robot: str
    points: int
    tiles: int
    seconds: float
    map_id: int
    #: Newest sweep in the map when it was queried.
    sweep: int | None
    #: Points that the map had at least, by mapping's status. None: mapping did not say, and a part
    #: of the map may be missing.
    points_of_map: int | None
    #: Texts about what the format does not hold.
    losses: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """Text for a person."""
        until = "" if self.sweep is None else f", up to sweep {self.sweep} or later"
        what = f"{self.points} points of {self.tiles} tiles"
        said = [f"{self.file}: {what} in {self.seconds:.1f} s{until}", *self.losses]
        if self.points_of_map is None:
            said.append("  mapping did not say how many points its map has: a part may be missing")
        return said


@dataclass(frozen=True)
class Told:
    """The map by mapping's status, before it is queried."""

    #: Newest sweep in it.
    sweep: int | None = None
    #: Number of points, the least that the map must have, as it does not shrink.
    points: int | None = None
    #: A mapping without a sweep may have no point yet; a tile store without mapping has some.
    least: int = 1


def save(link: Link, to: Path, voxel_m: float | None) -> Saved:
    """Saves the map; raises, and writes nothing, if there is no map or a part of it is missing."""
    began = time.monotonic()
    deadline = began + BUSY_SECONDS
    told = _told(link, began + PATIENCE_SECONDS, deadline)
    tiles = _whole(link, told.least, deadline)
    found = PointMap(*clouds.merged(tiles))
    if voxel_m is not None:
        found = maps.thinned(found, voxel_m)
    map_id = tiles[0].map_id
    maps.write(to, found, _notes(link, map_id, told.sweep, voxel_m))
    took_s = time.monotonic() - began
    robot, count = link.keys.robot, len(found)
    losses = tuple(maps.losses(to, found))
    return Saved(to, robot, count, len(tiles), took_s, map_id, told.sweep, told.points, losses)


def _told(link: Link, patience: float, deadline: float) -> Told:
    """Waits for mapping's token until `patience`, and for its status, if it lives, until
    `deadline`."""
    while True:
        link.query_statuses()
        status, lives = link.stage("mapping"), "mapping" in link.living()
        if lives and status is not None:
            points = status.figures.get("map_points")
            least = 0 if status.last_sweep is None else 1
            if points is None:
                return Told(status.last_sweep, None, least)
            return Told(status.last_sweep, int(points), int(points))
        now = time.monotonic()
        if lives and now > deadline:
            raise MapError(
                "mapping lives but does not say how many points its map has: nothing is written; "
                "save again"
            )
        if not lives and now > patience:
            return Told()  # The tile store may still answer.
        time.sleep(PAUSE_S)


def _whole(link: Link, least: int, deadline: float) -> list[clouds.Tile]:
    """All tiles, got as views get them: answers that may not be dropped hold up the robot before a
    slow link."""
    copy = MapCopy(link)
    while True:
        unread = -link.garbage
        tiles = [tile for tile in copy.gather(ATTEMPT_S) if len(tile.points)]
        unread += link.garbage
        count = sum(len(tile.points) for tile in tiles)
        whole = count >= least and not unread and not copy.lacking
        if whole or time.monotonic() > deadline:
            break
        time.sleep(PAUSE_S)
    if unread:
        raise MapError(f"{unread} tiles of the map can't be read: nothing is written; save again")
    if copy.lacking:
        raise MapError(
            f"{copy.lacking} tiles of the map did not come: nothing is written; save again, or on "
            "the robot's own machine (zloam save)"
        )
    if count == 0:
        raise MapError("there is no map yet: neither mapping nor a store has points of it")
    if count < least:
        raise MapError(
            f"only {count} of {least} points came: nothing is written; save again, or on the "
            "robot's own machine (zloam save)"
        )
    return tiles


def _notes(link: Link, map_id: int, sweep: int | None, voxel_m: float | None) -> list[str]:
    said = [
        f"robot: {link.keys.robot}",
        "frame: map, m; base_link at the map's first sweep",
        f"map_id: {map_id}",
    ]
    said += [f"sweep: {sweep}"] if sweep is not None else []
    said += [f"voxel_m: {voxel_m:g}"] if voxel_m is not None else []
    if "mapping" in link.living():
        values = in_force(link, "mapping", "mapping")["mapping"]
        said += [f"{key}: {values[key]}" for key in PARAMETERS if key in values]
    return said
