"""Every stage accepts the robots' files; reference and schema agree with what the stages report."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import jsonschema
import pytest
import yaml

from tests.integration.conftest import ROOT, monitor
from zloam_monitor import robot_files
from zloam_monitor.stages import CONFIGURED, STAGES

ROBOTS = ROOT / "deploy" / "robots"
MOST_KEYS, MOST_COMMON_KEYS = 120, 30
#: Set together with driver.time_model even at its default: both say when a scan's points were
#: measured.
FOR_SCANS = {"driver.scan_seam_deg"}


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_stage_accepts_it(build: Path, path: Path) -> None:
    # Scans do not come over the network, so the configuration of such a replay needs a path.
    own = yaml.safe_load(path.read_text()).get("driver", {})
    path_set = [] if "path" in own else ["--set", "driver.path=somewhere"]
    for stage in CONFIGURED:
        done = subprocess.run(
            [build / "bin" / f"zloam-{stage}", "--config", path, "--check-config", *path_set],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr


def test_reference_and_schema_are_up_to_date(build: Path) -> None:
    stale = robot_files.refresh(build, ROBOTS, check=True)
    assert not stale, "run: make reference"


def test_a_user_can_hold_the_keys(build: Path) -> None:
    said = robot_files.described(build)
    beside = set(CONFIGURED) - set(STAGES)
    assert len([key for key in said if key.split(".")[0] not in beside]) <= MOST_KEYS
    assert len(robot_files.COMMON) <= MOST_COMMON_KEYS
    assert set(robot_files.COMMON) <= set(said)


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_robots_file_states_what_it_sets(build: Path, path: Path) -> None:
    said = robot_files.described(build)
    for section, keys in yaml.safe_load(path.read_text()).items():
        for name, value in keys.items() if isinstance(keys, dict) else ():
            default = said[f"{section}.{name}"]["default"]
            # Keys whose value each robot has to set may stand there with their default.
            assert section == "mounting" or f"{section}.{name}" in FOR_SCANS or value != default


def refused_by_schema(path: Path) -> bool:
    schema = json.loads((ROBOTS / robot_files.SCHEMA).read_text())
    checker = jsonschema.Draft7Validator(schema)
    return not checker.is_valid(yaml.safe_load(path.read_text()))


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.yaml")), ids=lambda path: path.stem)
def test_editors_accept_it_by_the_schema(path: Path) -> None:
    assert not refused_by_schema(path)
    assert path.read_text().startswith(robot_files.MODELINE)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("robot: car\n", False),
        ("robot: 01\n", False),
        ("driver:\n", False),
        ("driver:\n  port: 2369\n  rate: 2\n  model: VLP-16\n", False),
        ("mounting:\n  xyz_m: [0, 0.1, 2]\n", False),
        ("zenoh:\n  connect: [tcp/10.0.0.1:7447]\n  shared_memory: false\n", False),
        ("ros:\n  distro: humble\n  domain: 3\n", False),
        ("store:\n  path: maps/today\n", False),
        ("graph:\n  loop_way_m: 20\n", False),
        ("ros:\n  distroo: humble\n", True),
        ("store:\n  pth: maps/today\n", True),
        ("graph:\n  loop_way: 20\n", True),
        ("preview:\n  nonsense: 1\n", True),
        ("driver:\n  prt: 2369\n", True),
        ("speed: 3\n", True),
        ("driver:\n  port: 70000\n", True),
        ("driver:\n  port: 2368.5\n", True),
        ("driver:\n  port: many\n", True),
        ("driver:\n  model: VLP-17\n", True),
        ("mounting:\n  xyz_m: [0, 0.1]\n", True),
        ("mounting:\n  xyz_m: 3\n", True),
        ("zenoh:\n  shared_memory: maybe\n", True),
    ],
)
def test_schema_and_stages_are_of_one_mind(
    text: str, wrong: bool, build: Path, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    assert refused_by_schema(path) == wrong
    asked = monitor("config", "check", "--preset-dir", build, path)
    assert asked.code == (2 if wrong else 0), asked.said
    assert ("robot.yaml:" in asked.said) == wrong or "accepted by all stages" in asked.said


def test_a_check_says_each_refusal_once_and_what_is_not_the_default(build: Path) -> None:
    asked = monitor("config", "check", "--preset-dir", build, "hdl64e", "--set", "robot=car")
    assert asked.code == 0, asked.said
    assert "robot: car" in asked.said
    wrong = monitor("config", "check", "--preset-dir", build, "hdl64e", "--set", "robot=a/b")
    assert wrong.code == 2
    assert wrong.said.count("a/b") == 1


def test_the_schema_accepts_the_sections_of_stages_that_are_not_built(
    build: Path, tmp_path: Path
) -> None:
    (tmp_path / "bin").mkdir()
    for stage in STAGES:
        (tmp_path / "bin" / f"zloam-{stage}").symlink_to(build / "bin" / f"zloam-{stage}")
    checker = jsonschema.Draft7Validator(json.loads(robot_files.schema_text(tmp_path)))
    assert checker.is_valid({"graph": {"loop_way_m": 20}})
    assert not checker.is_valid({"registration": {"loop_way_m": 20}})
