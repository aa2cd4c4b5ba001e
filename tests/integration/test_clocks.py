"""The driver's host has a clock that is ahead: the stages report it, and latencies are
corrected."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.conftest import simulate
from tests.integration.live_run import SECONDS, STAGES, LiveRun
from zloam_monitor.records import StatusRecord

AHEAD_MS = 400
#: Each stage asks the other hosts for their clocks once a second, so the offset is known by then.
KNOWN_AFTER_POSES = 60
#: Limit of a latency: above the time of a sweep on a busy machine, far below the offset of the
#: clocks.
WITHIN_MS = 200.0


@pytest.fixture(scope="module")
def statuses(
    build: Path, robot_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, StatusRecord]:
    out = tmp_path_factory.mktemp("clocks")
    drive = simulate(build, out, "--world", "city", "--seed", "3", "--duration", str(SECONDS + 1))
    run = LiveRun(build, robot_file, drive, out, store=False)
    run.chain.environments["driver"] = {"ZLOAM_FAULT_CLOCK_AHEAD_MS": str(AHEAD_MS)}
    with run:
        run.until_poses(KNOWN_AFTER_POSES)
        found = run.chain.statuses()
        run.end()
    return found


def of_driver(status: StatusRecord, figure: str) -> float:
    (found,) = [v for name, v in status.figures.items() if name.startswith(f"{figure}/")]
    return found


@pytest.mark.parametrize("stage", STAGES)
def test_the_offset_is_within_its_uncertainty(
    statuses: dict[str, StatusRecord], stage: str
) -> None:
    off_ms = of_driver(statuses[stage], "clock_offset_ms") - AHEAD_MS
    assert abs(off_ms) <= of_driver(statuses[stage], "clock_uncertainty_ms")


@pytest.mark.parametrize("stage", STAGES)
def test_it_is_a_warning(statuses: dict[str, StatusRecord], stage: str) -> None:
    assert statuses[stage].health == "degraded"
    assert f"{AHEAD_MS} ms ahead of this host's" in statuses[stage].reason


@pytest.mark.parametrize("stage", STAGES)
def test_a_latency_that_began_there_is_corrected(
    statuses: dict[str, StatusRecord], stage: str
) -> None:
    since = statuses[stage].latencies["since_last_packet"]
    assert 0.0 < since["p50"] < WITHIN_MS
