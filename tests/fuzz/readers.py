"""Trajectories with mutated bytes: each is read, or refused with its reason. readers.py SECONDS"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "services/monitor/src"))

import numpy as np

from zloam_monitor import trajectory
from zloam_monitor.trajectory import TrajectoryError

POSE = "1704067210.{i}00000000 {i}.5 -0.25 0.125 0 0 0 1"
SEEDS = (
    "\n".join(POSE.format(i=i) for i in range(6)) + "\n",
    "# timestamp tx ty tz qx qy qz qw\r\n" + "\r\n".join(POSE.format(i=i) for i in range(4)),
    "\n".join(POSE.format(i=i).replace(" ", ",") for i in range(4)),
    "\n".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(5)),
)
BITS = (b"nan", b"-inf", b"1e999", b"\x00", b"\xff", b"\xef\xbb\xbf", b"\n", b"#", b";", b"9" * 40)


def mutated(rng: random.Random) -> bytes:
    """A well-formed file after a few changes."""
    data = bytearray(rng.choice(SEEDS).encode())
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(data) + 1)
        end = min(len(data), at + rng.randint(0, 12))
        data[at:end] = rng.choice(
            (b"", rng.choice(BITS), rng.randbytes(3), bytes(data[at:end]) * 2)
        )
    return bytes(data)


def main(seconds: float) -> int:
    rng = random.Random(1)
    ends, read, refused = time.monotonic() + seconds, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.tum"
        while time.monotonic() < ends:
            data = mutated(rng)
            path.write_bytes(data)
            try:
                found = trajectory.read(path)
                assert len(found), data
                assert np.isfinite(found.transforms).all(), data
                read += 1
            except TrajectoryError:
                refused += 1
            except Exception:
                print(f"fuzz: trajectories: {data!r}", file=sys.stderr)
                raise
    print(f"fuzz: trajectories: {read} read, {refused} refused")
    return 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1])))
