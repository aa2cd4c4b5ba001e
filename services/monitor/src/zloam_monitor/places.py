"""Where programs, robot files and generated code are: in a checkout, or beside this package."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
#: of an installed package: bin, lib, robots, python
BUNDLED = PACKAGE / "bundled"
#: names the build folder of a checkout
BUILD_VARIABLE = "ZLOAM_BUILD"


def checkout() -> Path | None:
    """The root of the source tree that this file lies in."""
    above = PACKAGE.parents
    if len(above) > 3 and (above[3] / "CMakePresets.json").is_file():
        return above[3]
    return None


def build() -> Path:
    """The folder whose bin/ has the programs."""
    if named := os.environ.get(BUILD_VARIABLE):
        return Path(named)
    root = checkout()
    return BUNDLED if root is None else root / "build" / "release"


def command() -> Path:
    """The command `zloam` itself, for stages that call it."""
    root = checkout()
    return Path(sys.argv[0]).resolve() if root is None else root / "bin" / "zloam"


def robots() -> Path:
    """The folder of the robots' files."""
    root = checkout()
    return BUNDLED / "robots" if root is None else root / "deploy" / "robots"


def robot_file(text: str | Path) -> Path:
    """A path, or the bare name of one of the robots' files."""
    named = robots() / f"{text}.yaml"
    return named if Path(text).name == str(text) and named.is_file() else Path(text)
