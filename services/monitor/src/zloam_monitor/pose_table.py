"""The table of a run's fused poses, `poses.csv`: health, degenerate direction and covariance."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zloam_monitor.failures import FileTrouble
from zloam_monitor.files import written_whole
from zloam_monitor.records import HEALTH, PoseRecord

NAME = "poses.csv"
#: Beside sweep and instant. c00 to c55: covariance, row-major; x, y, z (m), then rotation (rad);
#: empty where the pose has none.
COLUMNS = (
    *("health", "degenerate", "weak_x", "weak_y", "weak_z"),
    *(f"c{i}{j}" for i in range(6) for j in range(6)),
)
CELLS = 36


#: The cells of COLUMNS, by the instants of the poses in ns.
PoseTable = dict[int, list[str]]


def write(path: Path, poses: Mapping[int, PoseRecord]) -> None:
    """Writes one line for each pose, by ascending sweep."""
    with written_whole(path) as out:
        out.write(",".join(["sweep", "instant_ns", *COLUMNS]) + "\n")
        for sweep in sorted(poses):
            pose = poses[sweep]
            said = (sweep, pose.instant_ns, pose.health, int(pose.degenerate))
            weak = [f"{v:.9g}" for v in pose.weak_translation]
            # Zeros would say that the pose is exact.
            known = len(pose.covariance) == CELLS
            covariance = [f"{v:.9g}" for v in pose.covariance] if known else [""] * CELLS
            out.write(",".join([*map(str, said), *weak, *covariance]) + "\n")


def read(path: Path) -> PoseTable:
    """Reads what write() wrote; the health as a word."""
    cells: PoseTable = {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                health = HEALTH[int(row["health"])]
                cells[int(row["instant_ns"])] = [health, *(row[name] for name in COLUMNS[1:])]
    except (KeyError, TypeError, ValueError, IndexError, csv.Error) as error:
        raise FileTrouble(f"{path}: no table of poses, as a run writes it: {error!r}") from error
    if not all(isinstance(cell, str) for row in cells.values() for cell in row):
        raise FileTrouble(f"{path}: a line has too few columns")
    return cells


def beside(trajectory_file: Path) -> PoseTable | None:
    """The table in the folder of a run's trajectory."""
    path = trajectory_file.parent / NAME
    return read(path) if path.is_file() else None


def extent(
    trajectory_file: Path, known: PoseTable | None, stamps_ns: NDArray[np.int64] | None
) -> str:
    """How many of the poses the table has, in words."""
    if known is None:
        return f"without covariances (no {NAME} beside {trajectory_file.name})"
    stamps = [] if stamps_ns is None else [int(stamp) for stamp in stamps_ns]
    found = sum(bool(known[stamp][-1]) for stamp in stamps if stamp in known)
    return f"{found} with covariances of {trajectory_file.parent / NAME}"
