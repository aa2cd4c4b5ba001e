"""Checks of `zloam doctor`: on robots with an injected fault, on healthy ones, and on files (issue
41)."""

from __future__ import annotations

import functools
import json
from collections import Counter
from pathlib import Path

from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import Setting
from tests.acceptance.seen import Seen
from tests.integration.robot_faults import FAULTS, HEALTHY, Fault

TRIES = 20
TEST = "tests/integration/test_doctor_live.py"
#: robots that run at once; each takes a third of a core
AT_ONCE = 3
#: pattern of the recordings that the doctor reads
CAPTURES = "data/**/*.pcap*"


def _live(setting: Setting, faults: dict[str, Fault], tries: int) -> Measured:
    """Runs the tests `tries` times; each try starts a robot of its own."""
    seen = Seen()
    chosen = [f"{TEST}::test_the_doctor_names_it[{name}]" for name in faults]
    (setting.out / "accept").mkdir(parents=True, exist_ok=True)
    for _ in range(tries):
        said = seen.read_pytest(setting, "-m", "slow or not slow", "-n", AT_ONCE, *chosen)
        with (setting.out / "accept" / "doctor.log").open("a") as log:
            log.write(said)
    failed = Counter(name.partition("[")[2].rstrip("]") or name for name in seen.failed)
    which = "".join(f"; {name}: {count} not named" for name, count in failed.items())
    wanted = len(faults) * tries
    judged = seen.judged(f"{seen.held} of {wanted}{which}")
    return Measured(judged.figure, judged.held and seen.held == wanted)


def _files(setting: Setting) -> Measured:
    """The doctor reads each capture to its end: it exits with 0 or 1 and a finding, or refuses the
    file with the reason."""
    folder = setting.recording("data")
    odd, count = [], 0
    for path in sorted(folder.parent.glob(CAPTURES)):
        count += 1
        if not _is_judged(setting, path):
            odd.append(path.name)
    if not count:
        raise Skip(f"no capture in {folder}")
    return Measured(f"{count} captures" + "".join(f"; {name}" for name in odd), not odd)


def _is_judged(setting: Setting, path: Path) -> bool:
    metadata = sorted(path.parent.glob(f"{path.stem}*.json"))
    words = ["--metadata", metadata[0]] if metadata else []
    done = setting.python(
        "-m", "zloam_monitor", "doctor", path, "--preset-dir", setting.build, "--json", *words
    )
    if done.returncode not in (0, 1) or "Traceback" in done.stdout:
        return False
    last = done.stdout.strip().splitlines()[-1:] or [""]
    if not last[0].startswith("{"):
        return path.name in last[0]
    said = json.loads(last[0])
    return bool(said["well"]) == (done.returncode == 0)


def checks(setting: Setting) -> list[Check]:
    rows = (
        ("live", "the doctor names each fault of a robot that runs", FAULTS),
        ("healthy", "the doctor says nothing of a healthy robot", HEALTHY),
    )
    return [
        *(
            Check(
                f"doctor-{name}",
                line,
                f"{TRIES} of {TRIES} each",
                f"make accept ONLY=doctor-{name}",
                functools.partial(_live, setting, faults, TRIES),
            )
            for name, line, faults in rows
        ),
        Check(
            "doctor-files",
            "the doctor reads each recorded capture, or says why it can't",
            "each",
            "make accept ONLY=doctor-files",
            functools.partial(_files, setting),
        ),
    ]
