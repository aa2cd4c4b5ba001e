"""Runs KISS-ICP 1.3.0 (defaults, deskewing on) on a folder of scans or on zloam-decode's points.

Prints one JSON line with its CPU time per sweep; --trajectory writes its poses, each at the instant
to which it refers: KISS-ICP deskews a sweep to the time of its last point.

usage: python -m tests.acceptance.kiss INPUT [--limit N] [--trajectory FILE]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from kiss_icp.config.parser import load_config
from kiss_icp.kiss_icp import KissICP
from numpy.typing import NDArray

from tests.acceptance.point_files import DECODED_POINT, SYNTH_POINT, SYNTH_TICK_NS
from zloam_monitor import trajectory
from zloam_monitor.trajectory import Trajectory

MIN_RANGE_M = 0.5
#: (points, time of each in ns)
Sweep = tuple[NDArray[Any], NDArray[np.int64]]


def of_folder(folder: Path) -> Iterator[Sweep]:
    """Sweeps from the scans of the reference generator."""
    begins = np.loadtxt(folder / "stamps.txt", ndmin=2)[:, 0]
    for path, begin in zip(sorted((folder / "scans").glob("*.bin")), begins, strict=False):
        scan = np.fromfile(path, SYNTH_POINT)
        yield scan["xyz"], round(begin * 1e9) + scan["t"].astype(np.int64) * SYNTH_TICK_NS


def of_decoded(path: Path) -> Iterator[Sweep]:
    """Sweeps from the points written by zloam-decode."""
    points = np.fromfile(path, DECODED_POINT)
    cuts = np.flatnonzero(np.diff(points["sweep"])) + 1
    for sweep in np.split(points, cuts):
        yield sweep["xyz"], sweep["time_ns"]


def run(sweeps: Iterator[Sweep], limit: int | None) -> tuple[list[float], Trajectory]:
    """CPU ms per sweep, and the poses at the times of the sweeps' last points."""
    config = load_config(None)
    config.data.deskew, config.data.min_range = True, MIN_RANGE_M
    odometry = KissICP(config)
    spent: list[float] = []
    poses: list[NDArray[np.float64]] = []
    stamps: list[int] = []
    for xyz, time_ns in sweeps:
        if len(spent) == limit:
            break
        points = np.ascontiguousarray(xyz, np.float64)
        first, last = int(time_ns.min()), int(time_ns.max())
        turned = (time_ns - first) / max(last - first, 1)
        began = time.process_time()
        odometry.register_frame(points, turned)
        spent.append((time.process_time() - began) * 1e3)
        poses.append(np.array(odometry.last_pose))
        stamps.append(last)
    return spent, Trajectory(np.array(poses), np.array(stamps, np.int64))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("input", type=Path)
    parser.add_argument("--limit", type=int)
    parser.add_argument("--trajectory", type=Path)
    args = parser.parse_args()
    sweeps = of_folder(args.input) if args.input.is_dir() else of_decoded(args.input)
    spent, poses = run(sweeps, args.limit)
    if args.trajectory is not None:
        trajectory.write_tum(args.trajectory, poses)
    print(json.dumps({"sweeps": len(spent), "cpu_ms_per_sweep": float(np.mean(spent))}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
