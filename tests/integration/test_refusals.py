"""Users' mistakes: a clear message, the right exit code, no crash."""

from __future__ import annotations

import json
import socket
import subprocess
from pathlib import Path

import pytest

from tests.integration.conftest import CAPTURE_SECONDS, Capture, monitor
from zloam_monitor.processes import free_base_port
from zloam_monitor.stages import PORT_ORDER, STAGES

REFUSED_CONFIG, REFUSED_FILE = 2, 3


def stage(build: Path, name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [build / "bin" / f"zloam-{name}", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("name", STAGES)
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot: robot\nnonsense_key: 3\n", ["nonsense_key", ":2"]),
        ("flow:\n  window: many\n", ["flow.window", "many", ":2"]),
        ("flow:\n  window: 100000\n", ["flow.window", "100000", "1000", ":2"]),
        ("robot: [\n", [":"]),
        ("zenoh.host: 0.0.0.0\n", ["zenoh.host", "write zenoh: {host: ", ":1"]),
        ("zenoh:\n  host: 127.0.0.1\nzenoh.host: 0.0.0.0\n", ["write zenoh: {host: ", ":3"]),
    ],
    ids=["unknown key", "wrong type", "out of range", "no YAML", "dot", "dot beside section"],
)
def test_wrong_configuration(
    build: Path, tmp_path: Path, name: str, text: str, words: list[str]
) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    done = stage(build, name, "--config", path)
    said = done.stdout + done.stderr
    assert done.returncode == REFUSED_CONFIG, said
    for word in [str(path), *words]:
        assert word in said


@pytest.mark.parametrize("name", STAGES)
def test_wrong_setting(build: Path, robot_file: Path, name: str) -> None:
    done = stage(build, name, "--config", robot_file, "--set", "mounting.xyz_m=[1, 2]")
    assert done.returncode == REFUSED_CONFIG
    assert "mounting.xyz_m" in done.stderr + done.stdout


def test_missing_configuration_file(build: Path, tmp_path: Path) -> None:
    done = stage(build, "mapping", "--config", tmp_path / "none.yaml")
    assert done.returncode == REFUSED_FILE
    assert "none.yaml" in done.stderr + done.stdout


def test_port_in_use(build: Path, robot_file: Path) -> None:
    base = free_base_port()
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", base + PORT_ORDER.index("mapping")))
        taken.listen()
        done = stage(build, "mapping", "--config", robot_file, "--set", f"zenoh.base_port={base}")
    assert done.returncode == REFUSED_FILE
    assert str(base + PORT_ORDER.index("mapping")) in done.stderr + done.stdout


def test_missing_capture(build: Path, tmp_path: Path) -> None:
    done = monitor(
        "demo", "--preset-dir", build, "--pcap", tmp_path / "none.pcap", "--out", tmp_path / "out"
    )
    assert done.code == REFUSED_FILE, done.said
    assert "none.pcap" in done.said


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("--hokuyo --out FILE", "--out"),
        ("--hokuyo --session FILE --lose 0.05", "--lose"),
        ("--hokuyo --session FILE --rpm 600", "--rpm"),
        ("--hokuyo --session FILE --zenoh", "--zenoh"),
        ("--session FILE", "--hokuyo"),
        ("--truth FILE --lose 0.05 --fault-log FILE.csv", "--fault-log"),
        ("--udp :2370", "--udp"),
        ("--out FILE --duration inf", "--duration"),
        ("--out FILE --duration 1e300", "--duration"),
    ],
)
def test_the_simulator_refuses_what_would_have_no_effect(
    build: Path, tmp_path: Path, words: str, named: str
) -> None:
    done = stage(build, "simulator", *words.replace("FILE", str(tmp_path / "made")).split())
    assert done.returncode == REFUSED_CONFIG, done.stdout + done.stderr
    assert named in done.stderr + done.stdout
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_capture(build: Path, tmp_path: Path) -> None:
    (tmp_path / "text.pcap").write_text("this is no capture\n" * 100)
    done = monitor(
        "demo", "--preset-dir", build, "--pcap", tmp_path / "text.pcap", "--out", tmp_path / "out"
    )
    assert done.code == REFUSED_FILE, done.said
    assert "text.pcap" in done.said


def test_truncated_capture_is_used_as_far_as_it_goes(
    build: Path, capture: Capture, tmp_path: Path
) -> None:
    whole = capture.pcap.read_bytes()
    (tmp_path / "cut.pcap").write_bytes(whole[: len(whole) // 2 + 7])
    done = monitor(
        "demo", "--preset-dir", build, "--pcap", tmp_path / "cut.pcap", "--out", tmp_path / "out"
    )
    assert done.code == 0, done.said
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    half = CAPTURE_SECONDS * 10 // 2
    assert half - 1 <= report["identities"]["sweeps"] <= half + 2
    driver_log = (tmp_path / "out" / "logs" / "driver.log").read_text()
    assert "truncated" in driver_log or "cut" in driver_log
