"""A robot that drives round a block: first nobody watches, then every view of the monitor is open
on another host behind a thin link (issue 41). Both phases last equally long and are compared."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.integration.conftest import ROOT, Capture, simulate
from tests.integration.hosts import Far, relay, router
from tests.integration.live_run import LiveRun
from tests.integration.observed import Observed, Phase
from zloam_monitor.processes import Processes, free_port

BIT_PER_S, DELAY_S = 1_000_000, 0.2
ROUTER_PORT = 7447
#: time until the whole block is mapped; the robot keeps driving round it after that
LAP_S = 130.0
#: laps that the simulator drives: enough for half an hour
LAPS = 20
OPEN_S = 150.0


@dataclass
class Found:
    """The two phases, and what the other host received in the second."""

    alone: Phase
    watched: Phase
    #: view -> growth of its counter (all_views.AllViews.shown) during the second phase
    shown: dict[str, int]
    #: mean rate of the data received over the link
    bit_per_s: float

    def summary(self) -> dict[str, Any]:
        of = {"alone": self.alone, "watched": self.watched}
        return {
            "latency_ms.p50_p99": {
                n: [round(p.latency_ms(50), 2), round(p.latency_ms(99), 2)] for n, p in of.items()
            },
            "poses": {n: len(p.sweeps) for n, p in of.items()},
            "sweeps_without_pose": {n: p.missing() for n, p in of.items()},
            "dropped": {n: p.dropped for n, p in of.items()},
            "memory_growth_mib": {
                n: {stage: round(mib, 2) for stage, mib in p.growth_mib().items()}
                for n, p in of.items()
            },
            "shown": self.shown,
            "link_bit_per_s": round(self.bit_per_s),
        }


def processors() -> tuple[set[int], set[int]]:
    """The robot's processors and those of the views, which would use their own on a second host."""
    mine = sorted(os.sched_getaffinity(0))
    return (set(mine[:-1]), set(mine[-1:])) if len(mine) > 1 else (set(mine), set(mine))


@contextlib.contextmanager
def on_processors(cpus: set[int]) -> Iterator[None]:
    """Processes and threads that are started inside run on these processors only."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def start_beside(run: LiveRun, far: Far) -> None:
    """Starts a router that the other host can reach, and the preview."""
    processes = run.chain.processes
    endpoint = f"tcp/{far.near_address}:{ROUTER_PORT}"
    processes.start("router", router(endpoint), run.out / "router.log")
    program, *words = run.chain._commands["integration"]
    preview = [str(Path(program).with_name("zloam-preview")), *words]
    processes.start("preview", preview, run.out / "preview.log")


@contextlib.contextmanager
def all_open(run: LiveRun, far: Far, cpus: set[int]) -> Iterator[Path]:
    """Opens all views on the other host, which has these processors, and yields the file that says
    what they have shown so far."""
    folder = run.out / "views"
    folder.mkdir()
    behind = f"127.0.0.1:{free_port()}"
    over_there = Processes()
    here = relay(behind, f"{far.near_address}:{ROUTER_PORT}", DELAY_S)
    views = [sys.executable, "-m", "tests.integration.all_views", f"tcp/{behind}", str(folder)]
    paths = {"PYTHONPATH": f"{ROOT}:{ROOT}/services/monitor/src"}
    try:
        with on_processors(cpus):
            over_there.start("relay", far.command(here), folder / "relay.log")
            over_there.start("views", far.command(views), folder / "views.log", paths)
        shown = folder / "shown.json"
        deadline = time.monotonic() + OPEN_S
        while not shown.exists():
            run.wait(1.0)
            over_there.check()
            assert time.monotonic() < deadline, over_there.running["views"].last_lines()
        yield shown
        over_there.check()
    finally:
        over_there.stop()


def drive_for(build: Path, folder: Path, seconds: float) -> Capture:
    """A drive round one block, long enough for the whole measurement."""
    whole_s = LAP_S + OPEN_S + 2.0 * seconds + 60.0
    options = ("--world", "city", "--seed", "6", "--laps", str(LAPS))
    return simulate(build, folder, *options, "--duration", str(round(whole_s)))


def measure(build: Path, robot_file: Path, out: Path, far: Far, seconds: float) -> Found:
    """Measures both phases; each lasts `seconds`."""
    drive = drive_for(build, out, seconds)
    more = (f"zenoh.connect=[tcp/{far.near_address}:{ROUTER_PORT}]",)
    here, over_there = processors()
    with contextlib.ExitStack() as open_now:
        open_now.enter_context(on_processors(here))
        run = LiveRun(build, robot_file, drive, out, slower=1.0, seconds=float("inf"), more=more)
        open_now.enter_context(run)
        start_beside(run, far)
        robot = Observed(run)
        run.wait(LAP_S)
        far.slow_down(BIT_PER_S)
        alone = robot.during(seconds)
        with all_open(run, far, over_there) as shown:
            before, came = json.loads(shown.read_text()), far.received_bytes()
            watched = robot.during(seconds)
            came = far.received_bytes() - came
            after = json.loads(shown.read_text())
        growth = {view: after[view] - before[view] for view in after}
        return Found(alone, watched, growth, 8.0 * came / seconds)
