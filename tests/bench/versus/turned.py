"""A data set seen from a turned sensor and from a later start, so that walls lie differently in a
map's grid.

Every system takes its first pose as the origin, so rotating a world together with its path would
not change its input. Here the sensor is mounted with a rotation about the vertical, which rotates
the map along the first pose against the world, and the run begins some scans later, elsewhere and
in motion.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.acceptance.point_files import SYNTH_POINT
from zloam_monitor import se3, trajectory

#: no simple fraction of a right angle, since the walls of the scenes are at right angles
TURN_DEG = 31.0
LATER_SCANS = 17


def write_turned(folder: Path, out: Path) -> None:
    """Writes the scans of a folder as the turned sensor sees them, from a later scan on, with its
    truth."""
    T_lidar_turned = se3.from_xyz_rpy_deg([0.0, 0.0, 0.0], [0.0, 0.0, TURN_DEG])
    R_turned_lidar = T_lidar_turned[:3, :3].T
    (out / "scans").mkdir()
    files = sorted((folder / "scans").glob("*.bin"))[LATER_SCANS:]
    for number, file in enumerate(files):
        scan = np.fromfile(file, SYNTH_POINT)
        scan["xyz"] = scan["xyz"] @ R_turned_lidar.T.astype(np.float32)
        scan.tofile(out / "scans" / f"{number:06d}.bin")
    stamps = (folder / "stamps.txt").read_text().splitlines()[LATER_SCANS:]
    (out / "stamps.txt").write_text("\n".join(stamps) + "\n")
    truth = trajectory.read(folder / "gt_dense.tum")
    trajectory.write_tum(out / "gt_dense.tum", truth.carried(T_lidar_turned))
    meta = json.loads((folder / "meta.json").read_text())
    (out / "meta.json").write_text(json.dumps({**meta, "scans": len(files)}) + "\n")
