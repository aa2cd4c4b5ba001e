"""The doctor names each fault of a running robot (issue 41) and reports nothing about a healthy
one. `make accept ONLY='doctor-*'` tries each fault twenty times."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration import robot_faults
from tests.integration.robot_faults import FAULTS, HEALTHY, QUICK, Fault
from zloam_monitor import doctor
from zloam_monitor.heard import Finding

ALL = {**FAULTS, **HEALTHY}


def said_of(build: Path, robot_file: Path, out: Path, fault: Fault) -> list[Finding]:
    """The doctor's findings after the fault was injected."""
    drive = robot_faults.drive_for(build, out, fault)
    stand = robot_faults.made(build, robot_file, drive, out, fault)
    with stand.run as run:
        try:
            if fault.after_poses:
                run.until_poses(fault.after_poses)
            fault.do(stand)
            return doctor.findings(doctor.listen(run.chain.link, fault.seconds))
        finally:
            stand.close()


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in ALL],
)
def test_the_doctor_names_it(build: Path, robot_file: Path, tmp_path: Path, name: str) -> None:
    fault = ALL[name]
    robot_faults.needs(fault)
    found = said_of(build, robot_file, tmp_path, fault)
    said = "\n".join(map(str, found))
    if name in HEALTHY:
        assert not any(finding.is_fault for finding in found), said
    else:
        assert any(fault.words in finding.what for finding in found), said
