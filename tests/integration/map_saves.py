"""A robot that drives: first undisturbed, then while another process keeps saving its map."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from tests.integration.conftest import ROOT, simulate
from tests.integration.live_run import LiveRun
from tests.integration.observed import Observed, Phase

BEFORE_S = 20.0
SUFFIXES = (".pcd", ".laz")


@dataclass
class Found:
    """The two phases and the saved maps."""

    alone: Phase
    saving: Phase
    saves: int
    #: points of the last map that was saved
    points: int


class Saves:
    """Saves the map again and again, each time in a new process at the lowest priority."""

    def __init__(self, run: LiveRun) -> None:
        self.points: list[int] = []
        self._endpoint = f"127.0.0.1:{run.chain._own_port}"
        self._folder = run.out
        self._over = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._work)

    def __enter__(self) -> Saves:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        try:
            while not self._over.is_set():
                self._save()
        except Exception as error:  # raised again by the main thread at the end
            self._error = error

    def _save(self) -> None:
        to = self._folder / f"town{SUFFIXES[len(self.points) % len(SUFFIXES)]}"
        words = ("map", "save", str(to), "--connect", self._endpoint, "--json")
        done = subprocess.run(
            ["nice", "-n", "19", sys.executable, "-m", "zloam_monitor", *words],
            env={**os.environ, "PYTHONPATH": f"{ROOT}/services/monitor/src"},
            capture_output=True,
            text=True,
            check=True,
        )
        self.points.append(json.loads(done.stdout.splitlines()[-1])["points"])


def measure(build: Path, robot_file: Path, out: Path, seconds: float) -> Found:
    """Measures both phases; each lasts `seconds`."""
    whole_s = str(round(BEFORE_S + 2.0 * seconds + 10.0))
    drive = simulate(build, out, "--world", "city", "--seed", "6", "--duration", whole_s)
    run = LiveRun(build, robot_file, drive, out, slower=1.0, seconds=float("inf"))
    with run:
        robot = Observed(run)
        run.wait(BEFORE_S)
        alone = robot.during(seconds)
        with Saves(run) as saves:
            saving = robot.during(seconds)
        return Found(alone, saving, len(saves.points), saves.points[-1])
