"""Optional packages: only some commands need them, and they are too large for all others."""

from __future__ import annotations

import importlib
from typing import Any


class Missing(RuntimeError):
    """A package is not installed; the text says how to get it."""


class ViewerError(RuntimeError):
    """The program of an optional package did not start; the text says why."""


def needed(module: str, package: str) -> Any:
    """Imports the module, or raises Missing with the package's name."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise Missing(
            f"the Python package {package} is needed for this: make view-tools in a checkout, or "
            f"pip install 'zloam[view]'"
        ) from error
