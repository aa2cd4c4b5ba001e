"""Each of the users' wishes has existing tests, or a reason why not."""

from __future__ import annotations

import fnmatch
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.acceptance.wishes import WISHES

ROOT = Path(__file__).resolve().parents[2]
_UNIT = re.compile(r"\bTEST(?:_F|_P)?\(\s*(\w+),\s*(\w+)\)")


@cache
def unit_tests() -> set[str]:
    sources = (ROOT / "services").rglob("*.cpp")
    return {f"{m[1]}.{m[2]}" for path in sources for m in _UNIT.finditer(path.read_text())}


@cache
def lines() -> set[str]:
    command = [sys.executable, "-m", "tests.acceptance", "--list"]
    paths = f"{ROOT}/services/monitor/src:{ROOT}"
    done = subprocess.run(
        command, cwd=ROOT, env={"PYTHONPATH": paths}, capture_output=True, text=True, check=True
    )
    return {line.split()[0] for line in done.stdout.splitlines() if line.strip()}


def exists(test: str) -> bool:
    if test.startswith("accept "):
        return any(line.startswith(test.removeprefix("accept ")) for line in lines())
    if "::" not in test:
        return bool(fnmatch.filter(unit_tests(), test))
    file, name = test.split("::")
    found = re.findall(r"^def (test_\w+)", (ROOT / file).read_text(), re.MULTILINE)
    return bool(fnmatch.filter(found, name))


def test_each_is_there_once() -> None:
    assert list(WISHES) == list(range(1, 52))


@pytest.mark.parametrize("number", WISHES)
def test_its_tests_exist_or_it_has_a_reason(number: int) -> None:
    wish = WISHES[number]
    assert wish.tests or wish.lacks
    assert [test for test in wish.tests if not exists(test)] == []
