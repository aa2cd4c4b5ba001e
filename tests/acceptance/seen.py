"""What the tests behind a check have done, by the result files of pytest and gtest."""

from __future__ import annotations

import fnmatch
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.acceptance.framework import Measured, Skip
from tests.acceptance.runs import Setting


@dataclass
class Seen:
    """Results of the tests of one check."""

    held: int = 0
    #: names of all tests that were read: of gtest "Suite.Name"
    names: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    figures: list[str] = field(default_factory=list)

    def read(self, path: Path) -> None:
        """Adds the results of a JUnit file."""
        if not path.exists():
            raise RuntimeError(f"{path.stem} ended without a result")
        cases = list(ElementTree.parse(path).iter("testcase"))
        if not cases:
            raise RuntimeError(f"{path.stem}: no test of this name")
        for case in cases:
            name = case.get("name", "")
            self.names.append(f"{case.get('classname', '')}.{name}")
            if case.find("failure") is not None or case.find("error") is not None:
                self.failed.append(name)
            elif case.get("status") == "notrun":  # gtest's word for a disabled test
                self.skipped.append(f"{name}: disabled")
            elif (skipped := case.find("skipped")) is not None:
                self.skipped.append(f"{name}: {skipped.get('message', 'no reason')}")
            else:
                self.held += 1
            self.figures += _figures(case)

    def read_pytest(self, setting: Setting, *words: object) -> str:
        """Runs pytest with these words and adds its results; returns its output."""
        with tempfile.TemporaryDirectory() as folder:
            found = Path(folder) / "pytest.xml"
            done = setting.python("-m", "pytest", "-q", f"--junitxml={found}", *words)
            self.read(found)
        self.ended("pytest", done.returncode)
        return done.stdout

    def ended(self, program: str, code: int) -> None:
        """Refuses the results of a program that did not end as its tests did: it was interrupted,
        or something beside a test failed."""
        if code not in (0, 1) or (code == 1 and not self.failed):
            raise RuntimeError(f"{program} ended with {code}, {len(self.failed)} tests failed")

    def read_gtest(self, path: Path, code: int, chosen: str) -> None:
        """Adds the results of a gtest program that ran with this filter, of which each part must
        have chosen a test."""
        before = len(self.names)
        self.read(path)
        self.ended(path.stem, code)
        for pattern in chosen.split(":"):
            if not fnmatch.filter(self.names[before:], pattern):
                raise RuntimeError(f"{path.stem}: no test {pattern}")

    def judged(self, figure: str) -> Measured:
        """The verdict: a test that was skipped has shown nothing, whatever the others did."""
        if self.skipped and not self.failed:
            raise Skip("; ".join(dict.fromkeys(self.skipped)))
        return Measured(figure, self.held > 0 and not self.failed)

    def words(self) -> str:
        parts = list(dict.fromkeys(self.figures))
        parts.append(f"{self.held} tests held")
        if self.failed:
            parts.append(f"failed: {', '.join(self.failed)}")
        if self.skipped:
            parts.append(f"skipped: {', '.join(dict.fromkeys(self.skipped))}")
        return "; ".join(parts)


def _figures(case: ElementTree.Element) -> Iterator[str]:
    for each in case.iter("property"):
        yield f"{each.get('name')}: {each.get('value')}"
