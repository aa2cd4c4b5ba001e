"""The reader of a command's output may end before the command does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[1] / "src"

SHOWN = """
import sys
from zloam_monitor.terminal import ProgressLine, last_words
line = ProgressLine(elsewhere_s=0.0)
line._terminal = sys.argv[1] == "terminal"
sys.stdin.readline()
line.show("half of it")
line.show("all of it")
line.end()
last_words("done")
sys.exit(7)
"""


@pytest.mark.parametrize("where", ["terminal", "pipe"])
def test_a_reader_that_ended_does_not_end_the_command(where: str) -> None:
    """As `head` does, or `tee` at the Ctrl-C that also ends a recording: it is still closed, and
    its exit code says whether it is whole."""
    command = [sys.executable, "-c", SHOWN, where]
    environment = {**os.environ, "PYTHONPATH": str(SOURCES)}
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=environment
    ) as run:
        assert run.stdout is not None
        run.stdout.close()
        run.stdout = None
        _, said = run.communicate("go\n")
    assert (run.returncode, said) == (7, "")
