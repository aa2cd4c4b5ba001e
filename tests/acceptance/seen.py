"""What the tests behind a check have done, by the result files of pytest and gtest."""

from __future__ import annotations

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
            if case.find("failure") is not None or case.find("error") is not None:
                self.failed.append(name)
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
        return done.stdout

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
