"""CPU per sweep of KISS-ICP 1.3.0 (defaults, deskewing on) on a folder of scans: one JSON line.

usage: python -m tests.acceptance.kiss FOLDER [LIMIT]
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
from kiss_icp.config.parser import load_config
from kiss_icp.kiss_icp import KissICP

#: 16-byte records of the reference generator; t in units of 2 us since the scan's start
RECORD = np.dtype([("xyz", "<f4", 3), ("intensity", "u1"), ("ring", "u1"), ("t", "<u2")])
TICK_S = 2e-6


def main() -> int:
    folder = Path(sys.argv[1])
    limit = int(sys.argv[2]) if len(sys.argv) > 2 else None
    period_s = float(json.loads((folder / "meta.json").read_text())["period"])
    config = load_config(None)
    config.data.deskew, config.data.min_range = True, 0.5
    odometry = KissICP(config)
    spent = []
    for path in sorted((folder / "scans").glob("*.bin"))[:limit]:
        scan = np.fromfile(path, RECORD)
        points = np.ascontiguousarray(scan["xyz"], np.float64)
        times = scan["t"] * (TICK_S / period_s)
        began = time.process_time()
        odometry.register_frame(points, times)
        spent.append((time.process_time() - began) * 1e3)
    print(json.dumps({"sweeps": len(spent), "cpu_ms_per_sweep": float(np.mean(spent))}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
