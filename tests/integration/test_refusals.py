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
        ("robot: robot\nnonsense_key: 3\n", ["FILE:2: nonsense_key: "]),
        ("flow:\n  window: many\n", ["FILE:2: flow.window: ", "many"]),
        ("flow:\n  window: 100000\n", ["FILE:2: flow.window: ", "100000", "allowed: 1 to 1000 "]),
        ("robot: [\n", ["FILE:", ": not YAML: "]),
        ("flow:\n  ? [window, lag]\n  : 1\n", ["FILE:2: flow.[window, lag]: "]),
        ("zenoh.host: 0.0.0.0\n", ["FILE:1: zenoh.host: ", "write zenoh: {host: "]),
        (
            "zenoh:\n  host: 127.0.0.1\nzenoh.host: 0.0.0.0\n",
            ["FILE:3: zenoh.host: ", "write zenoh: {host: "],
        ),
    ],
    ids=[
        *("unknown key", "wrong type", "out of range", "no YAML", "list as key"),
        *("dot", "dot beside section"),
    ],
)
def test_wrong_configuration(
    build: Path, tmp_path: Path, name: str, text: str, words: list[str]
) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    done = stage(build, name, "--config", path)
    said = done.stdout + done.stderr
    assert done.returncode == REFUSED_CONFIG, said
    for word in words:
        assert word.replace("FILE", str(path)) in said


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
        ("--udp nowhere:2370 --duration 0.1", "nowhere"),
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


def test_a_simulated_file_that_can_not_be_written(build: Path, tmp_path: Path) -> None:
    missing = tmp_path / "missing" / "truth.tum"
    for path in (missing, Path("/dev/full")):
        done = stage(build, "simulator", "--quiet", "--duration", 0.1, "--truth", path)
        assert done.returncode == REFUSED_FILE, done.stderr
        assert str(path) in done.stderr
    assert not list(tmp_path.iterdir())


OFFLINE = ("offline", "aloam-offline")


def offline(build: Path, program: str, *words: object) -> subprocess.CompletedProcess[str]:
    if not (build / "bin" / f"zloam-{program}").is_file():
        pytest.skip(f"zloam-{program} is not built in {build}")
    return stage(build, program, *words)


@pytest.mark.parametrize("program", OFFLINE)
def test_an_offline_run_whose_poses_can_not_be_written(
    build: Path, capture: Capture, tmp_path: Path, program: str
) -> None:
    (tmp_path / "est.tum").symlink_to("/dev/full")
    done = offline(build, program, capture.pcap, tmp_path, "--count", 3)
    assert done.returncode == REFUSED_CONFIG
    assert str(tmp_path / "est.tum") in done.stderr


@pytest.mark.parametrize(
    ("program", "words", "named"),
    [
        *((program, "--no-maping", "--no-maping") for program in OFFLINE),
        ("offline", "--set mapping.every=5", "mapping.every"),
        ("offline", "--map-gaps 5 10", "--map-gaps"),
        ("offline", "--submaps nowhere/submaps.bin", "nowhere/submaps.bin"),
        ("aloam-offline", "--model HDL64", "HDL64"),
    ],
)
def test_an_offline_program_refuses_what_it_can_not_do(
    build: Path, capture: Capture, tmp_path: Path, program: str, words: str, named: str
) -> None:
    out = tmp_path / "out"
    done = offline(build, program, capture.pcap, out, "--count", 1, *words.split())
    assert done.returncode == REFUSED_CONFIG, done.stdout + done.stderr
    assert named in done.stderr


def test_a_loam_offline_needs_the_model_of_scans_without_one(build: Path, tmp_path: Path) -> None:
    done = offline(build, "aloam-offline", tmp_path, tmp_path / "out")
    assert done.returncode == REFUSED_CONFIG
    assert "--model" in done.stderr


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
    assert "ends early after" in (tmp_path / "out" / "logs" / "driver.log").read_text()
