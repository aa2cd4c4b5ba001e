"""The driver's host has a clock that is ahead: the stages report it, and latencies are
corrected."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.integration.conftest import simulate
from tests.integration.live_run import SECONDS, SPARE_S, STAGES, LiveRun
from zloam_monitor.records import StatusRecord

AHEAD_MS = 400
KNOWN_AFTER_POSES = 60
#: Limit of a latency: above the time of a sweep on a busy machine, far below the offset of the
#: clocks.
WITHIN_MS = 200.0
#: The warning rounds the offset to whole milliseconds, and may be of the second before.
ROUNDED_MS = 1.0


@pytest.fixture(scope="module")
def statuses(
    build: Path, robot_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, StatusRecord]:
    out = tmp_path_factory.mktemp("clocks")
    seconds = str(SECONDS + SPARE_S)
    drive = simulate(build, out, "--world", "city", "--seed", "3", "--duration", seconds)
    run = LiveRun(build, robot_file, drive, out, store=False)
    run.chain.environments["driver"] = {"ZLOAM_FAULT_CLOCK_AHEAD_MS": str(AHEAD_MS)}
    with run:
        run.until_poses(KNOWN_AFTER_POSES)
        # Each stage asks the other hosts for their clocks once a second.
        run._until(lambda: all(has_latencies(run.chain.link.stage(stage)) for stage in STAGES))
        found = run.chain.statuses()
        run.end()
    return found


def has_latencies(status: StatusRecord | None) -> bool:
    """Whether the stage has measured latencies, for which it knows the driver's clock."""
    return status is not None and "since_last_packet" in status.latencies


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
    (said_ms,) = re.findall(r"(\d+) ms ahead of this host's", statuses[stage].reason)
    off_ms = float(said_ms) - of_driver(statuses[stage], "clock_offset_ms")
    assert abs(off_ms) <= ROUNDED_MS


@pytest.mark.parametrize("stage", STAGES)
def test_a_latency_that_began_there_is_corrected(
    statuses: dict[str, StatusRecord], stage: str
) -> None:
    since = statuses[stage].latencies["since_last_packet"]
    assert 0.0 < since["p50"] < WITHIN_MS
