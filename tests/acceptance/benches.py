"""Checks that a benchmark judges: each runs `python -m tests.bench` and takes over its verdict."""

from __future__ import annotations

import functools
import json

from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import Setting

#: benchmark -> text of its check; the limit is the benchmark's own
LINES = {
    "transport-shm": "10 MB, 1000 times, by shared memory: all there",
    "transport-tcp": "10 MB, 1000 times, by TCP: all there",
    "transport-shm-faults": "the same by shared memory, one in 50 thrown away: all recovered",
    "transport-tcp-faults": "the same by TCP, one in 50 thrown away: all recovered",
    "slow-reader-shm": "a reader of 100 ms a message delays no other and no publisher, 10 MB",
    "decode-simulated": "decoding on one thread beside velodyne-decoder, packets of the city",
    "decode-recorded": "decoding on one thread beside velodyne-decoder, packets of a real VLP-16",
    "decode-pcap": "decoding beside velodyne-decoder, reading of the pcap included",
    "slow-reader-tcp": "a reader of 100 ms a message delays no other and no publisher, TCP",
}


def _measure(setting: Setting, name: str) -> Measured:
    out = setting.out / "accept" / "bench" / name
    command = ("-m", "tests.bench", "--preset-dir", setting.build, "--only", name, "--out", out)
    report = out / "report.json"
    report.unlink(missing_ok=True)  # Of an earlier call.
    done = setting.python(*command)
    rows = json.loads(report.read_text())["benchmarks"] if report.exists() else []
    row = next((r for r in rows if r["name"] == name), None)
    if row is None or done.returncode not in (0, 1):
        raise RuntimeError(f"no report: {done.stdout.strip()[-200:]}")
    if row["verdict"].startswith("skipped"):
        raise Skip(row["verdict"])
    figure = row["figure"] if row["figure"] != "–" else row["verdict"]
    return Measured(figure, row["verdict"] == "held")


def checks(setting: Setting) -> list[Check]:
    """Speeds are those of the moment: the machine should have nothing else to do."""
    return [
        Check(
            name,
            what,
            "the benchmark's own",
            f"make bench ONLY={name}",
            functools.partial(_measure, setting, name),
        )
        for name, what in LINES.items()
    ]
