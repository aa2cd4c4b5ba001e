"""Determines the ring of each point: the rank of its laser by ascending elevation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.recordings.fields import Cloud

Ranks = NDArray[np.uint16]
MOST_RINGS = 128
#: Scatter of the elevations of one laser, whose cone does not have its apex in the origin.
CONE_DEG = 1.0
#: Gaps between the elevations of lasers are larger by this factor than gaps within one laser.
APART = 3.0
#: For nearer returns, the positions of the lasers in the head distort the elevation.
NEAR_M = 2.0


@dataclass
class Lasers:
    """Ranks of the lasers, identified by a value of their points. kind: field, row, column,
    elevation."""

    kind: str
    #: The values that occurred, ascending, and the rank of each.
    values: NDArray[np.float64]
    ranks: NDArray[np.uint16]
    #: Values that first occurred later; each is treated as the nearest known one.
    unknown: set[float] = field(default_factory=set)

    @property
    def count(self) -> int:
        return int(self.ranks.max()) + 1

    def ranks_of(self, cloud: Cloud) -> Ranks:
        found = _values(cloud, self.kind)
        at = np.searchsorted(self.values, found).clip(0, len(self.values) - 1)
        below = (at - 1).clip(0)
        nearer = np.abs(self.values[below] - found) < np.abs(self.values[at] - found)
        at = np.where(nearer, below, at)
        if self.kind != "elevation":
            self.unknown |= {float(v) for v in np.unique(found[self.values[at] != found])}
        ranks: Ranks = self.ranks[at]
        return ranks

    def __str__(self) -> str:
        known = {
            "field": "by its field",
            "row": "by the cloud's rows",
            "column": "by the cloud's columns",
            "elevation": "by their elevation",
        }
        return f"{self.count} rings, told {known[self.kind]}"


def elevation_deg(cloud: Cloud) -> NDArray[np.float64]:
    xyz = cloud.xyz.astype(np.float64)
    return np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))


def _values(cloud: Cloud, kind: str) -> NDArray[np.float64]:
    if kind == "elevation":
        return elevation_deg(cloud)
    found = {"field": cloud.ring, "row": cloud.row, "column": cloud.column}[kind]
    assert found is not None
    return found.astype(np.float64)


def settle(clouds: Sequence[Cloud]) -> Lasers | None:
    """Identifies lasers by the field, else by rows or columns of organised clouds, else by
    elevation.

    None: the points do not lie on cones, e.g. of solid-state sensors, or in clouds that were
    transformed to another frame.
    """
    for kind in ("field", "row", "column"):
        lasers = _by_value(clouds, kind)
        if lasers is not None:
            return lasers
    return _by_elevation(clouds)


def _by_value(clouds: Sequence[Cloud], kind: str) -> Lasers | None:
    """Identifies lasers by a value; None: it is missing, or its points do not lie on cones."""
    sources = {"field": "ring", "row": "row", "column": "column"}
    if any(getattr(c, sources[kind]) is None for c in clouds):
        return None
    values = np.concatenate([_values(c, kind) for c in clouds])
    elevations = np.concatenate([elevation_deg(c) for c in clouds])
    far = np.concatenate([np.linalg.norm(c.xyz, axis=1) > NEAR_M for c in clouds])
    if not far.any() or not np.isfinite(values).all() or (values % 1.0 != 0.0).any():
        return None
    known, index = np.unique(values[far], return_inverse=True)
    if len(known) > MOST_RINGS or len(known) < 2:
        return None
    count = np.bincount(index)
    mean = np.bincount(index, elevations[far]) / count
    variance = np.bincount(index, elevations[far] ** 2) / count - mean**2
    if np.sqrt(np.median(variance.clip(0.0))) > CONE_DEG:
        return None
    return Lasers(kind, known, _ranks(known, mean))


def _ranks(known: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Ranks by elevation. Numbers that ascend or descend with the elevation keep their spacing, so
    that lasers without returns are counted, too."""
    steps = np.diff(mean)
    if (steps > 0).all():
        ranks = known - known[0] if known[0] < 0 else known
    elif (steps < 0).all():
        ranks = known[-1] - known
    else:
        ranks = np.argsort(np.argsort(mean)).astype(np.float64)
    return ranks.astype(np.uint16)


def _by_elevation(clouds: Sequence[Cloud]) -> Lasers | None:
    """Identifies lasers as separate groups of elevations; None: there are no such groups."""
    far = np.concatenate([elevation_deg(c)[np.linalg.norm(c.xyz, axis=1) > NEAR_M] for c in clouds])
    if len(far) < 2:
        return None
    ordered = np.sort(far)
    gaps = np.diff(ordered)
    widest = np.sort(gaps)[::-1]
    most = min(MOST_RINGS, len(widest))
    # Gaps sorted by size fall steeply from those between lasers to those within a laser.
    falls = widest[: most - 1] / np.maximum(widest[1:most], 1e-12)
    groups = int(np.argmax(falls)) + 2
    if falls[groups - 2] < APART:
        return None
    cuts = np.sort(np.argsort(gaps)[::-1][: groups - 1]) + 1
    parts = np.split(ordered, cuts)
    middles = np.array([np.median(p) for p in parts])
    spread = float(np.median([p[-1] - p[0] for p in parts]))
    if groups < 4 or spread > CONE_DEG:
        return None
    return Lasers("elevation", middles, np.arange(groups, dtype=np.uint16))
