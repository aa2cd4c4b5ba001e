"""A recording that begins in mid-street and within a revolution, as one started while moving
does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.acceptance.runs import write_later_part
from tests.integration.conftest import monitor, simulate
from zloam_monitor import se3
from zloam_monitor.trajectory import interpolate, read

SECONDS = 8
#: starts of the recording, at different azimuths; the platform drives at 4.5 to 6 m/s then
BEGINNINGS_S = (5.0, 5.05, 5.08)
#: limits of the error of all motions since the first whole revolution
ODOMETRY_M, FUSED_M = 0.15, 0.10


@pytest.mark.parametrize("begin_s", BEGINNINGS_S)
def test_a_recording_begins_on_the_way(build: Path, tmp_path: Path, begin_s: float) -> None:
    whole = simulate(build, tmp_path, "--world", "city", "--seed", "2", "--duration", str(SECONDS))
    capture, out = tmp_path / "later.pcap", tmp_path / "out"
    write_later_part(whole.pcap, capture, begin_s)
    done = monitor("demo", "--preset-dir", build, "--pcap", capture, "--out", out)
    assert done.code == 0, done.said
    for name, limit_m in (("odometry.tum", ODOMETRY_M), ("trajectory.tum", FUSED_M)):
        found = read(out / name)
        assert found.stamps_ns is not None
        truth, inside = interpolate(read(whole.truth_base), found.stamps_ns)
        # The last sweep is partial too, but its pose is at the end of the revolution.
        estimate, wanted = found.transforms[inside][1:-1], truth.transforms[1:-1]
        moved = se3.inverse(estimate[0]) @ estimate
        truly = se3.inverse(wanted[0]) @ wanted
        speed_mps = np.linalg.norm(truly[1, :3, 3]) * 10
        assert speed_mps > 3.0
        off_m = np.linalg.norm(moved[:, :3, 3] - truly[:, :3, 3], axis=1)
        assert off_m.max() < limit_m, (name, off_m.round(3).tolist())
