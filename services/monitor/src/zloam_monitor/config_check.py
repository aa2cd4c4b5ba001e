"""`config check`: lets every stage check a robot's file before it is used."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zloam_monitor import robot_file
from zloam_monitor.chain import readers

#: Time, level and program at the beginning of a line in a stage's log.
_LOG_HEAD = re.compile(r"^\S+Z \w+\s+\w+: ")


@dataclass(frozen=True)
class Verdict:
    """The stages' verdict on a file."""

    refusals: list[str]
    values: dict[str, Any]


def check(build: Path, config: Path, settings: Sequence[str]) -> Verdict:
    """Runs the check of every stage; a refusal by several stages is listed once."""
    refused: dict[str, None] = {}
    values: dict[str, Any] = {}
    for stage, program in readers(build).items():
        done = _asked(program, config, settings)
        if done.returncode == 0:
            values.update(json.loads(done.stdout))
        else:
            refused.update(dict.fromkeys(_said(stage, done)))
    if not refused:
        try:  # `demo` and `run` read it, too: a stage takes bytes of any encoding.
            robot_file.names(config, list(settings))
        except robot_file.RobotFileError as error:
            refused[str(error)] = None
    return Verdict(list(refused), values)


def refusals(
    programs: Mapping[str, Path], config: Path, settings: Sequence[str], set_at: Sequence[str]
) -> list[str]:
    """What these stages refuse of a command line; of several that refuse the same, the words of the
    one that names most of what it allows."""
    found: dict[str, str] = {}
    for stage, program in programs.items():
        done = _asked(program, config, settings, set_at)
        for line in _said(stage, done) if done.returncode != 0 else ():
            what = line.partition("; allowed: ")[0]
            found[what] = max(line, found.get(what, ""), key=len)
    return list(found.values())


def _asked(
    program: Path, config: Path, settings: Sequence[str], set_at: Sequence[str] = ()
) -> subprocess.CompletedProcess[str]:
    command = [str(program), "--config", str(config), "--check-config"]
    for setting in settings:
        command += ["--set", setting]
    for change in set_at:
        command += ["--set-at", change]
    return subprocess.run(
        command, capture_output=True, text=True, errors="backslashreplace", check=False
    )


def _said(stage: str, done: subprocess.CompletedProcess[str]) -> list[str]:
    lines = done.stderr.strip().splitlines() or [f"{stage} ended with {done.returncode}"]
    return [_LOG_HEAD.sub("", line) for line in lines]
