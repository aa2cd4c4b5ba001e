"""own_box.py TOOLS BASE OUT: a capture in which a plate on the robot itself is in view behind the
sensor."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

PLATE_M, HALF_WIDTH_DEG = 1.3, 60.0
NOISE_UNITS, UNIT_M = 5.0, 0.002


def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("tools", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    tools, base, out = _module(Path(sys.argv[1])), sys.argv[2], sys.argv[3]
    stamps, frames = tools.load(base)
    where = [i for i, frame in enumerate(frames) if tools.is_data(frame)]
    payloads = tools.cells(frames, where).copy()
    azimuths, counts, cells = tools.ranges(payloads)
    behind_deg = (azimuths / 100.0) % 360.0 - 180.0
    hidden = np.abs(behind_deg) < HALF_WIDTH_DEG
    plate_m = PLATE_M / np.cos(np.radians(np.where(hidden, behind_deg, 0.0)))
    noise = np.random.default_rng(1).normal(0.0, NOISE_UNITS, counts.shape)
    plate = np.round(plate_m[..., None] / UNIT_M + noise).astype(np.int64)
    tools.set_ranges(cells, np.where(hidden[..., None], plate, counts))
    tools.put(frames, where, payloads)
    tools.save(out, stamps, frames)


if __name__ == "__main__":
    main()
