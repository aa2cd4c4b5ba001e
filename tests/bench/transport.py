"""10 MB messages between processes on the stages' runtime, and the effect of a slow reader on
others."""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import time
from dataclasses import dataclass
from typing import Any

from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting, percentile
from zloam_monitor.chain import binary
from zloam_monitor.processes import free_base_port

POINT_BYTES = 24
MESSAGE_BYTES = 10_000_000
COUNT = 1000
#: every n-th message is dropped on arrival, so that there is something to recover
FAULT_EVERY = 50
#: the slow reader's time per message and the rate of messages, at which it falls behind at once
SLOW_MS, RATE_HZ, SLOW_COUNT, ROUNDS = 100, 20.0, 150, 2
SLOW_MESSAGE_BYTES = {True: MESSAGE_BYTES, False: 1_000_000}
#: limit of the ratio of latencies with a slow second reader to those with a quick one
RATIO_LIMIT = 2.0
#: Shorter times are due to the scheduler, not to the reader.
FLOOR_MS = 5.0
PATIENCE_S = 600.0


@dataclass(frozen=True)
class Link:
    """Configuration of publisher and readers."""

    shared_memory: bool
    message_bytes: int
    count: int
    rate_hz: float = 0.0
    fault_every: int = 0


class Run:
    """One publisher (the driver) and some readers, each in its own process."""

    def __init__(self, setting: BenchSetting, name: str, link: Link) -> None:
        self._program = binary(setting.build, "bench-transport")
        self._link = link
        self._folder = setting.out / "transport" / name
        self._folder.mkdir(parents=True, exist_ok=True)
        self._base_port = free_base_port()
        self._started: dict[str, subprocess.Popen[bytes]] = {}

    def _start(self, role: str, own: dict[str, Any], readers: list[str]) -> None:
        report = self._folder / f"{role}.json"
        report.unlink(missing_ok=True)
        settings = {
            "zenoh.base_port": self._base_port,
            "zenoh.shared_memory": str(self._link.shared_memory).lower(),
            "zenoh.pool_mib": 256,
            "flow.window": 4,
            "flow.sinks": f"[{', '.join(readers)}]",
            "flow.wait_for": f"[{', '.join(readers)}]",
            f"{role}.report": report,
            **{f"{role}.{key}": value for key, value in own.items()},
        }
        command = [str(self._program), role]
        for key, value in settings.items():
            command += ["--set", f"{key}={value}"]
        faults = {"ZLOAM_FAULT_DROP_EVERY": str(self._link.fault_every)} if role != "driver" else {}
        with (self._folder / f"{role}.log").open("wb") as log:
            self._started[role] = subprocess.Popen(
                command, stdout=log, stderr=log, env={**os.environ, **faults}
            )

    def _wait(self, role: str) -> None:
        code = self._started[role].wait(PATIENCE_S)
        if code != 0:
            log = (self._folder / f"{role}.log").read_text()
            raise RuntimeError(f"{role} ended with {code}: {log[-300:]}")

    def result(self, work_ms: dict[str, int]) -> dict[str, dict[str, Any]]:
        """Role -> its report; `work_ms` has each reader's time per message."""
        link, readers = self._link, list(work_ms)
        publisher = {
            "count": link.count,
            "points": link.message_bytes // POINT_BYTES,
            "rate_hz": link.rate_hz,
            "readers": len(readers),
        }
        try:
            for role, spent in work_ms.items():
                self._start(role, {"work_ms": spent}, readers)
            self._start("driver", publisher, readers)
            for role in readers:
                self._wait(role)
            # A live publisher keeps running to answer queries for lost messages.
            if link.rate_hz > 0:
                self._started["driver"].send_signal(signal.SIGTERM)
            self._wait("driver")
        finally:
            self._end_all()
        return {r: json.loads((self._folder / f"{r}.json").read_text()) for r in self._started}

    def _end_all(self) -> None:
        for process in self._started.values():
            if process.poll() is None:
                process.kill()
                process.wait()


def _name(shared_memory: bool) -> str:
    return "shm" if shared_memory else "tcp"


def _crossing(setting: BenchSetting, shared_memory: bool, fault_every: int) -> Outcome:
    link = Link(shared_memory, MESSAGE_BYTES, COUNT, fault_every=fault_every)
    name = f"{_name(shared_memory)}-{fault_every}"
    began = time.monotonic()
    reports = Run(setting, name, link).result({"registration": 0})
    seconds, reader = time.monotonic() - began, reports["registration"]
    latency = reader.pop("latency_ms")
    p50, p99 = percentile(latency, 50), percentile(latency, 99)
    held = reader["read"] == COUNT and reader["balanced"]
    held = held and not (reader["wrong"] or reader["lost"] or reader["out_of_order"])
    if fault_every:
        held = held and reader["recovered"] > 0
    return Outcome(
        f"{reader['read']} of {COUNT}, {reader['recovered']} of them recovered, "
        f"{reader['wrong']} wrong, p50 {p50:.1f}, p99 {p99:.1f} ms, "
        f"{MESSAGE_BYTES * COUNT / seconds * 1e-6:.0f} MB/s",
        {**reader, "latency_p50_ms": p50, "latency_p99_ms": p99, "seconds": seconds},
        bool(held),
    )


def _with_second_reader(setting: BenchSetting, shared_memory: bool) -> Outcome:
    """Rounds with a quick and a slow second reader alternate, so that other load affects both
    alike."""
    link = Link(shared_memory, SLOW_MESSAGE_BYTES[shared_memory], SLOW_COUNT, RATE_HZ)
    latency: dict[str, list[float]] = {"quick": [], "slow": []}
    puts: dict[str, list[float]] = {"quick": [], "slow": []}
    read = {"quick": 0, "slow": 0}
    left_out = 0
    for _ in range(ROUNDS):
        for kind, spent in (("quick", 0), ("slow", SLOW_MS)):
            name = f"{_name(shared_memory)}-second-{kind}"
            reports = Run(setting, name, link).result({"registration": 0, "odometry": spent})
            latency[kind] += reports["registration"]["latency_ms"]
            puts[kind] += reports["driver"]["put_ms"]
            read[kind] += reports["registration"]["read"]
            left_out += reports["odometry"]["queue_full"] if kind == "slow" else 0
    figures = {
        f"{what}_p{percent}_ms": {k: percentile(v, percent) for k, v in samples.items()}
        for what, samples in (("latency", latency), ("put", puts))
        for percent in (50, 99)
    }
    ratios = {
        name: max(f["slow"], FLOOR_MS) / max(f["quick"], FLOOR_MS) for name, f in figures.items()
    }
    held = all(ratio <= RATIO_LIMIT for ratio in ratios.values()) and left_out > 0
    held = held and read["slow"] == ROUNDS * SLOW_COUNT
    words = ", ".join(
        f"{name[:-3].replace('_', ' ')} {f['slow']:.1f} / {f['quick']:.1f} ms"
        for name, f in figures.items()
    )
    return Outcome(
        f"slow / quick second reader: {words}; first reader has {read['slow']} of "
        f"{ROUNDS * SLOW_COUNT}; the slow one left out {left_out}",
        {"figures": figures, "ratios": ratios, "read": read, "left_out": left_out},
        held,
    )


def _how(shared_memory: bool) -> str:
    return "shared memory" if shared_memory else "TCP"


def _crossings(setting: BenchSetting, shared_memory: bool) -> list[Benchmark]:
    return [
        Benchmark(
            f"transport-{_name(shared_memory)}{suffix}",
            f"{COUNT} messages of 10 MB between two processes by {_how(shared_memory)}{words}",
            functools.partial(_crossing, setting, shared_memory, fault_every),
            f"all {COUNT}, as sent, in order",
        )
        for suffix, words, fault_every in (
            ("", "", 0),
            ("-faults", f", one in {FAULT_EVERY} thrown away on arrival", FAULT_EVERY),
        )
    ]


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    """Through shared memory and over TCP."""
    found = []
    for shared_memory in (True, False):
        found += _crossings(setting, shared_memory)
        size = SLOW_MESSAGE_BYTES[shared_memory] // 1_000_000
        found.append(
            Benchmark(
                f"slow-reader-{_name(shared_memory)}",
                f"{size} MB at {RATE_HZ:.0f} Hz by {_how(shared_memory)}: a second reader takes "
                f"{SLOW_MS} ms a message; first reader's latency and publisher's put",
                functools.partial(_with_second_reader, setting, shared_memory),
                f"none above {RATIO_LIMIT:.0f} × that with a quick second reader",
            )
        )
    return found
