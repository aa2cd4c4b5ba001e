"""The doctor names each fault, and finds nothing in a healthy robot."""

from __future__ import annotations

import re
import tracemalloc
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fake_session import needs_schemas
from zloam_monitor import cli, compose, doctor, doctor_files
from zloam_monitor.doctor import findings
from zloam_monitor.doctor_files import of_counts
from zloam_monitor.heard import Heard
from zloam_monitor.recordings.robot_log import Logged
from zloam_monitor.records import HEALTH, Input, PoseRecord, StatusRecord, TraceStep
from zloam_monitor.stages import STAGES
from zloam_monitor.tokens import Claim


def status(stage: str, later: bool = False, **more: Any) -> StatusRecord:
    """Status of a healthy stage; later: at the end of the listening time."""
    count = 150 if later else 100
    given = {
        "health": "ready", "reason": "", "stamp_ns": 10 if later else 5, "run": 1,
        "last_sweep": count, "end_of_run": False, "published": {},
        "figures": {"packets_received": 754.0 * count, "packets_lost": 3.0, "clock_steps": 1.0},
        "latencies": {"work": {"p50": 5.0, "p95": 8.0, "p99": 9.0}}, "cpu_ms": 1.0,
        "rss_mib": {"start": 1.0, "end": 1.0, "peak": 1.0}, "version": "0.1.0",
        # Small messages, like those of integration.
        "memory": {"messages_shm": 0, "messages_net": count, "bytes_copied": 900 * count},
        "inputs": (Input("loam/r/sweep", count, count, 0, 0, 0, {"queue_full": 4}, 2, 1),),
    }  # fmt: skip
    return StatusRecord(stage=stage, instance=f"{stage}-1", **{**given, **more})


def pose(number: int, health: str = "ok", **more: Any) -> PoseRecord:
    unit = np.array([0.0, 0.0, 0.0, 1.0])
    at = number * 100_000_000
    return PoseRecord(1, number, at, np.zeros(3), unit, HEALTH.index(health), 0, False, (), **more)


def worked(number: int, stage: str, ms: float) -> PoseRecord:
    return replace(pose(number), trace=(TraceStep(stage, 1, 1, 1 + int(1e6 * ms)),))


def well() -> Heard:
    before = {(s, f"{s}-1"): status(s) for s in STAGES}
    after = {(s, f"{s}-1"): status(s, later=True) for s in STAGES}
    shared = {"robot": "r", "mounting.xyz_m": [0.0, 0.0, 1.0], "zenoh.shared_memory": True}
    configs = dict.fromkeys(STAGES, shared)
    return Heard(
        "r", 5.0, before, after, dict.fromkeys(after, 0.5), set(after),
        [pose(n) for n in range(50)], configs,
    )  # fmt: skip


def changed(heard: Heard, stage: str, **more: Any) -> Heard:
    who = (stage, f"{stage}-1")
    return replace(heard, after={**heard.after, who: status(stage, later=True, **more)})


def test_a_healthy_robot_has_nothing() -> None:
    assert findings(well()) == []


@pytest.mark.parametrize("source", doctor.NOT_TURNING)
def test_a_lidar_that_does_not_turn_has_no_rotation_rate(source: str) -> None:
    """A scanner on a motor with sweeps of two seconds, clouds at 30 Hz: both are supported."""
    configs = {**well().configs, "driver": {"driver.source": source}}
    for steps in (20, 1 / 3):
        poses = [replace(pose(n), instant_ns=round(n * steps * 1e8)) for n in range(20)]
        assert findings(replace(well(), poses=poses, configs=configs)) == []


def figures(**more: float) -> dict[str, float]:
    return {**status("driver", later=True).figures, **more}


def dropped(reason: str) -> tuple[Input, ...]:
    (given,) = status("mapping", later=True).inputs
    return (replace(given, dropped={**given.dropped, reason: 30}),)


def at_one_sweep(heard: Heard, stage: str) -> Heard:
    """A stage that works on the same sweep at the beginning and at the end."""
    who = (stage, f"{stage}-1")
    before = heard.before[who]
    (given,) = before.inputs
    at_one = replace(given, received=100, processed=99, in_work=1)
    later = replace(at_one, received=150, queued=50)
    return replace(
        changed(heard, stage, inputs=(later,)),
        before={**heard.before, who: replace(before, inputs=(at_one,))},
    )


WRONG: dict[str, tuple[Heard, str]] = {
    "a stage is missing": (
        replace(well(), living=well().living - {("odometry", "odometry-1")}),
        "odometry is not there",
    ),
    "a stage hangs": (
        replace(well(), silent_s={**well().silent_s, ("mapping", "mapping-1"): 30.0}),
        "mapping (mapping-1) has said nothing since 30 s",
    ),
    "a stranger's token": (
        replace(
            changed(well(), "mapping", figures={"silent": 1.0}),
            strangers=frozenset({Claim("mapping", "ghost", 9, 0)}),
        ),
        "a token of mapping (ghost, term 9) is there, and no such instance answers",
    ),
    "a stage that tells no configuration": (
        replace(well(), unanswered=frozenset({"mapping"})),
        "mapping is alive, but did not tell its configuration",
    ),
    "a thin link": (replace(well(), late_s=20.0), "arrives 20 s later than at first"),
    "started again": (
        replace(
            well(),
            after={
                who: replace(
                    s, started_ns=(290 if who[0] == "mapping" else 1) * 10**9, stamp_ns=300 * 10**9
                )
                for who, s in well().after.items()
            },
        ),
        "mapping was started again 10 s ago, while others have run for 299 s",
    ),
    "two drivers": (
        replace(
            well(),
            living=well().living | {("driver", "driver-2")},
            silent_s={**well().silent_s, ("driver", "driver-2"): 0.5},
        ),
        "2 instances of driver are at work: driver-1, driver-2",
    ),
    "degraded": (
        changed(well(), "mapping", health="degraded", reason="map not written: disk full"),
        "mapping is degraded: map not written: disk full",
    ),
    "no packets": (
        changed(well(), "driver", figures=figures(packets_received=75_400.0)),
        "no packets came to the driver within 5 s",
    ),
    "packets lost": (
        changed(well(), "driver", figures=figures(packets_lost=503.0)),
        "500 of 38200 packets were lost",
    ),
    "kernel drops": (
        changed(well(), "driver", figures=figures(kernel_drops=7.0)),
        "the kernel dropped packets (7 within 5 s)",
    ),
    "sensor's clock set": (
        changed(well(), "driver", figures=figures(clock_steps=2.0)),
        "the sensor's clock was set",
    ),
    "too slow": (
        changed(well(), "mapping", inputs=dropped("queue_full")),
        "mapping dropped 26 of sweep as queue_full",
    ),
    "a second robot of one name": (
        changed(well(), "mapping", inputs=dropped("wrong_run")),
        "mapping dropped 30 of sweep as wrong_run",
    ),
    "messages that were written over": (
        changed(well(), "mapping", inputs=dropped("torn")),
        "mapping dropped 30 of sweep as torn",
    ),
    "which is slow": (
        replace(well(), mapped=[worked(n, "mapping", 110.0) for n in range(50)]),
        "mapping takes 110 ms for a sweep on average, and one comes every 100 ms",
    ),
    "which is slow with every third sweep": (
        replace(
            well(), mapped=[worked(n, "mapping", 2.0 if n % 3 else 600.0) for n in range(50)]
        ),
        "mapping takes 197 ms for a sweep on average",
    ),
    "which is slow and has done one": (
        replace(well(), mapped=[worked(0, "mapping", 900.0)]),
        "mapping takes 900 ms for a sweep on average",
    ),
    "which is slow and drops what it has no time for": (
        changed(
            replace(well(), mapped=[worked(n, "mapping", 1.0) for n in range(50)]),
            "mapping",
            inputs=(replace(dropped("queue_full")[0], processed=104),),
        ),
        "mapping dropped 26 of sweep as queue_full: mapping takes 1250 ms for one",
    ),
    "which has not even done one": (
        at_one_sweep(well(), "mapping"),
        "mapping takes more than 5 s for one message of sweep",
    ),
    "rotation rate": (
        replace(well(), poses=[pose(3 * n) for n in range(20)]),
        "the sensor turns 3.3 times a second",
    ),
    "no pose": (replace(well(), poses=[]), "no pose came within 5 s"),
    "lost": (
        replace(well(), poses=[pose(n, "lost") for n in range(50)]), "50 of 50 poses are lost"
    ),
    "degenerate": (
        replace(well(), poses=[pose(n, degenerate=True) for n in range(50)]),
        "50 of 50 poses have a direction that nothing fixes",
    ),
    "configurations differ": (
        replace(well(), configs={**well().configs, "mapping": {"mounting.xyz_m": [0.0, 0.0, 0.0]}}),
        "mounting.xyz_m differs between stages",
    ),
    "versions differ": (
        changed(well(), "mapping", version="0.2.0"),
        "the stages are of different versions: driver 0.1.0",
    ),
    "no shared memory": (
        changed(well(), "odometry", memory={"messages_net": 50, "bytes_copied": 50 * 300_000}),
        "odometry does not receive through shared memory",
    ),
}  # fmt: skip


def test_stages_without_shared_memory_are_one_finding() -> None:
    """One small /dev/shm is the cause for all."""
    memory = {"messages_net": 50, "bytes_copied": 50 * 300_000}
    heard = changed(WRONG["no shared memory"][0], "mapping", memory=memory)
    (found,) = findings(heard)
    assert found.what.endswith(
        "do not receive through shared memory, though zenoh.shared_memory is on"
    )
    assert "odometry" in found.what
    assert "mapping" in found.what
    assert "/dev/shm" in found.do


def test_one_sweep_that_took_long_makes_no_stage_slow() -> None:
    mapped = [worked(n, "mapping", 9000.0 if n == 7 else 20.0) for n in range(50)]
    assert findings(replace(well(), mapped=mapped)) == findings(well())


@pytest.mark.parametrize("name", WRONG)
def test_each_fault_is_named_alone(name: str) -> None:
    heard, words = WRONG[name]
    found = findings(heard)
    assert any(words in finding.what for finding in found), found
    assert all(finding.do for finding in found)
    assert len(found) == 1, found


def test_a_clock_that_is_set_back_makes_no_stage_young() -> None:
    """Of one that was started before, the age is below zero, and unknown."""
    young = {"started_ns": 30 * 10**9, "stamp_ns": 60 * 10**9}
    heard = changed(well(), "mapping", **young)
    for stage in STAGES:
        if stage != "mapping":
            heard = changed(heard, stage, **{**young, "started_ns": 3600 * 10**9})
    assert findings(heard) == []


def test_packets_to_another_port_are_told_beside_their_absence() -> None:
    quiet = figures(packets_received=75_400.0, datagrams_to_closed_ports=3770.0)
    found = [finding.what for finding in findings(changed(well(), "driver", figures=quiet))]
    assert found == [
        "no packets came to the driver within 5 s",
        "3770 datagrams came to UDP ports on which no program listens",
    ]
    # While packets come, the datagrams on closed ports are not the sensor's.
    noisy = figures(datagrams_to_closed_ports=3770.0)
    assert findings(changed(well(), "driver", figures=noisy)) == []


def ended(heard: Heard) -> Heard:
    """The same robot after the end of its run."""
    for stage in STAGES:
        same = status(stage).figures
        heard = changed(heard, stage, end_of_run=True, figures=same)
    return heard


def test_the_end_of_a_replay_is_no_fault() -> None:
    assert findings(ended(replace(well(), poses=[]))) == []


def test_lost_poses_are_found_in_a_recording_that_has_the_end_of_its_run() -> None:
    lost = [pose(n, "lost") for n in range(50)]
    found = [finding.what for finding in findings(ended(replace(well(), poses=lost)))]
    assert found == ["50 of 50 poses are lost"]


GOOD = {"points": 1e6, "sweeps": 50, "complete": 48, "packets_received": 3800, "packets_lost": 0}


def test_the_poses_of_a_long_recording_take_little_memory() -> None:
    """Whole, a pose takes 3 kB, of both kinds 5 GB for each day at 10 Hz."""
    needs_schemas()
    trace = tuple((stage, 1, 2, 3) for stage in STAGES)

    def message(n: int) -> bytes:
        head, upright = compose.HeaderValues(1, n, n, trace=trace), (0.0, 0.0, 0.0, 1.0)
        cells = np.eye(6).ravel()
        return compose.pose("MapPose", head, n, (0, 0, 0), upright, n % 2, cells)

    said = [
        Logged(f"loam/robot/{topic}", doctor_files.POSE, n, message(n))
        for n in range(1000)
        for topic in ("pose", "map/odometry")
    ]
    log: Any = SimpleNamespace(messages=lambda _: iter(said))
    doctor_files._Said(log)  # Code that is imported at the first pose takes memory, too.
    tracemalloc.start()
    found = doctor_files._Said(log)
    taken, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (len(found.poses), len(found.mapped), found.garbage) == (1000, 1000, 0)
    assert [pose.health for pose in found.poses] == [0, 1] * 500
    assert taken / len(said) < 500.0


@pytest.mark.parametrize(
    ("counts", "words"),
    [
        ({**GOOD, "packets_received": 0}, "no packet of a lidar"),
        ({**GOOD, "packets_lost": 3700, "complete": 0}, "another pace than the model"),
        ({**GOOD, "packets_lost": 100}, "100 of 3900 packets are missing"),
        ({**GOOD, "frames_cut": 9}, "frames are cut off (9)"),
        ({**GOOD, "points": 0}, "no packet of it could be decoded"),
        ({**GOOD, "packets_unknown_model": 12}, "a model that is not known (12)"),
    ],
)
def test_a_captures_faults(counts: dict[str, float], words: str) -> None:
    assert of_counts(GOOD, []) == []
    assert any(words in finding.what for finding in of_counts(counts, []))


def test_what_is_no_file_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", str(tmp_path / "none.pcap")]) == 3
    assert "none.pcap" in capsys.readouterr().err


def test_words_for_every_reason_that_stages_count() -> None:
    source = Path(__file__).resolve().parents[3] / "services/common/runtime/account.cpp"
    names = re.search(r"kNames = \{(.*?)\};", source.read_text(), re.S)
    assert names is not None
    counted = set(re.findall(r'"(\w+)"', names[1]))
    # A duplicate is no fault, and of a failed sweep the stage's own health tells.
    assert {"duplicate", "failed"} < counted
    assert set(doctor.DROPS) == counted - {"duplicate", "failed"}
