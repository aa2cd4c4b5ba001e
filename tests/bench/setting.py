"""Folders, and what several benchmarks share: the simulated capture, CPU time, cores."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.acceptance.runs import Setting, is_newer
from zloam_monitor.chain import binary

#: length of the capture; the live benchmark sends 40 s of it
CAPTURE_SECONDS = 42.0


class BenchSetting(Setting):
    """The folders of the acceptance runs, with a capture of the benchmarks' own."""

    @classmethod
    def at(cls, build: Path, out: Path) -> BenchSetting:
        here = cls.here(build, out)
        return cls(here.build, here.out, here.shared)

    def capture(self) -> Path:
        """The first part of the simulated city loop, with its payloads beside it; created once by
        each build."""
        capture = self.out / "capture.pcap"
        if not is_newer(capture, binary(self.build, "simulator")):
            self.out.mkdir(parents=True, exist_ok=True)
            simulate(self.build, CAPTURE_SECONDS, "--out", capture, "--bin", self.payloads())
        return capture

    def payloads(self) -> Path:
        """The data packets of the capture, concatenated."""
        return self.out / "capture.bin"


@dataclass(frozen=True)
class Cost:
    """Wall time, CPU time and output of a program."""

    wall_s: float
    cpu_s: float
    said: str


def cost_of(command: list[Any]) -> Cost:
    """Runs a program and measures its CPU time, which other load affects little."""
    before = os.times()
    began = time.monotonic()
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    wall_s, after = time.monotonic() - began, os.times()
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {done.stderr[-300:]}")
    cpu_s = after.children_user + after.children_system
    cpu_s -= before.children_user + before.children_system
    return Cost(wall_s, cpu_s, done.stdout)


def simulate(build: Path, seconds: float, *options: object) -> Cost:
    """Simulates the city loop from its start."""
    return cost_of(
        [
            *(binary(build, "simulator"), "--world", "city", "--seed", 1, "--quiet"),
            *("--duration", seconds),
            *options,
        ]
    )


def json_of(said: str) -> dict[str, Any]:
    """The last line of a program's output, parsed as JSON."""
    found: dict[str, Any] = json.loads(said.strip().splitlines()[-1])
    return found


def percentile(samples: list[float], percent: float) -> float:
    """The percentile; NaN without samples."""
    return float(np.percentile(samples, percent)) if samples else float("nan")


@contextlib.contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Restricts this process and those that it starts to `count` cores."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(before)[:count]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
