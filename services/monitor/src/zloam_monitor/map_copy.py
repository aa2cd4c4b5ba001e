"""A view's copy of a robot's map, at the pace of the link.

The answers to a query for all tiles leave the robot at once. Before a slow link they pile up, and
Zenoh then waits for seconds, and in the end closes the link of the stage that answers. A copy asks
for the tiles' versions first, and then for one changed tile after the other; what is dropped on
the way is missing until the next update.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

from numpy.typing import NDArray

from zloam_monitor.clouds import POINT_LAYERS, Tile
from zloam_monitor.link import STANDING_BY, Link
from zloam_monitor.records import StatusRecord

#: Parameter of the query for tiles without their points.
HEADS = "heads"
#: Time in which a view that starts gets the map.
START_S = 60.0


def lacks(tiles: int) -> str:
    """What a person should know of tiles that did not come; empty: nothing."""
    if tiles == 0:
        return ""
    return f"{tiles} tiles of the map did not come in time; each is shown when it changes"


def _mapping(link: Link) -> StatusRecord | None:
    """The present status of a living mapping; a router keeps those of ended ones, too."""
    living = link.living_instances()
    if not any(stage == "mapping" for stage, _ in living):
        return None
    found = [
        status
        for status in link.answering()
        if status.stage == "mapping" and (status.stage, status.instance) in living
    ]
    return max(found, key=lambda s: (s.reason != STANDING_BY, s.stamp_ns), default=None)


def tiles_told(link: Link) -> int:
    """The number of tiles that the map has at least, by mapping's status; 0: it does not say, or
    does not live."""
    status = _mapping(link)
    return 0 if status is None else int(status.figures.get("map_tiles", 0.0))


def has_path(link: Link) -> bool:
    """Whether mapping has mapped, so that it answers with a path."""
    status = _mapping(link)
    return status is not None and status.last_sweep is not None


class Scene(Protocol):
    """What a view draws the past into."""

    def keep_path(self, run: int, poses: NDArray[Any]) -> None:
        """Draws the path of the run so far."""

    def keep(self, tile: Tile) -> None:
        """Draws a tile of the map."""


def show_past(link: Link, scene: Scene) -> None:
    """Shows path and map from before a view's start, and prints what it lacks of them."""
    path = link.query_path()
    if path is not None:
        scene.keep_path(*path)
    copy = MapCopy(link)
    for tile in copy.gather(START_S):
        scene.keep(tile)
    # After `zloam reset` it comes, but has no poses.
    if path is None and has_path(link):
        print("the path so far did not come: it begins here", flush=True)
    if said := lacks(copy.lacking):
        print(said, flush=True)


class MapCopy:
    """The tiles of the newest map, as far as they came."""

    def __init__(self, link: Link, layers: Sequence[str] = POINT_LAYERS) -> None:
        self._link, self._layers = link, layers
        self._tiles: dict[tuple[str, tuple[int, int, int]], Tile] = {}
        self._map_id: int | None = None
        #: Tiles that are missing, or not the newest version, after the last update.
        self.lacking = 0

    def gather(self, seconds: float) -> list[Tile]:
        """For a view that looks once: as update(), and again while that brings what was dropped."""
        ends_s, before = time.monotonic() + seconds, math.inf
        tiles = self.update(seconds)
        while 0 < self.lacking < before and time.monotonic() < ends_s:
            before = self.lacking
            tiles = self.update(ends_s - time.monotonic())
        return tiles

    def update(self, seconds: float) -> list[Tile]:
        """Gets the tiles that have changed, for at most about `seconds`; returns all."""
        ends_s = time.monotonic() + seconds
        told = tiles_told(self._link)
        heads = [head for layer in self._layers for head in self._heads(layer)]
        if not heads:
            tiles = self._whole()
            self._keep(tiles)
            self.lacking = max(0, told - sum(tile.map_id == self._map_id for tile in tiles))
            return list(self._tiles.values())
        self._begin_again(heads)
        # Of an old robot, which has no heads, these are the tiles.
        self._keep([head for head in heads if len(head.points)])
        wanted = [head for head in heads if not len(head.points) and self._is_newer(head)]
        # Heads may be dropped on the way, too.
        self.lacking = len(wanted) + max(0, told - len({(h.layer, h.index) for h in heads}))
        for head in wanted:
            if time.monotonic() > ends_s:
                break
            key = self._link.keys.tile(head.layer, head.index)
            found = [tile for tile in self._link.tiles_at(key) if tile.map_id == head.map_id]
            self._keep(found)
            self.lacking -= not self._is_newer(head)
        return list(self._tiles.values())

    def _whole(self) -> list[Tile]:
        """All tiles at once, those of the newest map first: a store may have that before, too. A
        store without a mapping may be asked for them, as its robot does not run; where mapping
        lives, its heads were dropped, or it has none."""
        keys = self._link.keys
        if "mapping" not in self._link.living():
            found = self._link.query_tiles(self._layers)
        else:
            found = [t for each in self._layers for t in self._link.tiles_at(keys.tiles_of(each))]
        return sorted(found, key=lambda tile: tile.map_id, reverse=True)

    def _heads(self, layer: str) -> list[Tile]:
        return self._link.tiles_at(f"{self._link.keys.tiles_of(layer)}?{HEADS}")

    def _begin_again(self, heads: list[Tile]) -> None:
        """A mapping that was started again, or a replay that is repeated, has the same map with
        lower versions: what it does not name is left out, and all others are got again."""
        versions = {(h.layer, h.index): h.version for h in heads if h.map_id == self._map_id}
        kept = self._tiles
        if any(
            version < kept[which].version for which, version in versions.items() if which in kept
        ):
            self._tiles = {
                which: replace(tile, version=min(tile.version, versions[which] - 1))
                for which, tile in kept.items()
                if which in versions
            }

    def _is_newer(self, tile: Tile) -> bool:
        if tile.map_id != self._map_id:
            return True
        kept = self._tiles.get((tile.layer, tile.index))
        return kept is None or tile.version > kept.version

    def _keep(self, tiles: list[Tile]) -> None:
        """The map of the first one; another map than before begins a new copy."""
        for tile in tiles:
            if tile.map_id != tiles[0].map_id:
                continue
            if tile.map_id != self._map_id:
                self._map_id = tile.map_id
                self._tiles = {}
            if self._is_newer(tile):
                self._tiles[(tile.layer, tile.index)] = tile
