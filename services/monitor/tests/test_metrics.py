"""Metrics can be parsed, agree with the statuses, and include all that alerts and dashboard use."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.exposition import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from zloam_monitor.keys import Keys
from zloam_monitor.metrics import Seen
from zloam_monitor.records import Input, PoseRecord, StatusRecord

ROOT = Path(__file__).resolve().parents[3]
OBSERVABILITY = ROOT / "deploy/observability"
#: Words of PromQL, Prometheus's own metric, and names of labels.
WORDS = {
    *("max", "sum", "count", "rate", "by", "on", "unless", "or", "and", "absent"),
    *("count_over_time", "min_over_time", "resets", "predict_linear"),
    "up",
    *("robot", "stage", "instance", "job", "state", "reason", "name", "quantile"),
}


def status(stage: str, instance: str = "a", **more: Any) -> StatusRecord:
    given = {
        "health": "ready", "reason": "", "stamp_ns": 5, "run": 1, "last_sweep": 9,
        "end_of_run": False, "published": {"pose": 10}, "figures": {"packets_lost": 3.0},
        "latencies": {"pose": {"p50": 2.0, "p95": 3.0, "p99": 4.0}}, "cpu_ms": 1500.0,
        "rss_mib": {"start": 1.0, "end": 50.0, "peak": 60.0},
        "inputs": (Input("sweep", 12, 10, 0, 1, 0, {"queue_full": 1}, 2, 1),),
    }  # fmt: skip
    return StatusRecord(stage=stage, instance=instance, **{**given, **more})


def pose(sweep: int, health: int = 0) -> PoseRecord:
    unit = np.array([0.0, 0.0, 0.0, 1.0])
    return PoseRecord(1, sweep, sweep, np.array([1.0, 2.0, 3.0]), unit, health, 0, False, ())


class Heard:
    """A stand-in for a link."""

    def __init__(self, statuses: list[StatusRecord], poses: list[PoseRecord]) -> None:
        self.keys = Keys("robot")
        self.statuses = {(s.stage, s.instance): s for s in statuses}
        self.poses = {p.sweep: p for p in poses}
        self.run = 1
        self.silent = 0.5
        #: Instance -> age of its status, if it is another.
        self.silent_of: dict[str, float] = {}

    def silent_s(self, status: StatusRecord, _now: float) -> float:
        return self.silent_of.get(status.instance, self.silent)


def samples(heard: Heard, seen: Seen | None = None) -> dict[tuple[str, str], float]:
    """(name, labels) -> value, parsed by the format's own parser."""
    seen = seen or Seen("robot")
    link: Any = heard
    seen.take(link)
    registry = CollectorRegistry()
    registry.register(seen)
    text = generate_latest(registry).decode()  # type: ignore[no-untyped-call]
    found = {}
    for family in text_string_to_metric_families(text):  # type: ignore[no-untyped-call]
        for sample in family.samples:
            labels = ",".join(v for k, v in sorted(sample.labels.items()) if k != "robot")
            found[(sample.name, labels)] = float(sample.value)
    return found


def test_it_says_what_the_statuses_say() -> None:
    found = samples(Heard([status("mapping")], [pose(4), pose(5)]))
    assert found[("zloam_up", "a,mapping")] == 1.0
    # Stages that were never heard are down.
    assert found[("zloam_up", ",odometry")] == 0.0
    assert found[("zloam_health", "a,mapping,ready")] == 1.0
    assert found[("zloam_health", "a,mapping,failed")] == 0.0
    assert found[("zloam_cpu_seconds_total", "a,mapping")] == 1.5
    assert found[("zloam_resident_bytes", "a,mapping")] == 50 * 1024**2
    assert found[("zloam_latency_seconds", "a,pose,0.99,mapping")] == 0.004
    assert found[("zloam_received_total", "a,sweep,mapping")] == 12
    assert found[("zloam_dropped_total", "a,sweep,queue_full,mapping")] == 1
    assert found[("zloam_lost_total", "a,sweep,mapping")] == 2
    assert found[("zloam_published_total", "a,pose,mapping")] == 10
    assert found[("zloam_figure", "a,packets_lost,mapping")] == 3
    assert found[("zloam_poses_total", "")] == 2
    assert found[("zloam_pose_position_metres", "z")] == 3.0
    assert found[("zloam_pose_health", "ok")] == 1.0


def test_silence_is_down() -> None:
    heard = Heard([status("mapping")], [])
    heard.silent = 6.0
    found = samples(heard)
    assert found[("zloam_up", "a,mapping")] == 0.0
    assert found[("zloam_status_age_seconds", "a,mapping")] == 6.0
    assert ("zloam_pose_age_seconds", "") not in found


def instances(found: dict[tuple[str, str], float], name: str) -> dict[str, float]:
    return {labels: value for (own, labels), value in found.items() if own == name}


def test_a_stage_that_was_restarted_no_longer_says_what_it_said_before() -> None:
    """Neither by its killed instance nor by the one before, whose stamp is of the time before the
    robot's clock was set back."""
    heard = Heard(
        [
            status("mapping", "first", health="failed", stamp_ns=10**18),
            status("mapping", "killed", health="degraded"),
            status("mapping", "new"),
        ],
        [],
    )
    heard.silent_of = {"first": 3600.0, "killed": 60.0}
    found = samples(heard)
    of_mapping = {k: v for k, v in instances(found, "zloam_up").items() if k.endswith("mapping")}
    assert of_mapping == {"new,mapping": 1.0}
    health = instances(found, "zloam_health")
    assert {labels for labels, value in health.items() if value} == {"new,mapping,ready"}
    # While none is there, its newest one is the silent one, and says nothing of its health.
    heard.silent_of["new"] = 6.0
    found = samples(heard)
    assert instances(found, "zloam_status_age_seconds") == {"new,mapping": 6.0}
    assert found[("zloam_up", "new,mapping")] == 0.0
    assert instances(found, "zloam_health") == instances(found, "zloam_uptime_seconds") == {}


def test_the_time_since_a_start_is_by_the_robot_s_clock() -> None:
    given = {"a": (7 * 10**9, 3 * 10**9), "set back": (3 * 10**9, 7 * 10**9)}
    heard = [status("driver", n, stamp_ns=s, started_ns=b) for n, (s, b) in given.items()]
    found = instances(samples(Heard(heard, [])), "zloam_uptime_seconds")
    assert found == {"a,driver": 4.0, "set back,driver": 0.0}


def test_poses_are_counted_once() -> None:
    heard, seen = Heard([], [pose(n) for n in range(1000)]), Seen("robot")
    samples(heard, seen)
    heard.poses[1000] = pose(1000, health=9)
    found = samples(heard, seen)
    assert found[("zloam_poses_total", "")] == 1001
    assert found[("zloam_pose_health", "lost")] == 1.0
    heard.run, heard.poses = 2, {0: pose(0)}
    assert samples(heard, seen)[("zloam_poses_total", "")] == 1002


def test_a_strangers_instances_are_bounded() -> None:
    many = [status("mapping", f"i{n}", stamp_ns=n) for n in range(500)]
    found = samples(Heard(many, []))
    assert sum(name == "zloam_up" and ",mapping" in labels for name, labels in found) == 16


def test_a_strangers_stages_are_bounded_and_end() -> None:
    """Else each would be a time series, and an alert that it is silent, for ever."""
    heard = Heard(
        [status(f"odd{n}") for n in range(500)] + [status("mapping"), status("store")], []
    )
    up = {labels: value for (name, labels), value in samples(heard).items() if name == "zloam_up"}
    assert sum("odd" in labels for labels in up) == 16
    heard.silent = 6.0
    up = {labels: value for (name, labels), value in samples(heard).items() if name == "zloam_up"}
    assert [each for each in up if "odd" in each] == []
    assert up["a,mapping"] == up["a,store"] == 0.0


def test_a_stage_beside_the_chain_that_was_stopped_is_not_missed() -> None:
    """Else its alert would fire until `zloam metrics` is started again. One that was killed, and
    a stage of the chain, are missed."""
    heard = Heard([status(name, health="stopping") for name in ("store", "mapping")], [])
    heard.statuses["graph", "a"] = status("graph")
    assert instances(samples(heard), "zloam_up")["a,store"] == 1.0
    heard.silent = 6.0
    up = instances(samples(heard), "zloam_up")
    assert {each: up[each] for each in up if each.startswith("a,")} == {
        "a,mapping": 0.0,
        "a,graph": 0.0,
    }


def alerts() -> list[dict[str, Any]]:
    (group,) = yaml.safe_load((OBSERVABILITY / "alerts.yml").read_text())["groups"]
    return list(group["rules"])


def dashboard() -> list[str]:
    made = json.loads((OBSERVABILITY / "dashboard.json").read_text())
    return [target["expr"] for panel in made["panels"] for target in panel["targets"]]


def test_alerts_and_dashboard_ask_for_what_is_there() -> None:
    found = samples(Heard([status("mapping")], [pose(1)]))
    names = {name for name, _ in found}
    for expression in [*dashboard(), *(alert["expr"] for alert in alerts())]:
        plain = re.sub(r'"[^"]*"|\$\w+|\[[^\]]*\]', "", expression)
        asked = set(re.findall(r"[a-z_]{2,}", plain)) - WORDS
        assert asked, expression
        assert asked <= names, expression


def test_the_dashboard_shows_each_of_several_robots() -> None:
    """All of them are chosen at first: a stage that is down in one must not be hidden by another
    robot's of the same name."""
    for panel in json.loads((OBSERVABILITY / "dashboard.json").read_text())["panels"]:
        for target in panel["targets"]:
            assert "{{robot}}" in target["legendFormat"], panel["title"]
            for labels in re.findall(r"\bby \(([^)]*)\)", target["expr"]):
                assert "robot" in labels.split(", "), panel["title"]


def test_reasons_of_drops_are_those_that_stages_count() -> None:
    known = set(re.findall(r'"(\w+)"', (ROOT / "services/common/runtime/account.cpp").read_text()))
    for alert in alerts():
        for reasons in re.findall(r'reason=~"([^"]*)"', alert["expr"]):
            assert set(reasons.split("|")) <= known, alert["alert"]


def test_each_alert_has_a_case_in_which_it_fires_and_one_in_which_it_does_not() -> None:
    cases = yaml.safe_load((OBSERVABILITY / "alerts_test.yml").read_text())["tests"]
    checks = [check for case in cases for check in case["alert_rule_test"]]
    for alert in (rule["alert"] for rule in alerts()):
        own = [check for check in checks if check["alertname"] == alert]
        assert any("exp_alerts" in check for check in own), alert
        assert any("exp_alerts" not in check for check in own), alert


def test_prometheus_agrees() -> None:
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("no promtool (Debian package prometheus)")
    for words in (("check", "rules", "alerts.yml"), ("test", "rules", "alerts_test.yml")):
        done = subprocess.run(
            [promtool, *words], cwd=OBSERVABILITY, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_time_since_the_last_pose_grows() -> None:
    heard, seen = Heard([], [pose(1)]), Seen("robot")
    first = samples(heard, seen)[("zloam_pose_age_seconds", "")]
    time.sleep(0.05)
    assert samples(heard, seen)[("zloam_pose_age_seconds", "")] >= first + 0.04
