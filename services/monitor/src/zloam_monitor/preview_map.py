"""The map as received on key `preview`: blocks that are assembled again (schemas/preview.fbs)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.messages import MessageError
from zloam_monitor.records import PreviewRecord

Index = tuple[int, int, int]
#: Octant of a cube -> its position along x, y, z: bit 0 is of x, bit 1 of y, bit 2 of z.
_HALVES = np.array([[bit & 1, bit >> 1 & 1, bit >> 2] for bit in range(8)], np.int64)
#: Limit on the halvings of a block's edge: at most 2^8 cells along it.
MOST_DEPTH = 8
#: Limit on the points along an edge of a cell in the view from above.
MOST_ACROSS = 2


def cells_of(octree: NDArray[np.uint8], index: Index, depth: int) -> NDArray[np.int64]:
    """Indices of a block's cells in the grid of the whole map, (n, 3); raises MessageError."""
    if not 0 < depth <= MOST_DEPTH:
        raise MessageError(f"a preview's block is halved {depth} times")
    nodes = np.array([index] if len(octree) else np.empty((0, 3)), np.int64).reshape(-1, 3)
    at = 0
    for _ in range(depth):
        level = octree[at : at + len(nodes)]
        if len(level) != len(nodes):
            raise MessageError("a preview's octree ends too soon")
        at += len(nodes)
        parent, half = np.nonzero(np.unpackbits(level[:, None], axis=1, bitorder="little"))
        nodes = 2 * nodes[parent] + _HALVES[half]
    if at != len(octree):
        raise MessageError("a preview's octree goes on behind its end")
    return nodes


class PreviewMap:
    """The blocks of one map that were received."""

    def __init__(self) -> None:
        self._source: tuple[str, int, int] | None = None
        self.block_m = 0.0
        #: Number of blocks of the whole map, as the robot counts them.
        self.map_blocks = 0
        #: Block -> (halvings of its edge, its cells).
        self.blocks: dict[Index, tuple[int, NDArray[np.int64]]] = {}
        #: Incremented with each change.
        self.version = 0

    def take(self, said: PreviewRecord) -> list[Index]:
        """Adds a preview; returns the blocks that changed; raises MessageError."""
        changed: list[Index] = []
        if (said.source, said.block_m) != (self._source, self.block_m):
            changed += self.blocks
            self.blocks.clear()
            self._source, self.block_m = said.source, said.block_m
            self.version += 1
        self.map_blocks = said.map_blocks
        ends = np.cumsum(said.blocks["bytes"], dtype=np.int64)
        if len(ends) and ends[-1] != len(said.octrees):
            raise MessageError("a preview's octrees are not as long as its blocks say")
        for block, end in zip(said.blocks, ends, strict=True):
            index = (int(block["i"]), int(block["j"]), int(block["k"]))
            octree = said.octrees[end - int(block["bytes"]) : end]
            self._set(index, int(block["depth"]), cells_of(octree, index, int(block["depth"])))
            changed.append(index)
        self.version += bool(changed)
        return changed

    def _set(self, index: Index, depth: int, cells: NDArray[np.int64]) -> None:
        if len(cells):
            self.blocks[index] = (depth, cells)
        else:
            self.blocks.pop(index, None)

    def cell_m(self, index: Index) -> float:
        """Edge of a block's cells, m."""
        return float(np.ldexp(self.block_m, -self.blocks[index][0]))

    def centres(self, index: Index) -> NDArray[np.float64]:
        """Centres of a block's cells, m."""
        if index not in self.blocks:
            return np.empty((0, 3))
        return (self.blocks[index][1].astype(np.float64) + 0.5) * self.cell_m(index)

    def spread_points(self) -> NDArray[np.float64]:
        """Points that cover all cells in a view from above: several for each larger cell."""
        deepest = max((depth for depth, _ in self.blocks.values()), default=0)
        found = [np.empty((0, 3))]
        for index, (depth, cells) in self.blocks.items():
            across = min(MOST_ACROSS, 1 << (deepest - depth))
            steps = (np.arange(across) + 0.5) / across
            x, y = (each.ravel() for each in np.meshgrid(steps, steps))
            within = np.stack([x, y, np.full(len(x), 0.5)], axis=-1)
            found.append((cells[:, None] + within[None]).reshape(-1, 3) * self.cell_m(index))
        return np.concatenate(found)
