"""A user's texts become commands, and changes during a run become options of its replay."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from zloam_monitor.failures import Misuse
from zloam_monitor.records import RevisionRecord
from zloam_monitor.settings import (
    as_set_at,
    changes,
    existing_files,
    meant,
    pairs,
    several,
    stage_and_pairs,
)

ROOT = Path(__file__).resolve().parents[3]


def revision(rev: int, run: int, from_sweep: int, values: dict[str, Any]) -> RevisionRecord:
    return RevisionRecord("mapping", rev, run, from_sweep, values, "a", 1)


def test_pairs_keep_the_value_as_it_was_typed() -> None:
    assert pairs(["a.b=[1, 2]", "c=x=y", "d="]) == {"a.b": "[1, 2]", "c": "x=y", "d": ""}


@pytest.mark.parametrize("text", ["a", "=1", ""])
def test_what_is_no_pair_is_refused(text: str) -> None:
    with pytest.raises(Misuse, match="key=value is expected"):
        pairs([text])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["odometry.kernel_m=1"], "zloam set odometry odometry.kernel_m=1"),
        (["odometri.x=1", "odometri.y=2"], "zloam set odometry odometri.x=1 odometri.y=2"),
        (["zenoh.x=1"], "zloam set STAGE zenoh.x=1"),
        (["odometry"], "KEY=VALUE is missing; zloam get odometry lists"),
    ],
)
def test_a_stage_comes_before_its_keys(given: list[str], said: str) -> None:
    with pytest.raises(Misuse, match=re.escape(said)):
        stage_and_pairs(given[0], given[1:])


def test_the_nearest_names_are_told() -> None:
    stages = ["driver", "mapping", "odometry"]
    assert meant("mapping", stages) == ""
    assert meant("mappng", stages) == " (did you mean 'mapping'?)"
    assert meant("x", stages) == " (there are driver, mapping, odometry)"
    assert meant("kernel", ["odometry.kernel_m", "a.b"]) == " (did you mean 'odometry.kernel_m'?)"
    assert meant("x", [f"key{n}" for n in range(99)]) == ""


def test_a_replay_is_given_what_was_in_force() -> None:
    found = [
        revision(1, run=6, from_sweep=40, values={"a": True}),
        revision(2, run=7, from_sweep=30, values={"a": False, "b": [1, 2.5]}),
    ]
    assert as_set_at(found, run=7) == ["0:a=true", "30:a=false", "30:b=[1, 2.5]"]
    assert as_set_at([revision(1, run=0, from_sweep=9, values={"c": "x"})], run=7) == ["9:c=x"]


def test_a_change_that_the_run_ended_before_was_never_in_force() -> None:
    found = [
        revision(1, run=6, from_sweep=400, values={"a": 1}),
        revision(2, run=7, from_sweep=30, values={"a": 2}),
        revision(3, run=7, from_sweep=31, values={"a": 2, "b": 3}),
    ]
    assert changes(found, 7, last_sweep=30) == (["0:a=1", "30:a=2"], ["31:b=3"])
    assert changes(found, 7, last_sweep=31) == (as_set_at(found, 7), [])


def test_a_change_back_that_the_run_ended_before_is_listed() -> None:
    found = [
        revision(1, run=7, from_sweep=10, values={"a": 2}),
        revision(2, run=7, from_sweep=20, values={"a": 1}),
        revision(3, run=7, from_sweep=900, values={"a": 2}),
        revision(4, run=7, from_sweep=950, values={"a": 2, "b": 3}),
    ]
    in_force, late = changes(found, 7, last_sweep=500)
    assert in_force == ["10:a=2", "20:a=1"]
    assert late == ["900:a=2", "950:b=3"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.b=1", ["a.b=1"]),
        ("a.b=1 robot=x  c.d_e=[1, 2, 3]", ["a.b=1", "robot=x", "c.d_e=[1, 2, 3]"]),
        ("driver.path=/my data/day #2: a=b.pcap", ["driver.path=/my data/day #2: a=b.pcap"]),
        ("10:mapping.m=2 200:mapping.m=[3, 4]", ["10:mapping.m=2", "200:mapping.m=[3, 4]"]),
        ("  ", []),
    ],
)
def test_a_setting_begins_with_its_key(text: str, expected: list[str]) -> None:
    assert several(text) == expected


def test_names_of_files_are_the_longest_that_exist(tmp_path: Path) -> None:
    for name in ("a", "a b", "a b c.tum", "d"):
        (tmp_path / name).touch()
    text = f"{tmp_path}/a b c.tum {tmp_path}/d {tmp_path}/a {tmp_path}/none"
    assert [p.name for p in existing_files(text)] == ["a b c.tum", "d", "a", "none"]


def make(*words: str) -> subprocess.CompletedProcess[str]:
    """Runs make without the variables of the `make test` that may run this test."""
    return subprocess.run(
        ["make", "-s", "-o", "build", *words],
        cwd=ROOT,
        env={n: v for n, v in os.environ.items() if not n.startswith("MAKE")},
        capture_output=True,
        text=True,
        check=False,
    )


def test_make_passes_texts_as_they_are(tmp_path: Path) -> None:
    truth = tmp_path / "my truth.tum"
    truth.touch()
    said = tmp_path / "said.py"
    said.write_text(f"#!{sys.executable}\nimport json, sys\nprint(json.dumps(sys.argv))\n")
    said.chmod(0o755)
    capture = '/d/my "run" #2: `x`.pcap'
    settings = "mounting.xyz_m=[0, 0, 1] driver.path=/a b"
    variables = (f"SET={settings}", f"TRUTH={truth}", "SET_AT=5:a.b=[1, 2]")
    done = make("demo", f"ZLOAM={said}", f"PCAP={capture}", *variables)
    assert done.returncode == 0, done.stderr
    passed = json.loads(done.stdout)
    given = dict(pairwise(passed))
    assert given["--pcap"] == capture
    assert given["--settings"] == settings
    assert given["--truths"] == str(truth)
    assert given["--settings-at"] == "5:a.b=[1, 2]"


@pytest.mark.parametrize(
    ("goal", "given"),
    [
        *(("demo", given) for given in ("PACP=drive.pcap", "STANDBY=1", "SEED=3", "SENSOR=vlp")),
        *(("run", f"{name}=x") for name in ("PCAP", "RATE", "TRUTH", "SET_AT", "SENSOR")),
        *(("demo", f"{name}=0") for name in ("GRAPH", "LOCALIZE", "EXTEND", "VIEW")),
        *(("run", given) for given in ("STANDBY=0", "STANDBY=no", "GRAPH=0", "VIEW=1")),
        # Without MAP=.
        *((goal, given) for goal in ("demo", "run") for given in ("LOCALIZE=1", "EXTEND=1")),
    ],
)
def test_make_refuses_what_it_would_not_use(goal: str, given: str) -> None:
    done = make("-n", goal, given)
    assert done.returncode == 2, done.stdout
    assert f"*** {given.partition('=')[0]}=" in done.stderr


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("demo", "SENSOR=hokuyo"), "--hokuyo"),
        (("demo", "VIEW=1", "JOBS=2", "PRESET=debug"), "--view"),
        (("demo", "MAP=m", "EXTEND=1"), "--extend"),
        (("demo", "MAP=m", "LOCALIZE=1"), "--localize"),
        (("run", "STANDBY=1"), "--standby"),
    ],
)
def test_make_takes_the_variables_of_its_goal(words: tuple[str, ...], option: str) -> None:
    done = make("-n", *words)
    assert option in done.stdout, done.stderr
