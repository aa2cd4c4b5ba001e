"""Optional packages: only some commands need them, and they are too large for all others."""

from __future__ import annotations

import importlib
from typing import Any

from zloam_monitor import places
from zloam_monitor.failures import Explained


class Missing(Explained):
    """A package is not installed; the text says how to get it."""


class ViewerError(Explained):
    """The program of an optional package did not start; the text says why."""


def needed(module: str, package: str) -> Any:
    """Imports the module, or raises Missing with the package's name."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise Missing(
            f"the Python package {package} is needed for this: {advice(package)}"
        ) from error


def advice(package: str) -> str:
    """How to install an optional package for this installation of zloam."""
    if places.checkout() is not None:
        return "make view-tools"
    # The Debian package uses the system's Python, into which pip installs nothing.
    return (
        f"pip install 'zloam[view]'; for the Debian package pip install --target FOLDER {package}, "
        "and PYTHONPATH=FOLDER"
    )
