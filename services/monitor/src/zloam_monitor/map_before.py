"""The map that a robot had when its recording began, as far as it comes.

Mapping publishes a tile when it changes. What lies behind the robot does not change any more, so a
recording asks for it: for one tile after the other, as a view does (map_copy.py), in a thread, so
that it goes on with what is published meanwhile.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterable

import zenoh

from zloam_monitor import messages, records
from zloam_monitor.clouds import POINT_LAYERS, Tile
from zloam_monitor.intake import Sample
from zloam_monitor.link import TILES_SECONDS, Link
from zloam_monitor.map_copy import HEADS, tiles_told

#: close() waits at most this long for the thread, which may wait for an answer.
CLOSE_SECONDS = 5.0


class MapBefore:
    """Hands the tiles over as answers. look() may wait for long: it may have a thread of its own,
    while the recorder's only calls published(). All others but begin() are for after begin()."""

    def __init__(self, link: Link, hand_over: Callable[[str, bytes], bool]) -> None:
        """`hand_over` takes an answer; false: it has no room for it now."""
        #: For queries: a link may be used by one thread only.
        self._link = Link(link.session, link.keys, newest=0)
        self._hand_over = hand_over
        #: The newest map, and key -> version of each tile that it had.
        self._newest = -1
        self._had: dict[str, int] = {}
        #: Tiles that came whole: of an older mapping, without heads.
        self._whole: dict[str, bytes] = {}
        #: Number of tiles of which not even that is known.
        self._unknown = 0
        #: Keys of the tiles that were handed over.
        self._come: set[str] = set()
        #: Keys of the tiles that are in the recording.
        self._there: set[str] = set()
        #: The newest map of which a tile was published.
        self._published = -1
        #: Until begin(): key -> map of each tile that was published.
        self._early: dict[str, int] | None = {}
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._ask, daemon=True)

    def look(self) -> None:
        """Asks which tiles there are."""
        told, before = tiles_told(self._link), -1
        ends_s = time.monotonic() + TILES_SECONDS
        # Heads may be dropped on the way, too.
        while before < len(self._had) and time.monotonic() < ends_s:
            before = len(self._had)
            for layer in POINT_LAYERS:
                for payload, tile in self._answers(f"{self._link.keys.tiles_of(layer)}?{HEADS}"):
                    self._note(payload, tile)
            if len(self._had) >= told:
                break
        self._unknown = max(0, told - len(self._had))

    def begin(self) -> None:
        """Begins to get the tiles; those that were published since look() began are there."""
        early, self._early = self._early, None
        self._there = {key for key in self._had if early and early.get(key) == self._newest}
        self._thread.start()

    def _note(self, payload: bytes, tile: Tile) -> None:
        """A store may answer, too, with older versions and the map before."""
        if tile.map_id > self._newest:
            self._newest = tile.map_id
            self._had.clear()
            self._whole.clear()
        key = self._link.keys.tile(tile.layer, tile.index)
        if tile.map_id < self._newest or tile.version < self._had.get(key, -1):
            return
        self._had[key] = tile.version
        self._whole.pop(key, None)
        if len(tile.points):
            self._whole[key] = payload

    def close(self) -> None:
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_SECONDS)

    def asks(self) -> bool:
        return self._thread.is_alive()

    def _is_over(self) -> bool:
        """Another map has begun, as after `zloam reset`."""
        return self._published > self._newest >= 0

    def lacking(self) -> int:
        """Number of tiles that have not come; none of a map that is over, which no view shows any
        more."""
        if self._is_over():
            return 0
        return self._unknown + len(self._had.keys() - self._there)

    def published(self, sample: Sample) -> None:
        """A tile was published: it is at least as new as an answer that comes later."""
        if self._early is None and not self.lacking():
            return  # No answer comes any more, or none is taken.
        with contextlib.suppress(*messages.DECODE_ERRORS):
            map_id = records.tile(sample.payload).map_id
            self._published = max(map_id, self._published)
            if self._early is not None:
                self._early[sample.key] = map_id
            elif map_id == self._newest and sample.key in self._had:
                self._there.add(sample.key)

    def takes(self, sample: Sample) -> bool:
        """Whether an answer belongs into the recording: not after a newer version of the tile, nor
        after a tile of another map, which a view would end by it."""
        if sample.key in self._there or self._is_over():
            return False
        self._there.add(sample.key)
        return True

    def _answers(self, selector: str) -> Iterable[tuple[bytes, Tile]]:
        for payload in self._link.get(selector, TILES_SECONDS, gently=True):
            with contextlib.suppress(*messages.DECODE_ERRORS):
                yield payload, records.tile(payload)

    def _ask(self) -> None:
        """Asks again for what was dropped, as long as that brings something."""
        while self._whole and self._goes_on():
            self._give(*self._whole.popitem())
        with contextlib.suppress(zenoh.ZError):  # The session may be closed already.
            missing, before = self._missing(), len(self._had) + 1
            while 0 < len(missing) < before and self._goes_on():
                before = len(missing)
                for key in missing:
                    if self._goes_on():
                        self._get(key)
                missing = self._missing()

    def _goes_on(self) -> bool:
        return not self._ends.is_set() and not self._is_over()

    def _missing(self) -> list[str]:
        return [key for key in self._had if key not in self._come and key not in self._there]

    def _get(self, key: str) -> None:
        found = [
            (tile.version, payload)
            for payload, tile in self._answers(key)
            if tile.map_id == self._newest and tile.version >= self._had[key]
        ]
        if found:
            self._give(key, max(found)[1])

    def _give(self, key: str, payload: bytes) -> None:
        if self._hand_over(key, payload):
            self._come.add(key)
