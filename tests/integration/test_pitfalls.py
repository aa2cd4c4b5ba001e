"""The driver's table of known decoder bugs is complete, and the tests that it names exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "services" / "driver" / "PITFALLS.md"
COUNT = 80


def rows() -> dict[int, str]:
    """Number of the bug -> its test, or the reason why it has none."""
    found: dict[int, str] = {}
    for line in TABLE.read_text().splitlines():
        match = re.match(r"\| (\d+) \| .+ \| (.+) \|$", line)
        if match:
            number = int(match[1])
            assert number not in found, f"{number} is there twice"
            found[number] = match[2]
    return found


def names_in_sources() -> set[str]:
    """suite.name of every C++ test of the driver."""
    found: set[str] = set()
    for path in (ROOT / "services" / "driver").rglob("*_test.cpp"):
        for suite, name in re.findall(r"^TEST(?:_F)?\((\w+), (\w+)\)", path.read_text(), re.M):
            found.add(f"{suite}.{name}")
    return found


def test_every_number_once() -> None:
    assert sorted(rows()) == list(range(1, COUNT + 1))


def test_every_row_has_a_test_that_exists_or_a_reason() -> None:
    known = names_in_sources()
    for number, text in rows().items():
        kind, _, rest = text.partition(": ")
        assert kind in ("test", "n/a"), f"{number}: {text}"
        if kind == "test":
            assert rest in known, f"{number}: there is no test {rest}"
        else:
            assert len(rest.split()) >= 4, f"{number}: {rest} is no reason"
