"""The answer of a command: lines of text for a person, or one line of JSON for a program."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np


def give(as_json: bool, data: object, lines: Iterable[str]) -> None:
    """Prints the answer to standard output."""
    print(text(data) if as_json else "\n".join(lines), flush=True)


def text(data: object) -> str:
    """One line of JSON. JSON has no infinity and no NaN: null stands for both."""
    return json.dumps(_plain(data), allow_nan=False)


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
