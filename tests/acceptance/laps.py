"""Ten laps of the city loop: memory and cost must not grow with the length of the run."""

from __future__ import annotations

import functools
import statistics
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import ROOT, Setting, ended_well, is_newer, own_outputs
from zloam_monitor import sources
from zloam_monitor.chain import Chain
from zloam_monitor.records import StatusRecord
from zloam_monitor.robot_file import names
from zloam_monitor.stages import STAGES

LAPS, SEED = 10, 1
GROWTH = 1.1
#: Number of runs of ten laps: on a shared host a stage's CPU time varies by a fifth from minute to
#: minute.
RUNS = 3
#: limit of a run's duration; it is several times faster than real time
LONGEST_S = 1800.0


@dataclass(frozen=True)
class Spent:
    """CPU time and memory of a stage after its newest sweep."""

    sweep: int
    cpu_ms: float
    rss_mib: float


History = dict[str, list[Spent]]


def checks(setting: Setting) -> list[Check]:
    return [
        Check(
            "laps-memory",
            f"{LAPS} laps of the city: RSS of each stage at the end beside that after lap 2",
            f"≤ {GROWTH} ×",
            "make accept ONLY=laps",
            functools.partial(_memory, setting),
        ),
        Check(
            "laps-cost",
            f"{LAPS} laps of the city: CPU per sweep of each stage, lap {LAPS} beside lap 2",
            f"≤ {GROWTH} ×, median of {RUNS} runs",
            "make accept ONLY=laps",
            functools.partial(_cost, setting),
        ),
    ]


def capture(s: Setting) -> Path:
    """The packets of all laps, without a stop in between; created once by each build."""
    packets = s.out / "accept" / "worlds" / f"city-{SEED}-laps.pcap"
    simulator = s.build / "bin" / "zloam-simulator"
    if not is_newer(packets, simulator):
        packets.parent.mkdir(parents=True, exist_ok=True)
        part = packets.with_suffix(".part")
        command = [str(simulator), "--world", "city", "--seed", str(SEED)]
        options = ["--laps", str(LAPS), "--out", str(part), "--quiet"]
        done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError(f"the simulator ended with {done.returncode}: {done.stderr[-200:]}")
        part.rename(packets)
    return packets


def _note(status: StatusRecord | None, history: list[Spent]) -> None:
    if status is None or status.last_sweep is None:
        return
    if not history or history[-1].sweep != status.last_sweep:
        history.append(Spent(status.last_sweep, status.cpu_ms, status.rss_mib["end"]))


@functools.cache
def _histories(build: Path, packets: Path, out: Path) -> list[History]:
    return [_history(build, packets, out) for _ in range(RUNS)]


def _history(build: Path, packets: Path, out: Path) -> History:
    config = ROOT / "deploy/robots/vlp16-outdoor.yaml"
    robot = names(config, [])
    settings = [*sources.from_pcap(packets).driver_settings("max"), *own_outputs(out)]
    found: History = {stage: [] for stage in STAGES}
    ends = time.monotonic() + LONGEST_S
    with Chain(build, config, robot.robot, settings, out / "logs", robot.sensor) as chain:
        while not chain.finished():
            chain.link.poll(0.2)
            chain.check()
            for stage in STAGES:
                _note(chain.link.stage(stage), found[stage])
            if time.monotonic() > ends:
                raise RuntimeError(f"not done after {LONGEST_S:.0f} s")
        ended_well(chain)
    return found


def _runs(s: Setting) -> list[History]:
    if not (s.build / "bin" / "zloam-simulator").exists():
        raise Skip("zloam-simulator is not built")
    return _histories(s.build, capture(s), s.out / "accept" / "laps")


def _sweeps_a_lap(history: History) -> int:
    # A capture of a single lap is longer, since it also stands still and brakes.
    return (min(spent[-1].sweep for spent in history.values()) + 1) // LAPS


def _after(history: list[Spent], sweep: int) -> Spent:
    """The first record at or after a sweep, or else the last one."""
    return next((spent for spent in history if spent.sweep >= sweep), history[-1])


def _memory_grown(history: History, stage: str) -> float:
    spent = history[stage]
    after_two = _after(spent, 2 * _sweeps_a_lap(history))
    if after_two is spent[-1]:
        raise RuntimeError(f"{stage}: nothing was heard after lap 2")
    return spent[-1].rss_mib / after_two.rss_mib


def _memory(s: Setting) -> Measured:
    runs = _runs(s)
    ratios = {stage: max(_memory_grown(history, stage) for history in runs) for stage in STAGES}
    figure = ", ".join(f"{stage} {ratio:.2f}" for stage, ratio in ratios.items())
    return Measured(f"{figure} (largest of {RUNS} runs)", max(ratios.values()) <= GROWTH)


def _cost_ms(history: History, stage: str, number: int) -> float:
    """CPU time per sweep in a lap; laps are counted from 1."""
    lap, spent = _sweeps_a_lap(history), history[stage]
    begin, end = _after(spent, (number - 1) * lap), _after(spent, number * lap)
    return (end.cpu_ms - begin.cpu_ms) / (end.sweep - begin.sweep)


def _cost(s: Setting) -> Measured:
    runs, parts, held = _runs(s), [], True
    for stage in STAGES:
        last = [_cost_ms(history, stage, LAPS) for history in runs]
        ratios = [ms / _cost_ms(history, stage, 2) for ms, history in zip(last, runs, strict=True)]
        held = held and statistics.median(ratios) <= GROWTH
        each = ", ".join(f"{ratio:.2f}" for ratio in sorted(ratios))
        parts.append(f"{stage} {each} × ({statistics.median(last):.2f} ms)")
    return Measured("; ".join(parts), held)
