"""Names are the texts in the file, as the stages read them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from zloam_monitor import places
from zloam_monitor.recordings.sweeps import LONGEST_NS
from zloam_monitor.robot_file import RobotFileError, RobotNames, connects, names


@pytest.mark.parametrize("text", ["01", "1e3", "0x10", "yes", "off", "2024-01-01", "1_000"])
def test_a_name_is_text_whatever_it_looks_like(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.yaml").write_text(f"robot: {text}\nsensor:\n  name: {text}\n")
    assert names(tmp_path / "r.yaml", []) == RobotNames(robot=text, sensor=text)


def test_a_port_is_a_number_and_a_setting_beats_the_file(tmp_path: Path) -> None:
    (tmp_path / "r.yaml").write_text("zenoh:\n  base_port: 8000\nrobot: a\n")
    assert names(tmp_path / "r.yaml", ["robot=b"]) == RobotNames(robot="b", base_port=8000)


def test_endpoints_are_a_list_in_the_file_or_in_a_setting(tmp_path: Path) -> None:
    path = tmp_path / "r.yaml"
    path.write_text("zenoh:\n  connect: [tcp/router:7447, tcp/b:1]\n")
    assert connects(path, []) == ["tcp/router:7447", "tcp/b:1"]
    assert connects(path, ["zenoh.connect=[tcp/c:2]"]) == ["tcp/c:2"]
    path.write_text("robot: a\n")
    assert connects(path, []) == []
    # An invalid value is kept, so that the stages refuse it.
    assert connects(path, ["zenoh.connect=router"]) == ["router"]


@pytest.mark.parametrize(
    "data",
    [
        b"robot: [",
        b"robot: \xdf\n",
        b"zenoh: {base_port: x}",
        # Found by tests/fuzz/readers.py.
        b"zenoh: {base_port: [7460]}",
        b"zenoh: {base_port: 65001}",
        b"zenoh: {base_port: -1}",
        b"robot: " + b"[" * 100_000,
    ],
    ids=["open", "encoding", "port", "list of ports", "high port", "port < 0", "nested"],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "r.yaml").write_bytes(data)
    with pytest.raises(RobotFileError, match=r"r\.yaml"):
        names(tmp_path / "r.yaml", [])


@pytest.mark.parametrize("key", ["[window, lag]", "{window: lag}"])
def test_a_key_that_is_no_name_is_shown_with_its_line(tmp_path: Path, key: str) -> None:
    (tmp_path / "r.yaml").write_text(f"robot: a\nflow:\n  ? {key}\n  : 1\n")
    with pytest.raises(RobotFileError) as refused:
        names(tmp_path / "r.yaml", [])
    assert "r.yaml:3: a name is expected as key" in str(refused.value)
    assert key in str(refused.value)


def test_the_driver_takes_the_periods_that_a_sweep_can_have() -> None:
    schema = json.loads((places.robots() / "schema.json").read_text())
    period_s = schema["properties"]["driver"]["properties"]["scan_period_s"]
    assert period_s["maximum"] == LONGEST_NS / 1e9
    assert LONGEST_NS < 2**32
