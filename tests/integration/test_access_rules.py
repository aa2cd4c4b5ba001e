"""What the rules of deploy/zenoh/secured.json5 say, without a router: tests/system/test_secured.py
asks one."""

from __future__ import annotations

import json
import re
from pathlib import Path

import zenoh

ROOT = Path(__file__).resolve().parents[2]
KEY_OF_A_TABLE = re.compile(r"^\| `([^`]+)` \|", re.MULTILINE)


def rule(name: str) -> list[zenoh.KeyExpr]:
    """Key expressions of a rule, as Zenoh reads them."""
    config = zenoh.Config.from_file(str(ROOT / "deploy/zenoh/secured.json5"))
    rules = json.loads(config.get_json("access_control"))["rules"]
    (found,) = (each for each in rules if each["id"] == name)
    return [zenoh.KeyExpr(text) for text in found["key_exprs"]]


def public_keys() -> list[str]:
    """The keys of schemas/README.md (keys_test.cpp compares them with the code's), below the robot;
    each name that varies is a wildcard."""
    table = (ROOT / "schemas/README.md").read_text().partition("\n\n##")[0]
    return [re.sub(r"<[^>]+>", "*", key) for key in KEY_OF_A_TABLE.findall(table)]


def test_a_monitor_may_look_at_every_key_but_the_commands() -> None:
    keys = public_keys()
    assert "preview" in keys
    assert "command/*/*" in keys
    allowed = rule("look")
    for key in keys:
        full = zenoh.KeyExpr(f"loam/robot/{key}")
        is_command = key.startswith("command/")
        if is_command:
            assert not [each for each in allowed if each.intersects(full)], key
        else:
            assert [each for each in allowed if each.includes(full)], key
