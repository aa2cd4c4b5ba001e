"""Tests the orchestration with stand-ins for the stages: good runs, and reports of failures."""

from __future__ import annotations

import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fake_stage import SWEEPS, loop
from zloam_monitor import cli, clouds, live, messages, terminal, trajectory
from zloam_monitor.chain import STOOD_BY, BinariesMissing, Chain, binary
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.processes import endpoints, free_base_port
from zloam_monitor.report import accounted
from zloam_monitor.stages import PORT_ORDER, STAGES, standby_of
from zloam_monitor.watch import STALE_SECONDS, view

HERE = Path(__file__).parent


@pytest.fixture
def build(tmp_path: Path) -> Path:
    """A build folder with the stand-ins as programs."""
    try:
        schemas = messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))
    (tmp_path / "bin").mkdir()
    paths = os.pathsep.join([str(HERE), str(HERE.parent / "src"), str(schemas)])
    for stage in STAGES:
        program = tmp_path / "bin" / f"zloam-{stage}"
        program.write_text(
            f"#!/bin/sh\nPYTHONPATH={paths} exec {sys.executable} "
            f'{HERE / "fake_stage.py"} {stage} "$@"\n'
        )
        program.chmod(0o755)
    (tmp_path / "robot.yaml").write_text("robot: robot\n")
    (tmp_path / "capture.pcap").write_bytes(b"")
    return tmp_path


def demo(build: Path, *more: str) -> int:
    return cli.main(
        [
            "demo",
            "--preset-dir",
            str(build),
            "--config",
            str(build / "robot.yaml"),
            "--pcap",
            str(build / "capture.pcap"),
            "--out",
            str(build / "out"),
            *more,
        ]
    )


def write_truth(path: Path) -> None:
    """Truth of a sensor 1.5 m above base_link, at the stand-ins' instants."""
    stamps = 1_700_000_000_000_000_000 + (np.arange(SWEEPS) + 1) * 100_000_000
    transforms = np.tile(np.eye(4), (SWEEPS, 1, 1))
    transforms[:, :3, 3] = loop() + np.array([5, 6, 7 + 1.5])
    trajectory.write_tum(path, trajectory.Trajectory(transforms, stamps, np.arange(SWEEPS)))


def test_demo_writes_everything_and_accounts_for_it(
    build: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_truth(build / "truth.tum")
    assert demo(build, "--truth", str(build / "truth.tum")) == 0
    out = build / "out"
    report = json.loads((out / "report.json").read_text())
    assert report["sweeps"]["driver"]["in"] == SWEEPS
    assert {s: report["sweeps"][s]["out"] for s in STAGES} == dict.fromkeys(STAGES, SWEEPS)
    assert report["identities"]["inputs_balanced"]
    assert report["identities"]["sweeps_accounted"]
    assert report["ate_rmse_m"]["pose"] == pytest.approx(0, abs=1e-6)
    assert report["drift_percent"]["odometry"] == pytest.approx(0, abs=1e-6)
    assert report["latency_ms"]["end_to_end"] is None
    assert report["latency_ms"]["mapping"]["p50"] == pytest.approx(3.0, abs=1e-6)
    assert report["cpu_ms_per_sweep"]["odometry"] == pytest.approx(100 / SWEEPS)
    assert report["rss_mib"]["driver"] == {"start": 10.0, "end": 12.0, "peak": 13.0}
    assert len(trajectory.read(out / "trajectory.tum")) == SWEEPS
    assert len(trajectory.read(out / "trajectory.kitti")) == SWEEPS
    truth = trajectory.read(out / "ground_truth.tum")
    np.testing.assert_allclose(truth.positions, loop() + np.array([5, 6, 7]), atol=1e-8)
    assert len(clouds.read_pcd(out / "map.pcd")) > 1000
    assert (out / "picture.png").stat().st_size > 10_000
    assert "accounted for: yes" in capsys.readouterr().out


def test_without_truth_errors_are_null(build: Path) -> None:
    assert demo(build) == 0
    report = json.loads((build / "out" / "report.json").read_text())
    assert report["ate_rmse_m"] == {"pose": None, "odometry": None}
    assert not (build / "out" / "ground_truth.tum").exists()


def test_books_that_do_not_balance_fail_the_run(
    build: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FAKE_UNBALANCED", "mapping")
    assert demo(build) == 1
    assert "mapping loam/robot/odometry/features does not balance" in capsys.readouterr().out


def test_a_stage_that_dies_is_told_with_its_last_lines(
    build: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FAKE_DIES", "odometry")
    assert demo(build) == 1
    said = capsys.readouterr().err
    assert "odometry ended with exit code 1" in said
    assert "something broke" in said


def test_a_refused_configuration_keeps_its_exit_code(
    build: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FAKE_REFUSES", "driver")
    assert demo(build) == 2
    assert "driver.speed: unknown key" in capsys.readouterr().err


def run(build: Path, *more: str) -> int:
    words = ["run", "--preset-dir", str(build), "--config", str(build / "robot.yaml")]
    return cli.main([*words, "--out", str(build / "out"), "--seconds", "1", *more])


@pytest.mark.parametrize("start", [demo, run])
@pytest.mark.parametrize(
    ("refuses", "option"), [("odometry", ()), ("", ("--record", "robot.yaml"))]
)
def test_a_start_that_is_refused_leaves_the_files_of_the_run_before(
    build: Path,
    monkeypatch: pytest.MonkeyPatch,
    start: Callable[..., int],
    refuses: str,
    option: tuple[str, ...],
) -> None:
    assert demo(build) == 0
    before = {p: p.read_bytes() for p in (build / "out").rglob("*") if p.is_file()}
    assert build / "out/map.pcd" in before
    monkeypatch.setenv("FAKE_REFUSES", refuses)
    monkeypatch.chdir(build)
    assert start(build, *option) in (2, 3)
    assert {p: p.read_bytes() for p in (build / "out").rglob("*") if p.is_file()} == before


SIMULATOR = """#!/bin/sh
seed=$4
while [ $# -gt 0 ]; do
    case $1 in
        --out|--imu) echo "$seed" > "$2" ;;
        --truth) cp "$(dirname "$0")/../truth.tum" "$2"; echo "# $seed" >> "$2" ;;
    esac
    shift
done
"""


@pytest.mark.parametrize("wrong", [(), ("--set", "zenoh.base_port=none"), ("--config", "none")])
def test_a_start_that_is_refused_leaves_the_simulated_recording_of_the_run_before(
    build: Path, monkeypatch: pytest.MonkeyPatch, wrong: tuple[str, ...]
) -> None:
    (build / "bin/zloam-simulator").write_text(SIMULATOR)
    (build / "bin/zloam-simulator").chmod(0o755)
    write_truth(build / "truth.tum")
    words = ["demo", "--preset-dir", str(build), "--out", str(build / "out"), "--imu", "simulated"]
    assert cli.main([*words, "--seed", "3"]) == 0
    before = {p: p.read_bytes() for p in (build / "out").rglob("*") if p.is_file()}
    assert before[build / "out/capture.pcap"] == before[build / "out/imu.csv"] == b"3\n"
    monkeypatch.setenv("FAKE_REFUSES", "odometry")
    assert cli.main([*words, "--seed", "4", *wrong]) in (2, 3)
    assert {p: p.read_bytes() for p in (build / "out").rglob("*") if p.is_file()} == before
    monkeypatch.delenv("FAKE_REFUSES")
    assert cli.main([*words, "--seed", "4"]) == 0
    assert (build / "out/capture.pcap").read_text() == "4\n"


def test_a_bad_exit_code_fails_the_run(
    build: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FAKE_ENDS_BADLY", "integration")
    assert demo(build) == 1
    assert "integration ended with 7" in capsys.readouterr().out


@pytest.mark.parametrize(("stage", "name"), [("integration", "trajectory"), ("mapping", "map")])
def test_a_file_that_a_stage_did_not_write_fails_the_run(
    build: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    stage: str,
    name: str,
) -> None:
    monkeypatch.setenv("FAKE_FULL_DISK", stage)
    assert demo(build) == 3
    said = capsys.readouterr().out
    assert "accounted for: NO: not written:" in said
    assert f"/{name}." in said
    # No empty file takes the place of the missing one.
    assert not (build / "out" / "map.pcd").exists() or stage != "mapping"


def test_missing_binaries_and_truth_are_said_before_the_start(
    build: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert demo(build, "--truth", str(build / "none.tum")) == 3
    assert "none.tum" in capsys.readouterr().err
    assert cli.main(["demo", "--preset-dir", str(tmp_path / "none")]) == 1
    assert "build it first (make build)" in capsys.readouterr().err


def test_live_run_says_what_is_missing_and_writes_at_the_end(
    build: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FAKE_QUIET", "driver")
    assert run(build) == 1  # No sweep came, so nothing is accounted for.
    said = capsys.readouterr().out
    assert "no packets on UDP 2368 for 3 s" in said
    assert "accounted for: NO: no sweep came: there is nothing to account for" in said
    assert (build / "out" / "report.json").exists()
    # No empty file may look like a drive.
    assert not list((build / "out").glob("*.tum"))


def test_where_data_are_missing_is_the_drivers_place() -> None:
    scanner = {"driver.source": "scip", "driver.path": "/dev/ttyACM0", "driver.port": 2368}
    place, advice = live.data_place({"mapping": {}, "driver": scanner})
    assert place == "/dev/ttyACM0"
    assert "UDP" not in advice
    place, advice = live.data_place({"driver": {"driver.source": "udp", "driver.port": 7502}})
    assert place == "UDP 7502"
    assert "firewall" in advice


def until_sweep(build: Path) -> subprocess.Popen[str]:
    """A live run as a program of its own, which has said that sweeps come."""
    words = ["run", "--preset-dir", build, "--config", build / "robot.yaml", "--out", build / "out"]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parent / "src"), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        [sys.executable, "-m", "zloam_monitor", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        text=True,
    )
    assert process.stdout is not None
    while not process.stdout.readline().startswith("sweep"):
        assert process.poll() is None
    return process


def test_interrupted_live_run_writes_what_it_has(build: Path) -> None:
    with until_sweep(build) as process:
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate()
    assert "writing trajectory and map" in rest
    assert len(trajectory.read(build / "out" / "trajectory.tum")) > 0
    assert (build / "out" / "map.pcd").exists()


def test_a_live_run_is_reported_though_nobody_reads_its_end(build: Path) -> None:
    """Ctrl-C ends the other programs of a pipeline at once, as `tee` of `zloam run | tee log`."""
    with until_sweep(build) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == ""
    report = json.loads((build / "out" / "report.json").read_text())
    assert process.returncode == (0 if accounted(report) else 1)
    assert len(trajectory.read(build / "out" / "trajectory.tum")) > 0


def test_a_live_run_ends_in_order_when_its_reader_has_ended(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    silenced = []
    monkeypatch.setattr(terminal, "silence", lambda: silenced.append(True))
    with live._until_unheard():
        raise BrokenPipeError
    assert silenced
    assert "the reader of the output has ended" in capsys.readouterr().err


def test_no_start_of_a_standby_has_the_instance_of_one_before(
    build: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Store and ROS node would take its messages, numbered from 0, for second copies."""
    started: list[tuple[str, str]] = []

    def note(name: str, command: list[str], *_: object) -> None:
        started.append((name, command[command.index("--instance") + 1]))

    chain = Chain(build, build / "robot.yaml", "robot", [], build / "logs")
    with closing(chain):
        monkeypatch.setattr(chain.processes, "start", note)
        monkeypatch.setattr(time, "time_ns", itertools.count(time.time_ns(), 10**6).__next__)
        chain.start_standbys()
        for name, _ in list(started):
            chain.start(name)
    assert [name for name, _ in started] == [standby_of(stage) for stage in STOOD_BY] * 2
    assert len({instance for _, instance in started}) == len(started)
    assert all(instance.startswith(f"{name}-") for name, instance in started)


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def integration(build: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A stand-in for the last stage; yields its endpoint."""
    base = free_base_port()
    program = str(build / "bin" / "zloam-integration")
    monkeypatch.setenv("FAKE_ALONE", "integration")
    with subprocess.Popen([program, "--set", f"zenoh.base_port={base}"]) as process:
        port = base + PORT_ORDER.index("integration")
        while process.poll() is None and not listens(port):
            time.sleep(0.05)
        yield endpoints(base)[PORT_ORDER.index("integration")]
        process.terminate()


def test_watch_shows_a_robot(integration: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["watch", "--connect", integration, "--seconds", "3.5", "--every", "1"]) == 0
    shown = capsys.readouterr().out
    assert "integration  ready" in shown
    assert "poses/s" in shown
    assert "mapping      nothing heard" in shown


def test_a_silent_stage_is_stale_whatever_its_clock_says(integration: str) -> None:
    session = open_session([integration])
    link = Link(session, Keys("robot"))
    deadline = time.monotonic() + 60.0
    while link.stage("integration") is None and time.monotonic() < deadline:
        link.poll(0.1)
    now = time.monotonic()
    assert not any("STALE" in line for line in view(link, now))
    (stale,) = (line for line in view(link, now + STALE_SECONDS + 1.0) if "STALE" in line)
    assert stale.startswith("integration")
    link.close()
    session.close()


def test_the_example_for_third_parties(integration: str) -> None:
    program = [sys.executable, str(HERE.parent / "examples" / "subscribe.py")]
    environment = {**os.environ, "PYTHONPATH": str(messages.schemas_path())}
    done = subprocess.run(
        [*program, integration, "robot", "3"],
        env=environment,
        timeout=60,
        capture_output=True,
        text=True,
        check=True,
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    assert len(rows) == 3
    sweeps = [int(row[0]) for row in rows]
    assert sweeps == list(range(sweeps[0], sweeps[0] + 3))


def test_watch_of_nobody_says_so() -> None:
    endpoint = endpoints(free_base_port())[0]
    assert cli.main(["watch", "--connect", endpoint, "--seconds", "0.5", "--every", "0.2"]) == 1


@pytest.mark.parametrize(
    ("name", "target"),
    [("graph", "graph"), ("aloam-odometry", "aloam"), ("store", "build")],
)
def test_what_is_not_built_names_its_target(tmp_path: Path, name: str, target: str) -> None:
    with pytest.raises(BinariesMissing, match=rf"make {target}\)"):
        binary(tmp_path, name)
