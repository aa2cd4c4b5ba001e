"""A map is assembled from the messages of key `preview`."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from zloam_monitor import compose, messages, records
from zloam_monitor.compose import HeaderValues
from zloam_monitor.messages import MessageError
from zloam_monitor.preview_map import PreviewMap, cells_of
from zloam_monitor.records import PreviewRecord

BLOCK_M = 8.0


def octree_of(cells: NDArray[np.int64], depth: int) -> bytes:
    """Encodes cells cube by cube, as the schema describes it."""
    nodes = [((0, 0, 0), cells)]
    found = bytearray()
    for level in range(depth):
        edge = 1 << (depth - level - 1)
        below = []
        for corner, inside in nodes:
            byte = 0
            for bit in range(8):
                low = np.array(corner) + edge * np.array([bit & 1, bit >> 1 & 1, bit >> 2])
                own = inside[((inside >= low) & (inside < low + edge)).all(axis=1)]
                if len(own):
                    byte |= 1 << bit
                    below.append((tuple(low), own))
            found.append(byte)
        nodes = below
    return bytes(found)


def said(blocks: dict[tuple[int, int, int], tuple[int, bytes]], epoch: int = 1) -> PreviewRecord:
    try:
        messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))
    rows = [(*index, len(tree), depth, 0) for index, (depth, tree) in blocks.items()]
    payload = compose.preview(
        HeaderValues(5, 7, 0, map_id=5, stamp_ns=9),
        epoch,
        (1.0, 2.0, 3.0),
        BLOCK_M,
        np.array(rows, messages.PREVIEW_BLOCK),
        b"".join(tree for _, tree in blocks.values()),
    )
    return records.preview(payload)


def sorted_rows(rows: NDArray[np.int64]) -> list[list[int]]:
    return sorted(rows.tolist())


@pytest.mark.parametrize("depth", [2, 3, 6])
def test_an_octree_has_the_cells_it_was_made_of(depth: int) -> None:
    random = np.random.default_rng(depth)
    cells = np.unique(random.integers(0, 1 << depth, (500, 3)), axis=0)
    index = (-3, 0, 2)
    tree = np.frombuffer(octree_of(cells, depth), np.uint8)
    found = cells_of(tree, index, depth)
    assert sorted_rows(found - np.array(index) * (1 << depth)) == sorted_rows(cells)
    for broken in (tree[:-1], np.append(tree, np.uint8(1))):
        with pytest.raises(MessageError):
            cells_of(broken, index, depth)
    with pytest.raises(MessageError):
        cells_of(tree, index, 9)


def test_blocks_replace_one_another_and_have_places() -> None:
    upper = octree_of(np.array([[1, 1, 1]]), 1)
    lower = octree_of(np.array([[0, 0, 0], [3, 0, 0]]), 2)
    shown = PreviewMap()
    shown.take(said({(0, 0, 0): (1, upper), (-1, 0, 0): (1, upper)}))
    assert shown.map_blocks == 2
    assert shown.centres((-1, 0, 0)).tolist() == [[-2.0, 6.0, 6.0]]
    assert shown.take(said({(0, 0, 0): (2, lower)})) == [(0, 0, 0)]
    assert shown.centres((0, 0, 0)).tolist() == [[1.0, 1.0, 1.0], [7.0, 1.0, 1.0]]
    # Seen from above: the large cell of the other block as four points, two small ones as one each.
    assert len(shown.spread_points()) == 4 + 2
    shown.take(said({(0, 0, 0): (1, b"")}))
    assert list(shown.blocks) == [(-1, 0, 0)]


def test_another_map_begins_empty() -> None:
    upper = octree_of(np.array([[1, 1, 1]]), 1)
    shown = PreviewMap()
    shown.take(said({(0, 0, 0): (1, upper)}))
    shown.take(said({(4, 4, 4): (1, upper)}, epoch=2))
    assert list(shown.blocks) == [(4, 4, 4)]


def test_the_pose_is_there() -> None:
    pose = said({}).pose
    assert pose is not None
    assert (pose.run, pose.sweep, pose.instant_ns) == (5, 7, 9)
    assert pose.translation.tolist() == [1.0, 2.0, 3.0]
