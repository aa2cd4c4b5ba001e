"""Tests the command line: help with examples, completion, and errors without a stack trace."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from zloam_monitor import cli, cli_common, places
from zloam_monitor.cli_files import PROGRAMS

ROOT = Path(__file__).resolve().parents[3]
OWN = (
    *("demo", "run", "follow", "ros-lidar"),
    *("robots", "status", "watch", "get", "set", "save", "reset", "place", "handover", "doctor"),
    "metrics",
    *("web", "view", "foxglove", "record", "replay"),
)
COMMANDS = (*OWN, "trajectory", "compare", "support", "evaluate", "recording", "metadata")


def zloam(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs the command as from a shell."""
    return subprocess.run(
        [sys.executable, "-m", "zloam_monitor", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT / "services/monitor/src"), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_examples_that_name_the_command(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([command, "--help"]) == 0
    said = capsys.readouterr().out
    assert f"zloam {command}" in said.split("Examples:")[1]
    assert "ZLOAM_FAULT" not in said


def keys_of(schema: dict[str, Any], begin: str = "") -> set[str]:
    """Keys of robot files, and sections of keys."""
    found = set()
    for name, each in schema.get("properties", {}).items():
        found |= {begin + name, *keys_of(each, f"{begin}{name}.")}
    return found


def test_keys_in_help_are_those_of_robot_files(capsys: pytest.CaptureFixture[str]) -> None:
    keys = keys_of(json.loads((ROOT / "deploy/robots/schema.json").read_text()))
    sections = {key.partition(".")[0] for key in keys if "." in key}
    named = set()
    for command in COMMANDS:
        assert cli.main([command, "--help"]) == 0
        said = capsys.readouterr().out
        named |= set(re.findall(r"(?<![\w./])[a-z_]+\.[a-z0-9_.]*[a-z0-9]", said))
    meant = {name for name in named if name.partition(".")[0] in sections}
    assert {"mapping.voxel_planes", "odometry.kernel_m", "driver.time_field"} <= meant
    assert meant <= keys


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    listed = [
        line[2:].split(maxsplit=1)[0]
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("│ ") and line[2] not in " -"
    ]
    groups = {"loop", "map", "config"}
    assert [name for name in listed if name not in groups] == [
        *COMMANDS,
        *(name for name, _ in PROGRAMS),
    ]
    assert set(listed) >= groups


def test_the_readme_lists_every_command() -> None:
    text = (ROOT / "services/monitor/README.md").read_text()
    cells = re.findall(r"^\| (`.*?`) \| ", text, re.MULTILINE)
    listed = {name for cell in cells for name in re.findall(r"`([a-z-]+)", cell)}
    assert {*COMMANDS, "loop", "map", "config", "calibrate"} - listed == set()


def test_the_version_is_that_of_the_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    said = capsys.readouterr().out.strip()
    assert (
        f"project(zenoh_loam VERSION {said.removeprefix('zloam ')} "
        in (ROOT / "CMakeLists.txt").read_text()
    )


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion(shell: str, tmp_path: Path) -> None:
    # Typer detects the shell by the parent process, which is not a shell here.
    script = zloam("--show-completion", shell, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert script.returncode == 0, script.stderr
    assert "_ZLOAM_COMPLETE=complete_" + shell in script.stdout
    asked = {
        "bash": {"COMP_WORDS": "zloam r", "COMP_CWORD": "1"},
        "zsh": {"_TYPER_COMPLETE_ARGS": "zloam r"},
        "fish": {"_TYPER_COMPLETE_ARGS": "zloam r", "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
    }[shell]
    offered = zloam(_ZLOAM_COMPLETE=f"complete_{shell}", **asked).stdout
    for command in ("run", "robots", "reset"):
        assert command in offered


MISTAKES: list[tuple[tuple[str, ...], int, str]] = [
    (("dmo",), 2, "No such command"),
    (("demo", "--rat", "max"), 2, "No such option"),
    (("demo", "--seed", "many"), 2, "--seed"),
    (("demo", "--pcap", "a", "--bin", "b"), 2, "only one of --pcap and --bin"),
    (
        ("demo", "--kitti", "nowhere"),
        3,
        "nowhere: does not exist; a folder of scans is expected there",
    ),
    (("demo", "--pcap", "a.pcap", "--config", "nowhere.yaml"), 3, "nowhere.yaml: No such file"),
    (("demo", "--pcap", "a.pcap", "--imu", "simulated"), 2, "the recording's own are wanted"),
    (("run", "--config", "nowhere"), 3, "nowhere: No such file"),
    (("run", "--set", "zenoh.base_port=many"), 2, "zenoh.base_port 'many' is no number"),
    (("run", "--set", "zenoh.base_port=70000"), 2, "zenoh.base_port 70000: 0 to 65000 is"),
    (
        ("run", "--listen", "no such address", "--set", "zenoh.base_port=7999"),
        3,
        "can't listen on no such address",
    ),
    (("run", "--localize"), 2, "--localize needs a map"),
    (("run", "--set", "driver.source=pcap"), 2, "`zloam demo --pcap PATH` replays"),
    (("run", "--set", "driver.source=recording"), 2, "`zloam demo --bag PATH` replays"),
    (("run", "--seconds", "nan"), 2, "nan: a time above 0 is expected"),
    (("watch", "--every", "0"), 2, "a time above 0 is expected"),
    (("follow", "--patience", "nan"), 2, "a time above 0 is expected"),
    (("run", "--method", "foo"), 2, "no method 'foo'"),
    (("demo", "--bag", "nofile"), 3, "nofile: does not exist; a recording is expected there"),
    (("map", "info", "nofile.pcd"), 3, "nofile.pcd: No such file"),
    (("map", "info", "nofile.xyz"), 2, ".laz is expected"),
    (("set", "odometry", "novalue"), 2, "'novalue': key=value is expected"),
    (("set", "odometry"), 2, "KEY=VALUE is missing"),
    (("watch", "--connect", "tcp//"), 2, "is no endpoint"),
    (("evaluate", "none.tum", "none.tum"), 3, "none.tum: No such file"),
    (("evaluate", ".", "."), 3, "Is a directory"),
    (("compare", "nowhere", "nowhere", "--json"), 3, "No such file"),
    (("recording", "pyproject.toml"), 3, "pyproject.toml: cannot be read"),
    (("recording", "none.mcap"), 3, "No such file or directory: 'none.mcap'"),
]


@pytest.mark.parametrize(("words", "code", "text"), MISTAKES, ids=lambda each: str(each)[:60])
def test_a_mistake_is_told_without_a_trace(
    words: tuple[str, ...], code: int, text: str, tmp_path: Path
) -> None:
    (tmp_path / "bin").mkdir()
    for name in ("driver", "simulator", "registration", "odometry", "mapping", "integration"):
        (tmp_path / "bin" / f"zloam-{name}").write_text("#!/bin/false\n")
        (tmp_path / "bin" / f"zloam-{name}").chmod(0o755)
    done = zloam(*words, ZLOAM_BUILD=str(tmp_path), COLUMNS="200")
    assert done.returncode == code, done.stderr
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_programs_that_are_not_built(tmp_path: Path) -> None:
    done = zloam("demo", ZLOAM_BUILD=str(tmp_path))
    assert done.returncode == 1
    assert "make build" in done.stderr


def test_a_program_takes_its_own_options(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "zloam-driver"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\necho "driver was given: $*"\nexit 7\n')
    program.chmod(0o755)
    done = zloam("driver", "--help", "--set", "a=b", ZLOAM_BUILD=str(tmp_path))
    assert (done.returncode, done.stdout) == (7, "driver was given: --help --set a=b\n")


def test_robot_files_are_known_by_name() -> None:
    assert "vlp16-outdoor" in cli_common.robot_names()
    assert places.robot_file("vlp16-outdoor") == ROOT / "deploy/robots/vlp16-outdoor.yaml"
    assert places.robot_file("deploy/robots/x.yaml") == Path("deploy/robots/x.yaml")


def test_lists_with_commas_or_repeated() -> None:
    assert cli_common.split(["a,b", "c"]) == ["a", "b", "c"]
    assert cli_common.split(None) == []


def test_the_command_of_the_checkout_works_from_any_folder(tmp_path: Path) -> None:
    if not (ROOT / ".venv/bin/python").exists():
        pytest.skip("no .venv in the checkout: it is made by make build")
    link = tmp_path / "zloam"
    link.symlink_to(ROOT / "bin/zloam")
    done = subprocess.run([link, "--version"], cwd="/", capture_output=True, text=True, check=True)
    assert done.stdout.startswith("zloam ")


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "utf-8:strict"])
def test_an_answer_is_printed_on_any_terminal(tmp_path: Path, encoding: str) -> None:
    """A name in Latin-1, and the dash of a score that does not exist."""
    path = tmp_path / os.fsdecode(b"stra\xdfe.tum")
    path.write_text("".join(f"{second} 0 0 0 0 0 0 1\n" for second in range(5)))
    to = path.with_suffix(".csv")
    done = zloam("trajectory", str(path), str(to), PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, "")
    assert "5 poses" in done.stdout
    done = zloam("evaluate", str(path), str(path), PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, "")
    assert "matched: 5" in done.stdout
