"""Runs one peer over a folder of scans: trajectory, CPU time of each sweep, memory, to an .npz.

usage: PYTHON peer.py PEER FOLDER OUT.npz

A program of its own for the peers' virtual environment (deploy/build/peers.sh): numpy and the peer,
of ours only the scans' layout. Every peer has its own defaults; what is set here is what the data
ask for: the least range, and whether points have times (without times nothing can be deskewed).
CPU time is user and system time of all threads while the peer works on a sweep, reading excluded.
The process keeps to one core, and its threads wait asleep (OMP_WAIT_POLICY=passive, set by the
caller): spinning ones take several times the CPU time on a busy machine.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tests.acceptance.point_files import SYNTH_POINT, SYNTH_TICK_NS

Array = NDArray[np.float64]

#: m; nearer is the sensor's own vehicle: a VLP-16 begins at 0.5, a car with an HDL-64E ends at 3
LEAST_RANGE_M = {16: 0.5, 64: 3.0}
MOST_RANGE_M = 120.0
#: small_gicp's default, and MAD-ICP's: its poses, though repeatable, depend on the number
SMALL_GICP_THREADS, MAD_THREADS = 1, 4


def untimed_points(file: Path) -> Array:
    """Of a scan of x y z reflectance; zeros are no return."""
    rows = np.fromfile(file, "<f4").reshape(-1, 4)[:, :3]
    return np.ascontiguousarray(rows[np.any(rows != 0.0, axis=1)], np.float64)


@dataclass(frozen=True)
class Data:
    """A folder of scans: 16-byte records with times, or KITTI's x y z reflectance without."""

    files: list[Path]
    period_s: float
    timed: bool
    rings: int

    @classmethod
    def at(cls, folder: Path) -> Data:
        meta = json.loads((folder / "meta.json").read_text())
        files = sorted((folder / meta.get("scans_in", "scans")).glob("*.bin"))
        return cls(files, float(meta["period"]), bool(meta["timestamps"]), int(meta["rings"]))

    @property
    def least_range_m(self) -> float:
        return LEAST_RANGE_M[self.rings]

    def scans(self) -> Iterator[tuple[Array, Array]]:
        """(points, times in parts of the period), one scan after the other."""
        for file in self.files:
            if self.timed:
                scan = np.fromfile(file, SYNTH_POINT)
                points = np.ascontiguousarray(scan["xyz"], np.float64)
                yield points, scan["t"] * (1e-9 * SYNTH_TICK_NS / self.period_s)
            else:
                points = untimed_points(file)
                yield points, np.zeros(len(points))


class Kiss:
    """KISS-ICP: its defaults, deskewing where there are times."""

    package = "kiss-icp"

    def __init__(self, data: Data) -> None:
        from kiss_icp.config.parser import load_config
        from kiss_icp.kiss_icp import KissICP

        config = load_config(None)
        config.data.deskew, config.data.min_range = data.timed, data.least_range_m
        self.settings = config.model_dump()
        self._odometry = KissICP(config)

    def prepared(self, points: Array, times: Array) -> Any:
        return points, times

    def step(self, scan: Any) -> Array:
        self._odometry.register_frame(*scan)
        return np.asarray(self._odometry.last_pose)


class Genz(Kiss):
    """GenZ-ICP: its defaults; deskewing, which is off in them, on where there are times."""

    package = "genz-icp"

    def __init__(self, data: Data) -> None:
        from genz_icp.config.parser import load_config
        from genz_icp.genz_icp import GenZICP

        config = load_config(None)
        config.data.deskew, config.data.min_range = data.timed, data.least_range_m
        self.settings = config.model_dump()
        self._timed = data.timed
        self._odometry = GenZICP(config)

    def prepared(self, points: Array, times: Array) -> Any:
        return points, times if self._timed else None


class SmallGicp:
    """small_gicp, scan to map with the values of its own KITTI example; it does not deskew."""

    package = "small-gicp"
    settings: ClassVar[dict[str, Any]] = {
        "downsampling_m": 0.25,
        "voxel_m": 1.0,
        "lru": [100, 10],
        "threads": MAD_THREADS,
    }

    def __init__(self, data: Data) -> None:
        import small_gicp

        self._lib = small_gicp
        self._map = small_gicp.GaussianVoxelMap(self.settings["voxel_m"])
        self._map.set_lru(horizon=100, clear_cycle=10)
        self._pose, self._motion = np.eye(4), np.eye(4)

    def prepared(self, points: Array, times: Array) -> Any:
        return points

    def step(self, scan: Any) -> Array:
        cloud, _ = self._lib.preprocess_points(
            scan, self.settings["downsampling_m"], num_threads=SMALL_GICP_THREADS
        )
        if self._map.size() == 0:
            self._map.insert(cloud)
            return self._pose
        guess = self._pose @ self._motion
        found = self._lib.align(
            self._map, cloud, guess, num_threads=SMALL_GICP_THREADS
        ).T_target_source
        self._motion = np.linalg.inv(self._pose) @ found
        self._pose = np.array(found)
        self._map.insert(cloud, self._pose)
        return self._pose


class Mad:
    """MAD-ICP: the defaults of its parameter file.

    Its deskewing takes a sweep to turn clockwise and to be cut at the rear; scans cut in front are
    turned by 180 degrees for it, and its poses back.
    """

    package = "mad-icp"
    settings: ClassVar[dict[str, Any]] = {
        "b_max": 0.2,
        "rho_ker": 0.1,
        "p_th": 0.8,
        "b_min": 0.1,
        "b_ratio": 0.02,
        "keyframes": 4,
        "threads": MAD_THREADS,
    }

    def __init__(self, data: Data) -> None:
        from mad_icp.src.pybind import pypeline

        s = self.settings
        self._vector = pypeline.VectorEigen3d
        self._turn = np.diag([-1.0, -1.0, 1.0, 1.0]) if data.timed else np.eye(4)
        self._least_m, self._period_s, self._sweep = data.least_range_m, data.period_s, 0
        self._pipeline = pypeline.Pipeline(
            *(1.0 / data.period_s, data.timed, s["b_max"], s["rho_ker"], s["p_th"], s["b_min"]),
            *(s["b_ratio"], s["keyframes"], s["threads"], False),
        )

    def prepared(self, points: Array, times: Array) -> Any:
        range_m = np.linalg.norm(points, axis=1)
        inside = (range_m > self._least_m) & (range_m < MOST_RANGE_M)
        return points[inside] @ self._turn[:3, :3]

    def step(self, scan: Any) -> Array:
        self._pipeline.compute(self._sweep * self._period_s, self._vector(scan))
        self._sweep += 1
        pose: Array = self._turn @ np.asarray(self._pipeline.currentPose()) @ self._turn
        return pose


PEERS: dict[str, Callable[[Data], Any]] = {
    "kiss-icp": Kiss,
    "genz-icp": Genz,
    "small-gicp": SmallGicp,
    "mad-icp": Mad,
}


def peak_rss_mib() -> float:
    """Of this program so far; getrusage would count what it was forked from."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1024.0


def main() -> int:
    if len(sys.argv) != 4:
        raise SystemExit("usage: PYTHON peer.py PEER FOLDER OUT.npz")
    name, folder, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    data = Data.at(folder)
    peer = PEERS[name](data)
    before_mib = peak_rss_mib()
    poses, spent_ms = [], []
    for points, times in data.scans():
        scan = peer.prepared(points, times)
        began = time.process_time()
        pose = peer.step(scan)
        spent_ms.append((time.process_time() - began) * 1e3)
        poses.append(np.array(pose, np.float64))
    facts = {
        "version": importlib.metadata.version(peer.package),
        "settings": peer.settings,
        "rss_mib": peak_rss_mib(),
        "rss_before_mib": before_mib,
    }
    np.savez(out, poses=poses, cpu_ms=spent_ms, facts=json.dumps(facts, default=str))
    return 0


if __name__ == "__main__":
    sys.exit(main())
