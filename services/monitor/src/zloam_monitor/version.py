"""The version of the whole project, as in CMakeLists.txt."""

from __future__ import annotations

import re
from importlib import metadata

from zloam_monitor import places


def version() -> str:
    """The version of the checkout, or of the installed package."""
    root = places.checkout()
    if root is not None:
        found = re.search(
            r"^project\(\S+ VERSION (\S+)", (root / "CMakeLists.txt").read_text(), re.M
        )
        if found:
            return found[1]
    try:
        return metadata.version("zloam")
    except metadata.PackageNotFoundError:
        return "unknown"
