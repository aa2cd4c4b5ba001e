"""Finds out what is wrong with a running robot, and what to do, from what any subscriber receives
within seconds. For recordings see doctor_files.py."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from zloam_monitor import latency
from zloam_monitor.doctor_sensor import of_sensor
from zloam_monitor.heard import Finding, Heard, Rule
from zloam_monitor.link import STANDING_BY, Link
from zloam_monitor.records import Input, StatusRecord, pose_health
from zloam_monitor.stages import ROWS, STAGES
from zloam_monitor.tokens import Claim
from zloam_monitor.traffic import Lateness
from zloam_monitor.watch import STALE_SECONDS

#: Plausible revolutions per second of a spinning lidar.
SLOWEST_HZ, FASTEST_HZ = 4.5, 21.0
#: driver.source of sweeps that no revolution of the lidar makes: a scanner on a motor, files of any
#: lidar.
NOT_TURNING = ("scip", "scip_log", "scans", "recording")
#: Configuration values that must be the same in all stages of a robot.
SHARED = ("robot", "sensor.", "mounting.")
#: Mean size of a message below which shared memory is not worthwhile.
LARGE_BYTES = 16384
#: Delay of statuses that is reported. They come once a second.
LATE_SECONDS = 3.0
#: A stage that is younger than YOUNG_S and started APART_S after the oldest one was restarted.
YOUNG_S, APART_S = 60.0, 10.0
#: A stage that works longer than this part of the sweep period falls behind.
SLOW = 1.0
SLOW_ONE = "it is the slow one: give it a processor of its own, or fewer points"
FULL = "queue_full"
#: Drop reason -> its meaning for a user.
DROPS = {
    FULL: "the machine is too slow for this rate: fewer points (registration.*), or "
    "another machine for a stage",
    "late": "messages come after others were given up: the link, or the machine, is overloaded",
    "wrong_run": "somebody else publishes sweeps under this robot's name: a second driver, or a "
    "second robot of one name",
    "invalid": "messages with values that can't be are refused: another version, or a stranger",
    "garbage": "what can't be read comes under this robot's keys: another version, or a stranger",
    "torn": "the stage had no processor for 0.1 s while its publisher needed the shared memory: a "
    "faster machine, or a larger zenoh.pool_mib",
    "fenced": "an instance that was replaced still publishes",
}


class Hearing:
    """What a link hears from its construction on; it waits for no answers."""

    def __init__(self, link: Link) -> None:
        self._link, self._before = link, dict(link.statuses)
        self._begun_s = time.monotonic()
        # Separately for each key: a stage that is behind still publishes sweeps from before.
        self._posed, self._mapped = (max(kept, default=-1) for kept in (link.poses, link.mapped))

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._begun_s

    def heard(self) -> Heard:
        """All but answers to queries."""
        link, now = self._link, time.monotonic()
        return Heard(
            link.keys.robot,
            self.seconds,
            self._before,
            dict(link.statuses),
            {who: link.silent_s(status, now) for who, status in link.statuses.items()},
            set(),
            [pose for sweep, pose in sorted(link.poses.items()) if sweep > self._posed],
            {},
            link.garbage,
            [pose for sweep, pose in sorted(link.mapped.items()) if sweep > self._mapped],
        )


@dataclass(frozen=True)
class Answers:
    """Answers of a robot to queries. Each may take seconds if a stage does not answer."""

    living: set[tuple[str, str]]
    configs: dict[str, dict[str, Any]]
    unanswered: frozenset[str]
    strangers: frozenset[Claim]

    @classmethod
    def of(cls, link: Link, claims: set[Claim]) -> Answers:
        """claims: those from the beginning; a token that has gone since is no stranger's."""
        living, configs = link.living_instances(), link.query_configs()
        strangers = _strangers(claims & link.claims(), link.answering())
        return cls(living, configs, frozenset(link.unanswered), strangers)

    def added_to(self, heard: Heard, late: Lateness) -> Heard:
        return replace(
            heard,
            living=self.living,
            configs=self.configs,
            late_s=late.seconds(self.living),
            strangers=self.strangers,
            unanswered=self.unanswered,
        )


def listen(link: Link, seconds: float) -> Heard:
    """Listens to a robot for some seconds."""
    link.query_statuses()
    link.poll()
    hearing, claims = Hearing(link), link.claims()
    while (left := seconds - hearing.seconds) > 0:
        link.poll(min(left, 0.2))
    link.query_statuses()
    link.poll()
    heard = hearing.heard()
    return Answers.of(link, claims).added_to(heard, link.late)


def _strangers(claims: set[Claim], answering: list[StatusRecord]) -> frozenset[Claim]:
    return frozenset(c for c in claims if not any(c.is_of(status) for status in answering))


def findings_of_statuses(heard: Heard, health: Rule | None = None) -> list[Finding]:
    """Findings from statuses alone; `health`: rule that reports the stages' own reasons."""
    rules = (_stages, _late, _restarts, _instances, _tokens, health or _health, of_sensor, _drops)
    return [finding for rule in rules for finding in rule(heard)]


def findings(heard: Heard) -> list[Finding]:
    """All findings, the most urgent first."""
    return [*findings_of_statuses(heard), *findings_of_poses(heard)]


def findings_of_poses(heard: Heard) -> list[Finding]:
    """Findings from poses and configurations."""
    return [finding for rule in (_poses, _pace, _settings) for finding in rule(heard)]


def _stages(heard: Heard) -> Iterator[Finding]:
    there = {stage for stage, _ in heard.living}
    for stage in STAGES:
        if stage not in there:
            yield Finding(
                f"{stage} is not there",
                "it was not started (make run and docker compose start all), has ended, or hangs: "
                f"its last words are in logs/{stage}.log or docker compose logs {stage}",
            )
    for stage, instance in sorted(heard.living):
        silent = heard.silent_s.get((stage, instance))
        if silent is None or silent > STALE_SECONDS:
            since = "it was asked" if silent is None else f"{silent:.0f} s"
            yield Finding(
                f"{stage} ({instance}) has said nothing since {since}",
                "it hangs, or the link to it does: see its log, and whether its machine answers",
            )
    if heard.garbage:
        yield Finding(
            f"{heard.garbage} messages could not be read here",
            "this program and the stages are of different versions",
        )


def _late(heard: Heard) -> Iterator[Finding]:
    if heard.late_s > LATE_SECONDS:
        yield Finding(
            f"what the robot publishes arrives {heard.late_s:.0f} s later than at first",
            "the link carries less than the views here take: start zloam preview on the robot and "
            "the views with --thin",
        )


def _restarts(heard: Heard) -> Iterator[Finding]:
    # An age below zero: the host's clock was set back since, so the age is unknown.
    ages = {
        status.stage: 1e-9 * (status.stamp_ns - status.started_ns)
        for status in heard.alive()
        if 0 < status.started_ns <= status.stamp_ns and status.reason != STANDING_BY
    }
    oldest = max(ages.values(), default=0.0)
    for stage, age in ages.items():
        if age < min(YOUNG_S, oldest - APART_S):
            yield Finding(
                f"{stage} was started again {age:.0f} s ago, while others have run for "
                f"{oldest:.0f} s",
                "if nobody did that, it ends again and again: its last words before that are in "
                f"logs/{stage}.log or docker compose logs {stage}",
            )


def _instances(heard: Heard) -> Iterator[Finding]:
    by_stage: dict[str, list[str]] = {}
    for stage, instance in sorted(heard.living):
        by_stage.setdefault(stage, []).append(instance)
    for stage, instances in by_stage.items():
        if len(instances) > 1 and not (stage in ROWS and ROWS[stage].replicas):
            yield Finding(
                f"{len(instances)} instances of {stage} are at work: {', '.join(instances)}",
                "stop one of them; if they are of two robots, give each a name of its own (robot)",
            )
    versions = {s.stage: s.version for s in heard.alive() if s.version}
    if len(set(versions.values())) > 1:
        said = ", ".join(f"{stage} {version}" for stage, version in sorted(versions.items()))
        yield Finding(
            f"the stages are of different versions: {said}", "bring all up to one version"
        )


def _tokens(heard: Heard) -> Iterator[Finding]:
    """A standby that takes over or a stage that starts may declare a token before it answers:
    only one that leaves a stage without a working instance is a fault."""
    for claim in sorted(heard.strangers):
        silent = [status.is_silent for status in heard.of(claim.stage)]
        yield Finding(
            f"a token of {claim.stage} ({claim.instance}, term {claim.term}) is there, and no such "
            "instance answers",
            f"if it silences {claim.stage}: zloam handover {claim.stage} lets that work again; "
            "unless the instance is starting, the token is a stranger's, whom TLS and roles keep "
            "out (deploy/README.md)",
            is_fault=bool(silent) and all(silent),
        )


def _health(heard: Heard) -> Iterator[Finding]:
    for status in heard.alive():
        if status.health in ("degraded", "failed"):
            yield Finding(
                f"{status.stage} is {status.health}: {status.reason or 'without a reason'}",
                "see what it says; zloam watch shows whether it goes on",
            )


def _drops(heard: Heard) -> Iterator[Finding]:
    for who, status in heard.after.items():
        if who not in heard.living:
            continue
        before = heard.before.get(who)
        for each in status.inputs:
            old = before.input(each.key) if before else None
            key = each.key.rsplit("/", 1)[-1]
            for reason, do in DROPS.items():
                count = _dropped_since(old, each, reason)
                if count > 0:
                    why = _pace_of(status.stage, heard, old, each) if reason == FULL else ""
                    yield Finding(f"{status.stage} dropped {count} of {key} as {reason}{why}", do)
            lost = each.lost - (old.lost if old else 0)
            if lost > 0:
                yield Finding(
                    f"{status.stage} misses {lost} of {key} that nobody has any more",
                    "a link was down or overloaded: see the network between the stages' machines",
                )
            if old and is_stuck(old, each):
                yield Finding(
                    f"{status.stage} takes more than {heard.seconds:.0f} s for one message of "
                    f"{key}",
                    SLOW_ONE,
                )


def _dropped_since(old: Input | None, new: Input, reason: str) -> int:
    return new.dropped.get(reason, 0) - (old.dropped.get(reason, 0) if old else 0)


def _pace_of(stage: str, heard: Heard, old: Input | None, new: Input) -> str:
    """How long a stage with a full queue took for each message; empty: it was not seen before."""
    if old is None:
        return ""
    done = new.processed - old.processed
    if done <= 0:
        return f": {stage} takes more than {heard.seconds:.0f} s for one"
    return f": {stage} takes {1000 * heard.seconds / done:.0f} ms for one"


def is_stuck(before: Input, after: Input) -> bool:
    """True if a stage worked on the same message all the time while others arrived."""
    at_one = before.in_work > 0 and after.in_work > 0 and before.processed == after.processed
    return at_one and after.received > before.received


def _poses(heard: Heard) -> Iterator[Finding]:
    if not heard.poses:
        # After the end of a run none is due. A recording of a whole replay also ends so, and the
        # poses in it count.
        if not any(s.end_of_run for s in heard.alive()):
            yield Finding(
                f"no pose came within {heard.seconds:.0f} s",
                "what is said above comes first; else zloam status shows how far sweeps get",
            )
        return
    states = Counter(pose_health(pose.health) for pose in heard.poses)
    for state, do in (
        ("lost", "drive back to where it was, or zloam place --x X --y Y --yaw DEG"),
        ("bridging", "it looks for its place in the map: wait, or zloam place"),
        ("predicted", "nothing near that it could be measured by: an IMU helps"),
        (
            "too few points",
            "see driver.min_range_m, max_range_m, masks, and what covers the sensor",
        ),
    ):
        if count := states[state]:
            yield Finding(f"{count} of {len(heard.poses)} poses are {state}", do)
    weak = sum(pose.degenerate for pose in heard.poses)
    if weak > 0.1 * len(heard.poses):
        yield Finding(
            f"{weak} of {len(heard.poses)} poses have a direction that nothing fixes",
            "a corridor, a tunnel or a field: an IMU helps; the covariance tells how far it drifts",
        )


def _pace(heard: Heard) -> Iterator[Finding]:
    instants = sorted(pose.instant_ns for pose in heard.poses)
    if len(instants) < 3:
        return
    steps = sorted(b - a for a, b in pairwise(instants))
    period_s = 1e-9 * steps[len(steps) // 2]
    turns = heard.configs.get("driver", {}).get("driver.source") not in NOT_TURNING
    if turns and period_s > 0 and not SLOWEST_HZ <= 1.0 / period_s <= FASTEST_HZ:
        yield Finding(
            f"the sensor turns {1.0 / period_s:.1f} times a second",
            "5 to 20 are expected: set its rotation rate on its own page",
        )
    # Times are taken from the traces of sweeps: the percentiles in a status are of the whole run.
    # Not those of a stage that drops sweeps: of some it may only predict the pose, in no time.
    _, work = latency.samples(heard.poses, heard.mapped)
    overrun = _overrun(heard)
    for stage in STAGES:
        if stage in overrun:
            continue
        mean_ms = _mean_without_longest(work.get(stage, []))
        if period_s > 0 and mean_ms > 1000.0 * SLOW * period_s:
            yield Finding(
                f"{stage} takes {mean_ms:.0f} ms for a sweep on average, and one comes every "
                f"{1000 * period_s:.0f} ms",
                SLOW_ONE,
            )


def _overrun(heard: Heard) -> set[str]:
    """Stages that dropped messages because their queue was full; _drops() reports their pace."""
    return {
        status.stage
        for who, status in heard.after.items()
        for each in status.inputs
        if (before := heard.before.get(who))
        and (old := before.input(each.key))
        and _dropped_since(old, each, FULL) > 0
    }


def _mean_without_longest(times_ms: Sequence[float]) -> float:
    """The mean tells whether a stage keeps up, also where only some of the sweeps take long. The
    longest is left out, because a single sweep may be delayed by anything; not of one or two
    sweeps, which are all that a slow stage finishes in this time."""
    if len(times_ms) < 3:
        return sum(times_ms) / max(1, len(times_ms))
    return (sum(times_ms) - max(times_ms)) / (len(times_ms) - 1)


def _settings(heard: Heard) -> Iterator[Finding]:
    for stage in sorted(heard.unanswered):
        yield Finding(
            f"{stage} is alive, but did not tell its configuration",
            "it hangs, or its machine or the link to it is overloaded: see its log",
        )
    said: dict[str, dict[str, list[str]]] = {}
    for stage, values in heard.configs.items():
        for key, value in values.items():
            if key.startswith(SHARED):
                said.setdefault(key, {}).setdefault(json.dumps(value), []).append(stage)
    for key, values in sorted(said.items()):
        if len(values) > 1:
            each = "; ".join(f"{value} in {', '.join(stages)}" for value, stages in values.items())
            yield Finding(
                f"{key} differs between stages: {each}", "start all with one robot's file"
            )
    by_socket = {
        status.stage: None
        for status in heard.alive()
        if heard.configs.get(status.stage, {}).get("zenoh.shared_memory")
        and _large_by_socket(status.memory)
    }
    if by_socket:
        do = "does" if len(by_socket) == 1 else "do"
        yield Finding(
            f"{', '.join(by_socket)} {do} not receive through shared memory, though "
            "zenoh.shared_memory is on",
            "messages come over sockets: their sender is on another machine, or sender or receiver "
            "may not lock memory (ulimit -l), or found no room in /dev/shm (df -h /dev/shm; "
            "docker's --shm-size, zenoh.pool_mib): its log says which",
            is_fault=False,
        )


def _large_by_socket(memory: dict[str, int]) -> bool:
    """True if large messages came over sockets; small ones always do."""
    messages = memory.get("messages_net", 0)
    if memory.get("messages_shm") or not messages:
        return False
    return memory.get("bytes_in_place", 0) + memory.get("bytes_copied", 0) > LARGE_BYTES * messages
