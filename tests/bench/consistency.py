"""Consistency of a path with the scans that it was made from, over metres of way; needs no truth.

The path moves the points of one sweep into the world, where they are compared with planes built in
the same way from the sweeps 1.5 to 2.5 s earlier, most of which saw the surfaces from elsewhere. If
the path is right in between, the points fit. Otherwise a rigid correction makes them fit: the
path's error over this way. A path that is too short by 3 % needs 0.24 m ahead after 8 m. Method:
point-to-plane ICP with Geman-McClure weights; planes from the 12 nearest points, accepted by the
eigenvalues of their scatter.

A path made without deskewing may be consistent only with points that are not deskewed; both
variants can be computed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, RotationSpline

Array = NDArray[np.float64]
#: sweep number -> (points in the sensor's frame at their own times, those times in s)
ScanOf = Callable[[int], tuple[Array, Array]]

#: sweeps between the map's last one and the one compared with it, and sweeps in the map
GAP_SWEEPS, MAP_SWEEPS = 15, 10
#: m; nearer or farther points tell little about the path
LEAST_RANGE_M, MOST_RANGE_M = 3.0, 50.0
#: m; cells of the thinning, one point each: of a sweep of the map, of the whole map, of the
#: compared sweep
SWEEP_CELL_M, MAP_CELL_M, LAID_CELL_M = 0.15, 0.07, 0.4
NEIGHBOURS, REACH_M = 12, 0.8
#: largest thickness of a plane (1 sigma), and least ratio of its extent's variance to that of its
#: thickness
PLANE_SIGMA_M, PLANE_SPREAD = 0.03, 4.0
#: m; widths of the kernel; the first steps are wide to find errors of decimetres
WIDE_M, NARROW_M, WIDE_STEPS, STEPS = 0.3, 0.1, 4, 12
#: s; the points of each such interval are moved together: error below 1 mm at 20 m/s
TIME_STEP_S = 0.00005


class Path:
    """A smooth path through poses T_world_lidar at given times."""

    def __init__(self, transforms: Array, times_s: Array) -> None:
        self._begin_s, self._end_s = float(times_s[0]), float(times_s[-1])
        self._position = CubicSpline(times_s, transforms[:, :3, 3])
        self._rotation = RotationSpline(times_s, Rotation.from_matrix(transforms[:, :3, :3]))

    def at(self, times_s: Array) -> tuple[Array, Array]:
        """(positions, rotation matrices); beyond its ends the path continues with constant
        velocity."""
        within = np.clip(times_s, self._begin_s, self._end_s)
        beyond = (times_s - within)[:, None] * self._position(within, 1)
        return self._position(within) + beyond, self._rotation(within).as_matrix()

    def moved(self, points: Array, times_s: Array) -> Array:
        """Moves points, each in the sensor's frame at its own time, into the world."""
        steps, of_point = np.unique(np.rint(times_s / TIME_STEP_S), return_inverse=True)
        positions, rotations = self.at(steps * TIME_STEP_S)
        of_point = of_point.reshape(-1)
        return np.einsum("nij,nj->ni", rotations[of_point], points) + positions[of_point]


@dataclass(frozen=True)
class Misfit:
    """The rigid correction that fits one sweep to the planes."""

    sweep: int
    #: m; ahead: in the direction of travel
    ahead_m: float
    left_m: float
    up_m: float
    #: m; way from the map's middle sweep to this one
    travelled_m: float
    #: m; median distance from the planes before and after the correction
    before_m: float
    after_m: float

    @property
    def distance_m(self) -> float:
        """Length of the correction."""
        return float(np.linalg.norm([self.ahead_m, self.left_m, self.up_m]))


def thinned(points: Array, cell_m: float) -> Array:
    """The first point of each cell."""
    _, first = np.unique(np.floor(points / cell_m).astype(np.int64), axis=0, return_index=True)
    found: Array = points[np.sort(first)]
    return found


class Planes:
    """Planes through the points of an earlier part of the path."""

    def __init__(self, points: Array) -> None:
        self._points, self._tree = points, cKDTree(points)

    def under(self, points: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """(indices of the points near a plane, the plane's normal, the distance from it)."""
        far, near = self._tree.query(points, NEIGHBOURS, distance_upper_bound=REACH_M, workers=-1)
        found = np.flatnonzero(np.isfinite(far).all(axis=1))
        around = self._points[near[found]]
        middle = around.mean(axis=1)
        apart = around - middle[:, None]
        spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", apart, apart) / NEIGHBOURS)
        flat = spread[:, 0] < np.minimum(PLANE_SIGMA_M**2, spread[:, 1] / PLANE_SPREAD)
        found, normals = found[flat], axes[flat, :, 0]
        return found, normals, np.einsum("ni,ni->n", normals, points[found] - middle[flat])


def correction(planes: Planes, points: Array, about: Array) -> tuple[Array, float, float]:
    """Fits points to the planes: (translation, median distance before, median distance after)."""
    R, shift = np.eye(3), np.zeros(3)
    before_m, distance = 0.0, np.zeros(0)
    for step in range(STEPS):
        arms = (points - about) @ R.T
        found, normals, distance = planes.under(about + arms + shift)
        if step == 0:
            before_m = float(np.median(np.abs(distance)))
        width_m = WIDE_M if step < WIDE_STEPS else NARROW_M
        weight = (1.0 + (distance / width_m) ** 2) ** -2
        J = np.hstack([np.cross(arms[found], normals), normals])
        weighted = J * weight[:, None]
        change = -np.linalg.solve(weighted.T @ J, weighted.T @ distance)
        R = Rotation.from_rotvec(change[:3]).as_matrix() @ R
        shift = shift + change[3:]
    return shift, before_m, float(np.median(np.abs(distance)))


def _telling(points: Array, times_s: Array) -> tuple[Array, Array]:
    range_m = np.linalg.norm(points, axis=1)
    telling = (range_m > LEAST_RANGE_M) & (range_m < MOST_RANGE_M)
    return points[telling], times_s[telling]


def misfit(scan: ScanOf, path: Path, sweep: int, sweep_s: float) -> Misfit:
    """The correction at one sweep, which needs GAP_SWEEPS + MAP_SWEEPS sweeps before it; the
    direction of travel is the path's."""
    of_map = range(sweep - GAP_SWEEPS - MAP_SWEEPS, sweep - GAP_SWEEPS)
    built = [thinned(path.moved(*_telling(*scan(number))), SWEEP_CELL_M) for number in of_map]
    planes = Planes(thinned(np.concatenate(built), MAP_CELL_M))
    points, times_s = _telling(*scan(sweep))
    times = np.array([(of_map[0] + of_map[-1] + 1) / 2 * sweep_s, times_s.mean()])
    (then, now), (_, R_world_lidar) = path.at(times)
    laid = thinned(path.moved(points, times_s), LAID_CELL_M)
    shift, before_m, after_m = correction(planes, laid, now)
    ahead = now - path.at(times[1:] - sweep_s)[0][0]
    ahead /= np.linalg.norm(ahead)
    left = np.cross(R_world_lidar[:, 2], ahead)
    return Misfit(
        sweep,
        float(shift @ ahead),
        float(shift @ left),
        float(shift @ np.cross(ahead, left)),
        float(np.linalg.norm(now - then)),
        before_m,
        after_m,
    )


def rms_m(found: Sequence[Misfit]) -> float:
    """Root mean square of the corrections."""
    return float(np.sqrt(np.mean([m.distance_m**2 for m in found])))
