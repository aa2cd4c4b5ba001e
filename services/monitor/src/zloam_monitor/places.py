"""Locations of programs, robot files and generated code: in a checkout, or in this package."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
#: Folder of an installed package that contains bin, lib, robots and python.
BUNDLED = PACKAGE / "bundled"
#: Environment variable that names the build folder of a checkout.
BUILD_VARIABLE = "ZLOAM_BUILD"


def checkout() -> Path | None:
    """The root of the source tree that contains this file; None: an installed package."""
    above = PACKAGE.parents
    if len(above) > 3 and (above[3] / "CMakePresets.json").is_file():
        return above[3]
    return None


def build() -> Path:
    """The folder with the programs in its bin/."""
    if named := os.environ.get(BUILD_VARIABLE):
        return Path(named)
    root = checkout()
    return BUNDLED if root is None else root / "build" / "release"


def command() -> Path:
    """The command `zloam`, for programs that call it."""
    root = checkout()
    return Path(sys.argv[0]).resolve() if root is None else root / "bin" / "zloam"


def robots() -> Path:
    """The folder of the robot files."""
    root = checkout()
    return BUNDLED / "robots" if root is None else root / "deploy" / "robots"


def robot_file(text: str | Path) -> Path:
    """A path, or the bare name of a robot file."""
    named = robots() / f"{text}.yaml"
    return named if Path(text).name == str(text) and named.is_file() else Path(text)
