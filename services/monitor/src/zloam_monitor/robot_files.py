"""REFERENCE.md and schema.json beside the robots' files, from what the stages say of their keys.

A robot's file states what it sets; everything else has its default, so that a better default
reaches every robot.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from zloam_monitor import config_schema
from zloam_monitor.chain import binary
from zloam_monitor.stages import ROWS, STAGES

#: beside the robots' files
SCHEMA = "schema.json"
#: by which editors find it
MODELINE = f"# yaml-language-server: $schema={SCHEMA}\n"
#: what a user of a robot or a recording may have to set; the rest is for experts
COMMON = (
    "robot",
    "sensor.model",
    "mounting.xyz_m",
    "mounting.rpy_deg",
    "mounting.imu_xyz_m",
    "mounting.imu_rpy_deg",
    "driver.source",
    "driver.path",
    "driver.port",
    "driver.sensor_address",
    "driver.model",
    "driver.returns",
    "driver.clock",
    "driver.azimuth_mask_deg",
    "driver.body_box_min_m",
    "driver.body_box_max_m",
    "driver.time_model",
    "driver.imu",
    "driver.imu_path",
    "driver.imu_delay_ms",
    "registration.min_range_m",
    "registration.max_range_m",
    "registration.range_noise_m",
    "mapping.leaf_edge_m",
    "mapping.leaf_plane_m",
    "mapping.map_path",
    "integration.output_dir",
    "zenoh.host",
    "log.level",
)
#: order of the sections, and what each is about
SECTIONS = {
    "": "",
    "sensor": "The lidar.",
    "mounting": "Poses of the lidar (T_base_lidar) and the IMU in base_link. Poses and map are of"
    " base_link: with zeros base_link is the lidar itself. Upside down: rpy_deg [180, 0, 0].",
    **{stage: ROWS[stage].summary for stage in STAGES},
    "zenoh": "Links between the stages.",
    "flow": "Pacing of a replay.",
    "recovery": "Lost messages and queues.",
    "log": "The stages' logs.",
}


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


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return "[" + ", ".join(_value(each) for each in value) + "]"
    return '""' if value == "" else str(value)


def _table(keys: list[str], said: dict[str, dict[str, Any]]) -> list[str]:
    lines = ["| key | unit | allowed | default | live | meaning |", "|---|---|---|---|---|---|"]
    for key in keys:
        s = said[key]
        live = "live" if s["live"] else ""
        default = f"`{_value(s['default'])}`"
        cells = (f"`{key}`", s["unit"], s["allowed"], default, live, s["doc"])
        lines.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
    return [*lines, ""]


def _section_of(key: str) -> str:
    return key.split(".")[0] if "." in key else ""


def reference(said: dict[str, dict[str, Any]]) -> str:
    """All keys as Markdown tables, the common ones first."""
    lines = ["# Configuration reference", "", "Made by `make reference`."]
    lines += ["Live: may change while running, `zloam set STAGE key=value`."]
    lines += ["`zloam config check FILE` asks the stages; editors check by `schema.json`.", ""]
    lines += [
        "## Common",
        "",
        *_table([key for key in COMMON if key in said], said),
        "## Expert",
        "",
    ]
    for name, about in SECTIONS.items():
        keys = [k for k in said if _section_of(k) == name and k not in COMMON]
        if keys:
            lines += [f"### {name or 'general'}", "", *([about, ""] if about else [])]
            lines += _table(keys, said)
    return "\n".join(lines)


def schema_text(said: dict[str, dict[str, Any]]) -> str:
    """JSON Schema of the files, as text."""
    return json.dumps(config_schema.schema(said, SECTIONS), indent=1, ensure_ascii=False) + "\n"


def refresh(build: Path, folder: Path, check: bool) -> list[Path]:
    """Rewrites what is out of date (or only names it); the files concerned."""
    said = described(build)
    wanted = {folder / "REFERENCE.md": reference(said), folder / SCHEMA: schema_text(said)}
    stale = [p for p, text in wanted.items() if not p.exists() or p.read_text() != text]
    for path in () if check else stale:
        path.write_text(wanted[path])
    return stale
