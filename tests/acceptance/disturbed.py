"""The numbers of issue 37: what is injected, and what the tests that inject it measured.

The tests are those of `make test`; each line here runs its own tests and shows the figures that
they record (pytest's record_property, gtest's RecordProperty), or how many of them passed.
"""

from __future__ import annotations

import subprocess
import tempfile
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import Setting
from tests.acceptance.seen import Seen

ATTACK = "tests/attack/test_attack.py"
OUTPUTS = "tests/integration/test_live_outputs.py"
RESTART = "tests/integration/test_restart.py"
MONITOR = "services/monitor/tests"
#: as ctest's limit (cmake/options.cmake); many tests wait for what must come
UNIT_TEST_S = 300.0
PLAIN = "the pose goes on, counted by reason"


@dataclass(frozen=True)
class Line:
    """One number of the issue, or a part of it."""

    name: str
    injected: str
    limit: str
    #: pytest node ids
    nodes: tuple[str, ...] = ()
    #: gtest program -> filter
    units: dict[str, str] = field(default_factory=dict)


def _flood(name: str, how: str, limit: str, units: dict[str, str]) -> Line:
    injected = f"odometry 1 s and corrections 0.5 s at 5 000/s: {how}"
    return Line(name, injected, limit, (f"{ATTACK}::test_a_flood[{how}]",), units)


LINES = {
    "A": (
        Line(
            "1-to-8",
            "each kind of message in each forged way, 40 MB each, nested commands, revisions",
            PLAIN,
            (f"{ATTACK}::test_one_of_everything",),
            {"runtime_stage_test": "Stage.Refuses*:Service.Refuses*"},
        ),
        _flood("1-runs", "other run", PLAIN, {"runtime_unit_test": "RunGate.*"}),
        _flood(
            "2-numbers",
            "far sweep",
            "nothing true is given up",
            {"runtime_unit_test": "Sequencer.*"},
        ),
        Line(
            "3-memory",
            "publishers, numbers, tokens and hosts without end",
            "each buffer has a bound",
            units={
                "runtime_unit_test": "SeenNumbers.*:RunGate.AFlood*:Sequencer.AFlood*",
            },
        ),
        Line(
            "4-json",
            "brackets 30 000 deep, 8 MB commands",
            "refused before any parser",
            units={
                "runtime_unit_test": "JsonGuard.*",
                "runtime_stage_test": "Service.RefusesACommand*",
            },
        ),
        Line(
            "5-revisions",
            "a revision with which a stage ends three times in a row; revisions put by anybody",
            "withdrawn; only what keepers answer counts",
            units={
                "runtime_unit_test": "ShortLives.*:Schedule.*",
                "runtime_stage_test": "LiveConfiguration.*",
            },
        ),
        _flood("6-values", "wild values", PLAIN, {"geometry_test": "MotionCheck.*"}),
        Line(
            "7-store",
            "tiles of another map, instants beyond all others, on disk too",
            "only the mapping that answers is believed",
            units={"store_test": "LivePublisher.*:Store.*"},
        ),
        Line(
            "9-duplicates",
            "a second driver, odometry, mapping, integration in a live run",
            "both say so, one publisher of poses",
            (f"{ATTACK}::test_a_second_instance_stands_by_and_both_say_so",),
            {"runtime_stage_test": "Stage.OfTwo*:Stage.WhoIsSilent*"},
        ),
    ),
    "B": (
        Line(
            "10-health",
            "silent inputs, refused inputs, floods of strangers",
            "degraded with the reason until it is over",
            units={"runtime_unit_test": "InputWatch.*"},
        ),
        Line(
            "11-codes",
            "stages that can't write trajectory or map",
            "exit code 3, named in the table, nothing empty in its place",
            (f"{MONITOR}/test_chain.py::test_a_file_that_a_stage_did_not_write_fails_the_run",),
            {"runtime_program_test": "Program.Files*:Program.AFile*"},
        ),
        Line(
            "12-files",
            "driver killed in a live run, 4.5 s away",
            "each run's files, with all poses heard",
            (f"{OUTPUTS}::test_each_run_has_its_own_files",),
            {"runtime_unit_test": "OutputFolder.*"},
        ),
        Line(
            "13-restart",
            "mapping killed live with a store; sensor silent or a stage stopped for 5 s",
            "the map is there at the end, poses are found in it soon",
            (
                f"{RESTART}::test_mapping_takes_its_map_back",
                f"{RESTART}::test_after_a_standstill_the_map_is_found_again",
                f"{RESTART}::test_after_a_silence_of_the_sensor_the_map_is_found_again",
                f"{RESTART}::test_an_odometry_that_stood_still_goes_on_in_its_map",
            ),
            {"mapping_bridging_test": "*"},
        ),
        Line(
            "14-accounts",
            "a stage stopped again and again; no data at all; stamps that go back",
            "accounts add up, or say what came",
            (
                f"{OUTPUTS}::test_accounts_add_up_under_overload",
                f"{OUTPUTS}::test_a_run_without_data_says_that_none_came",
                f"{MONITOR}/test_report.py",
                f"{MONITOR}/test_accounting.py",
            ),
        ),
    ),
    "D": (
        Line(
            "18-texts",
            "names that look like numbers, paths with ' #' and ': ', lists with blanks",
            "one reading of types; texts as they stand",
            (f"{MONITOR}/test_robot_file.py", f"{MONITOR}/test_settings.py"),
        ),
        Line(
            "19-tables",
            "reference files in ns, ms, NaN, BOM, of one pose, with holes",
            "read right or refused by line",
            (f"{MONITOR}/test_trajectory.py", f"{MONITOR}/test_evaluation.py"),
        ),
        Line(
            "20-out",
            "inputs, users' files and links in OUT",
            "only what an earlier run made is replaced",
            (f"{MONITOR}/test_claims.py",),
        ),
        Line(
            "21-save",
            "save out of the folder by '..', absolute path and link, and over others' files",
            "refused; nothing of others touched",
            (
                f"{OUTPUTS}::test_a_save_stays_below_the_folder",
                f"{OUTPUTS}::test_a_save_leaves_what_is_others_alone",
            ),
        ),
    ),
    "E": (
        Line(
            "22-parent",
            "SIGKILL, SIGTERM, SIGHUP to whoever started the stages",
            "the stages end, files written",
            (f"{MONITOR}/test_supervision.py",),
            {"runtime_program_test": "Program.Ends*:Program.AHangUp*:Program.APipe*"},
        ),
        Line(
            "23-supervision",
            "a stage that dies again and again",
            "started again with growing pauses",
            (
                f"{MONITOR}/test_supervision.py"
                "::test_a_stage_that_dies_is_started_again_with_growing_pauses",
            ),
        ),
        Line(
            "24-shm",
            "a /dev/shm without room",
            "sockets, one clear line, the same bytes",
            (
                "tests/integration/test_shared_memory_room.py",
                "tests/integration/test_locked_memory.py",
            ),
        ),
    ),
}


def _measure(setting: Setting, line: Line) -> Measured:
    seen = Seen()
    with tempfile.TemporaryDirectory() as folder:
        for program, chosen in line.units.items():
            found = Path(folder) / f"{program}.xml"
            binary = setting.build / "tests" / program
            if not binary.exists():
                raise Skip(f"{binary} is not built")
            done = subprocess.run(
                [binary, f"--gtest_filter={chosen}", f"--gtest_output=xml:{found}"],
                capture_output=True,
                check=False,
                timeout=UNIT_TEST_S,
            )
            seen.read_gtest(found, done.returncode, chosen)
    if line.nodes:
        seen.read_pytest(setting, *line.nodes)
    return seen.judged(seen.words())


def checks(setting: Setting) -> list[Check]:
    """All lines, in the order of the issue."""
    return [
        Check(
            f"disturbed-{line.name}",
            line.injected,
            line.limit,
            f"make accept ONLY=disturbed-{line.name}",
            partial(_measure, setting, line),
            part,
        )
        for part, lines in LINES.items()
        for line in lines
    ]
