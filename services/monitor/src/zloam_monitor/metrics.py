"""A robot's figures for Prometheus (OpenMetrics), from the statuses that any subscriber receives.
Labels are names (stage, instance, key, reason, figure), whose number is bounded in each scrape:
of instances and stages here, of the others in each status (records.py).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from zloam_monitor.link import Link
from zloam_monitor.ports import in_url, not_listening
from zloam_monitor.records import HEALTH, SERVICE_HEALTH, PoseRecord, StatusRecord
from zloam_monitor.stages import ROWS, STAGES
from zloam_monitor.watch import STALE_SECONDS

#: Limit on instances of one stage; messages of more come from a stranger.
MOST_INSTANCES = 16
#: Limit on stages that services/stages.json does not name: of own programs, or a stranger's.
MOST_OTHERS = 16
#: Number of newest poses that its link keeps.
KEPT_POSES = 600
#: Name of a quantile in statuses -> value of the label.
QUANTILES = {"p50": "0.5", "p95": "0.95", "p99": "0.99"}
BYTES_PER_MIB = float(1 << 20)


class Seen:
    """The newest statuses and pose, for scrapes from other threads."""

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self._lock = threading.Lock()
        self._statuses: list[tuple[StatusRecord, float]] = []
        self._pose: PoseRecord | None = None
        self._poses_total = 0
        self._run: int | None = None
        self._last_sweep = -1
        self._pose_heard = 0.0

    def take(self, link: Link) -> None:
        """Copies the link's state."""
        now = time.monotonic()
        with self._lock:
            self._statuses = _present(link, now)
            if link.poses:
                self._count(link, now)

    def _count(self, link: Link, now: float) -> None:
        if link.run != self._run:
            self._run, self._last_sweep = link.run, -1
        new = [sweep for sweep in link.poses if sweep > self._last_sweep]
        if new:
            self._poses_total += len(new)
            self._last_sweep = max(new)
            self._pose, self._pose_heard = link.poses[self._last_sweep], now

    def collect(self) -> Iterator[Metric]:
        """Called by prometheus_client for each scrape."""
        with self._lock:
            statuses = list(self._statuses)
            pose, heard, total = self._pose, self._pose_heard, self._poses_total
        yield from _of_presence(self.robot, statuses)
        fresh = [status for status, age in statuses if _is_fresh(age)]
        yield from _of_stages(self.robot, fresh)
        yield from _of_messages(self.robot, fresh)
        yield from _of_pose(self.robot, pose, time.monotonic() - heard, total)


def _is_fresh(age_s: float) -> bool:
    return age_s <= STALE_SECONDS


def _present(link: Link, now: float) -> list[tuple[StatusRecord, float]]:
    """Statuses that are not stale, with their ages in s; of a stage of stages.json without one, the
    newest. Other instances have ended: what they said last would never end. So has a stage beside
    the chain that said that it stops; a chain is none without one of its own."""
    by_stage: dict[str, list[tuple[StatusRecord, float]]] = {}
    for status in link.statuses.values():
        by_stage.setdefault(status.stage, []).append((status, link.silent_s(status, now)))
    found, others = [], 0
    for stage, each in by_stage.items():
        each.sort(key=lambda of: of[1])
        fresh = [of for of in each if _is_fresh(of[1])]
        has_ended = stage not in STAGES and each[0][0].health == "stopping"
        if stage in ROWS:
            found += fresh[:MOST_INSTANCES] or each[: not has_ended]
        elif fresh and others < MOST_OTHERS:
            others += 1
            found += fresh[:MOST_INSTANCES]
    return found


def _of_presence(robot: str, statuses: list[tuple[StatusRecord, float]]) -> Iterator[Metric]:
    """The figures that a silent stage has, too."""
    who = ["robot", "stage", "instance"]
    up = GaugeMetricFamily("zloam_up", "1: its status is not older than 5 s.", labels=who)
    silent = GaugeMetricFamily(
        "zloam_status_age_seconds", "Since its last status came.", labels=who
    )
    # A stage that was never heard is reported as down.
    heard = {status.stage for status, _ in statuses}
    for stage in STAGES:
        if stage not in heard:
            up.add_metric([robot, stage, ""], 0.0)
    for status, age in statuses:
        own = [robot, status.stage, status.instance]
        up.add_metric(own, float(_is_fresh(age)))
        silent.add_metric(own, age)
    yield from (up, silent)


def _of_stages(robot: str, statuses: list[StatusRecord]) -> Iterator[Metric]:
    who = ["robot", "stage", "instance"]
    uptime = GaugeMetricFamily("zloam_uptime_seconds", "Since it was started.", labels=who)
    health = GaugeMetricFamily(
        "zloam_health", "1 of the state that it says to be in.", labels=[*who, "state"]
    )
    cpu = CounterMetricFamily("zloam_cpu_seconds", "Processor time used.", labels=who)
    rss = GaugeMetricFamily("zloam_resident_bytes", "Memory of the process.", labels=who)
    rev = GaugeMetricFamily("zloam_config_revision", "Revision in force.", labels=who)
    latency = GaugeMetricFamily(
        "zloam_latency_seconds",
        "Quantiles of what it takes.",
        labels=[*who, "name", "quantile"],
    )
    figure = GaugeMetricFamily(
        "zloam_figure", "A stage's own figures, by name.", labels=[*who, "name"]
    )
    for status in statuses:
        own = [robot, status.stage, status.instance]
        # By its own host's clock, which may have been set back since.
        uptime.add_metric(own, max(0.0, 1e-9 * (status.stamp_ns - status.started_ns)))
        for state in SERVICE_HEALTH:
            health.add_metric([*own, state], float(state == status.health))
        cpu.add_metric(own, status.cpu_ms / 1000.0)
        rss.add_metric(own, status.rss_mib["end"] * BYTES_PER_MIB)
        rev.add_metric(own, float(status.config_rev))
        for name, found in status.latencies.items():
            for quantile, label in QUANTILES.items():
                latency.add_metric([*own, name, label], found[quantile] / 1000.0)
        for name, value in status.figures.items():
            figure.add_metric([*own, name], value)
    yield from (uptime, health, cpu, rss, rev, latency, figure)


def _of_messages(robot: str, statuses: list[StatusRecord]) -> Iterator[Metric]:
    who = ["robot", "stage", "instance"]
    counters = {
        name: CounterMetricFamily(f"zloam_{name}", text, labels=[*who, "key"])
        for name, text in (
            ("received", "Messages that came."),
            ("processed", "Messages that were worked on."),
            ("lost", "Numbers that nobody had any more."),
            ("recovered", "Messages that were asked for again and came."),
            ("published", "Messages that went out."),
        )
    }
    dropped = CounterMetricFamily(
        "zloam_dropped", "Messages that were not worked on.", labels=[*who, "key", "reason"]
    )
    queued = GaugeMetricFamily("zloam_queued", "Messages that wait.", labels=[*who, "key"])
    for status in statuses:
        own = [robot, status.stage, status.instance]
        for each in status.inputs:
            key = [*own, each.key]
            counters["received"].add_metric(key, each.received)
            counters["processed"].add_metric(key, each.processed)
            counters["lost"].add_metric(key, each.lost)
            counters["recovered"].add_metric(key, each.recovered)
            queued.add_metric(key, each.queued)
            for reason, count in each.dropped.items():
                dropped.add_metric([*key, reason], count)
        for name, count in status.published.items():
            counters["published"].add_metric([*own, name], count)
    yield from counters.values()
    yield from (dropped, queued)


def _of_pose(robot: str, pose: PoseRecord | None, age: float, total: int) -> Iterator[Metric]:
    poses = CounterMetricFamily("zloam_poses", "Fused poses that came.", labels=["robot"])
    poses.add_metric([robot], total)
    yield poses
    if pose is None:
        return
    since = GaugeMetricFamily("zloam_pose_age_seconds", "Since the last pose.", labels=["robot"])
    since.add_metric([robot], age)
    health = GaugeMetricFamily(
        "zloam_pose_health", "1 of what the last pose says of itself.", labels=["robot", "state"]
    )
    for number, state in enumerate(HEALTH):
        health.add_metric([robot, state], float(number == pose.health))
    degenerate = GaugeMetricFamily(
        "zloam_pose_degenerate", "1: a direction is not seen.", labels=["robot"]
    )
    degenerate.add_metric([robot], float(pose.degenerate))
    position = GaugeMetricFamily(
        "zloam_pose_position_metres", "Of base_link in the map.", labels=["robot", "axis"]
    )
    for axis, value in zip("xyz", pose.translation, strict=True):
        position.add_metric([robot, axis], float(value))
    yield from (since, health, degenerate, position)


def serve(link: Link, address: str, port: int, seconds: float | None = None) -> int:
    """Serves /metrics until Ctrl-C or `seconds` have passed; port 0: a free port."""
    seen = Seen(link.keys.robot)
    registry = CollectorRegistry()
    registry.register(seen)
    server, thread = _started(port, address, registry)
    where = f"http://{in_url(address)}:{server.server_port}/metrics"
    print(f"metrics of robot {seen.robot}: {where}", flush=True)
    link.query_statuses()
    began = time.monotonic()
    try:
        while seconds is None or time.monotonic() - began < seconds:
            link.poll(0.2)
            link.poll()
            seen.take(link)
    except KeyboardInterrupt:
        pass
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
    return 0 if link.statuses else 1


def _started(port: int, address: str, registry: CollectorRegistry) -> tuple[Any, threading.Thread]:
    try:
        return start_http_server(port, addr=address, registry=registry)
    except (OSError, UnicodeError) as error:  # UnicodeError: of a name like a..b.
        raise not_listening(address, port, error) from error
