"""`config check`: a robot's file before it is used, judged by every stage."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zloam_monitor.chain import binary
from zloam_monitor.stages import STAGES

#: what a line of a stage's log begins with
_LOG_HEAD = re.compile(r"^\S+Z \w+\s+\w+: ")


@dataclass(frozen=True)
class Verdict:
    """What the stages say of a file."""

    refusals: list[str]
    values: dict[str, Any]


def check(build: Path, config: Path, settings: Sequence[str]) -> Verdict:
    """Each refusal once."""
    refusals: dict[str, None] = {}
    values: dict[str, Any] = {}
    for stage in STAGES:
        command = [str(binary(build, stage)), "--config", str(config), "--check-config"]
        for setting in settings:
            command += ["--set", setting]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            values.update(json.loads(done.stdout))
        else:
            lines = done.stderr.strip().splitlines() or [f"{stage} ended with {done.returncode}"]
            refusals.update(dict.fromkeys(_LOG_HEAD.sub("", line) for line in lines))
    return Verdict(list(refusals), values)
