"""A data set turned and shifted against whoever looks at it: a map's grid and its walls lie anew.

Every system calls its first pose the origin, so turning a world and the path in it together changes
nothing that a system can see. Here the sensor is mounted turned about the vertical, so that a map
that is laid along the first pose lies turned in the world, and the run begins some scans later,
elsewhere, in motion.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.acceptance.point_files import SYNTH_POINT
from zloam_monitor import se3, trajectory

#: no simple part of a right angle, as the walls of the scenes stand
TURN_DEG = 31.0
LATER_SCANS = 17


def write_turned(folder: Path, out: Path) -> None:
    """The scans of a folder, turned and begun later; truth is that of the turned sensor."""
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
