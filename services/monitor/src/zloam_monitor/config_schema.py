"""JSON Schema of a robot's file, from what the stages say of their keys: editors complete and check
with it. The stages themselves stay the judges (`zloam config check`)."""

from __future__ import annotations

import math
import re
from typing import Any

_RANGE = r"(?P<low>\S+) to (?P<high>\S+)"
_SCALAR = re.compile(rf"^{_RANGE}$")
_LIST = re.compile(rf"^(?P<count>\d+) (?P<whole>whole )?numbers, each {_RANGE}$")
#: a stage takes a value's text, so 01 and true are texts as well
_TEXT: dict[str, Any] = {"type": ["string", "number", "boolean", "null"]}


def _number(text: re.Match[str], kind: str) -> dict[str, Any]:
    found: dict[str, Any] = {"type": kind}
    for name, bound in (("minimum", float(text["low"])), ("maximum", float(text["high"]))):
        if math.isfinite(bound):
            found[name] = int(bound) if bound.is_integer() else bound
    return found


def leaf(said: dict[str, Any]) -> dict[str, Any]:
    """Of one key."""
    allowed, kind = str(said["allowed"]), str(said["type"])
    found: dict[str, Any]
    if kind == "bool":
        found = {"type": "boolean"}
    elif allowed.startswith("one of "):
        found = {"enum": allowed.removeprefix("one of ").split(", ")}
    elif match := _LIST.match(allowed):
        count = int(match["count"])
        each = _number(match, "integer" if match["whole"] else "number")
        found = {"type": "array", "minItems": count, "maxItems": count, "items": each}
    elif allowed == "a list of texts":
        found = {"type": "array", "items": _TEXT}
    elif match := _SCALAR.match(allowed):
        found = _number(match, "integer" if kind == "integer" else "number")
    elif allowed == "any text":
        found = dict(_TEXT)
    else:
        raise ValueError(f"{said['key']}: no schema is known for '{allowed}' ({kind})")
    unit = f"[{said['unit']}] " if said["unit"] else ""
    live = " May change while running." if said["live"] else ""
    return {**found, "default": said["default"], "description": f"{unit}{said['doc']}.{live}"}


def schema(said: dict[str, dict[str, Any]], about: dict[str, str]) -> dict[str, Any]:
    """Of all keys; `about`: what each section is for."""
    root: dict[str, Any] = {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "A robot's file of zenoh-loam",
        "description": "Made by `make reference` from what the programs say.",
        "type": "object",
        "additionalProperties": False,
        "properties": {},
    }
    for key, each in said.items():
        place = root
        *sections, name = key.split(".")
        for section in sections:
            place = place["properties"].setdefault(
                section,
                {
                    # a section whose keys are all behind # is empty
                    "type": ["object", "null"],
                    "description": about.get(section, ""),
                    "additionalProperties": False,
                    "properties": {},
                },
            )
        place["properties"][name] = leaf(each)
    return root
