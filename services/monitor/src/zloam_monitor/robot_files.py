"""Keeps deploy/robots/*.yaml true: their comments are what the stages say about each key.

A robot's file sets what differs from the default and shows everything else commented out, so that a
better default reaches every robot. `refresh` rewrites the comments from --describe-config and keeps
the values that are set, their reasons ("Here: ...") and the text at the top.
"""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from zloam_monitor import config_schema
from zloam_monitor.chain import binary
from zloam_monitor.keys import STAGES

WIDTH = 100
#: beside the robots' files
SCHEMA = "schema.json"
#: by which editors find it
MODELINE = f"# yaml-language-server: $schema={SCHEMA}\n"
#: to begin with: what differs from robot to robot
ESSENTIAL = (
    "robot",
    "mounting.xyz_m",
    "mounting.rpy_deg",
    "driver.model",
    "driver.port",
    "driver.body_box_min_m",
    "driver.body_box_max_m",
    "driver.imu",
    "registration.min_range_m",
    "registration.max_range_m",
    "mapping.map_path",
    "integration.output_dir",
    "zenoh.host",
)
HEAD = (
    "Above each key: [unit; what is allowed; default] meaning. A key behind # has its default; a"
    ' key that is set says why after "Here:". An unknown key, a wrong type or a value out of range'
    " is refused with file and line. --set key=value overrides one value. What is `live` may change"
    " while running (`zloam set`). The comments are made by `make reference`."
)
#: order of the sections, and what each is about
SECTIONS = {
    "": "",
    "sensor": "The lidar.",
    "mounting": "Pose of the lidar in base_link (T_base_lidar). Poses and map are of base_link:"
    " with zeros base_link is the lidar itself. Upside down: rpy_deg [180, 0, 0].",
    "driver": "Packets or scans to sweeps.",
    "registration": "Sweeps to features.",
    "odometry": "A sweep's features against the sweeps before it.",
    "mapping": "Sweeps against the map.",
    "integration": "Odometry and the map's corrections to the pose.",
    "zenoh": "Links between the stages.",
    "flow": "Pacing of a replay.",
    "recovery": "What was lost on the way; queues.",
    "log": "What the stages say.",
}


@dataclass(frozen=True)
class RobotFile:
    """What a person decided in a robot's file."""

    about: str
    values: dict[str, Any]
    reasons: dict[str, str] = field(default_factory=dict)


def described(build: Path) -> dict[str, dict[str, Any]]:
    """Key -> what the stages say about it, in their order."""
    found: dict[str, dict[str, Any]] = {}
    for stage in STAGES:
        done = subprocess.run(
            [binary(build, stage), "--describe-config"], capture_output=True, text=True, check=True
        )
        for each in json.loads(done.stdout):
            found.setdefault(each["key"], each)
    return found


def _flat(tree: Any, prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in (tree or {}).items():
        key = f"{prefix}{name}"
        found.update(_flat(value, key + ".") if isinstance(value, dict) else {key: value})
    return found


def read(text: str) -> RobotFile:
    """The values that are set, the reason before each, and the first paragraph."""
    reasons: dict[str, str] = {}
    comment = ""
    path: list[str] = []
    for line in text.splitlines():
        words = line.strip()
        key = re.match(r"^( *)([a-z_0-9]+):", line)
        if key:
            depth = len(key[1]) // 2
            path = [*path[:depth], key[2]]
            if " Here: " in comment:
                reasons[".".join(path)] = comment.split(" Here: ", 1)[1].strip()
            comment = ""
        elif words.startswith("#") and not re.match(r"^#[a-z_0-9]+:", words):
            comment += " " + words.lstrip("#").strip()
        else:
            comment = ""
    first = text.split("\n#\n", 1)[0].removeprefix(MODELINE)
    about = " ".join(line.lstrip("# ") for line in first.splitlines() if line.startswith("#"))
    return RobotFile(about, _flat(yaml.safe_load(text)), reasons)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return "[" + ", ".join(_value(each) for each in value) + "]"
    return '""' if value == "" else str(value)


def _wrapped(text: str, indent: int) -> list[str]:
    start = " " * indent + "#"
    lines = [start]
    for word in text.split():
        if len(lines[-1]) + 1 + len(word) > WIDTH:
            lines.append(start)
        lines[-1] += " " + word
    return lines


def _entry(key: str, said: dict[str, Any], robot: RobotFile) -> list[str]:
    depth = max(0, key.count("."))
    bounds = "; ".join(
        part
        for part in (
            said["unit"],
            said["allowed"],
            f"default {_value(said['default'])}",
            "live" if said["live"] else "",
        )
        if part
    )
    comment = f"[{bounds}] {said['doc']}"
    is_set = key in robot.values
    if is_set and key in robot.reasons:
        comment += f". Here: {robot.reasons[key]}"
    value = robot.values[key] if is_set else said["default"]
    mark = "" if is_set else "#"
    name = key.rsplit(".", 1)[-1]
    return [*_wrapped(comment, 2 * depth), " " * 2 * depth + f"{mark}{name}: {_value(value)}"]


def _section(name: str, keys: list[str], said: dict[str, dict[str, Any]], robot: RobotFile) -> str:
    lines, inner = [], ""
    if SECTIONS[name]:
        lines += _wrapped(SECTIONS[name], 0)
    if name:
        any_set = any(key in robot.values for key in keys)
        # a map without a value would be null: shown as a comment too
        lines.append(f"{name}:" if any_set else f"#{name}:")
    for key in keys:
        parts = key.split(".")
        if len(parts) == 3 and parts[1] != inner:
            inner = parts[1]
            prefix = f"{name}.{inner}."
            mark = "" if any(k.startswith(prefix) for k in robot.values) else "#"
            lines.append(f"  {mark}{inner}:")
        lines += _entry(key, said[key], robot)
    return "\n".join(lines)


def render(robot: RobotFile, said: dict[str, dict[str, Any]]) -> str:
    """The file's text."""
    if unknown := sorted(set(robot.values) - set(said)):
        raise ValueError(f"no stage knows {', '.join(unknown)}")
    head = [*_wrapped(robot.about, 0), "#", *_wrapped(HEAD, 0)]
    parts = [MODELINE + "\n".join(head)]
    for name in SECTIONS:
        keys = [k for k in said if (k.split(".")[0] if "." in k else "") == name]
        # in the order of declaration, but plain keys before nested ones
        keys.sort(key=lambda k: k.count("."))
        if keys:
            parts.append(_section(name, keys, said, robot))
    return "\n\n".join(parts) + "\n"


def _table(keys: list[str], said: dict[str, dict[str, Any]]) -> list[str]:
    lines = ["| key | unit | allowed | default | live | meaning |", "|---|---|---|---|---|---|"]
    for key in keys:
        s = said[key]
        live = "live" if s["live"] else ""
        default = f"`{_value(s['default'])}`"
        cells = (f"`{key}`", s["unit"], s["allowed"], default, live, s["doc"])
        lines.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
    return [*lines, ""]


def reference(said: dict[str, dict[str, Any]]) -> str:
    """All keys as Markdown tables, those first that matter first."""
    lines = ["# Configuration reference", "", "Made by `make reference`."]
    lines += ["Live: may change while running, `zloam set STAGE key=value`."]
    lines += ["`zloam config check FILE` asks the stages; editors check by `schema.json`.", ""]
    lines += [
        "## To begin with",
        "",
        "What differs from robot to robot; the rest has defaults.",
        "",
    ]
    lines += _table([key for key in ESSENTIAL if key in said], said)
    for name, about in SECTIONS.items():
        keys = [k for k in said if (k.split(".")[0] if "." in k else "") == name]
        if keys:
            lines += [f"## {name or 'general'}", "", *([about, ""] if about else [])]
            lines += _table(keys, said)
    return "\n".join(lines)


def schema_text(said: dict[str, dict[str, Any]]) -> str:
    """JSON Schema of the files, as text."""
    return json.dumps(config_schema.schema(said, SECTIONS), indent=1, ensure_ascii=False) + "\n"


def refresh(build: Path, folder: Path, check: bool) -> list[Path]:
    """Rewrites what is out of date (or only names it); the files concerned."""
    said = described(build)
    stale = []
    wanted = {p: render(read(p.read_text()), said) for p in sorted(folder.glob("*.yaml"))}
    wanted[folder / "REFERENCE.md"] = reference(said)
    wanted[folder / SCHEMA] = schema_text(said)
    for path, text in wanted.items():
        if not path.exists() or path.read_text() != text:
            stale.append(path)
            if not check:
                path.write_text(text)
    return stale
