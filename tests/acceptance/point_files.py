"""Record formats of the point files that tests and benchmarks read."""

from __future__ import annotations

import numpy as np

#: 16-byte records of the reference generator; t in units of 2 us since the scan's start
SYNTH_POINT = np.dtype([("xyz", "<f4", 3), ("intensity", "u1"), ("ring", "u1"), ("t", "<u2")])
SYNTH_TICK_NS = 2000
#: records of zloam-decode --out
DECODED_POINT = np.dtype(
    [
        *(("xyz", "<f4", 3), ("intensity", "<f4"), ("time_ns", "<i8"), ("ring", "<u2")),
        *(("return_type", "u1"), ("zero", "u1"), ("column", "<u2"), ("sweep", "<u2")),
    ]
)
