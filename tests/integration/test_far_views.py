"""With every view of the monitor open behind a thin link, the robot runs as without them. `make
accept ONLY=views-thin-link` does this for ten minutes and judges the latency too."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.integration import far_views
from tests.integration.hosts import far_host

SECONDS = 90.0


@pytest.mark.slow
def test_the_robot_goes_on_as_without_them(build: Path, robot_file: Path, tmp_path: Path) -> None:
    with far_host() as far:
        found = far_views.measure(build, robot_file, tmp_path, far, SECONDS)
    said = json.dumps(found.summary(), indent=1)
    assert all(more > 0 for more in found.shown.values()), said
    # The views used most of the link: its rate was what limited them.
    assert found.bit_per_s > 0.5 * far_views.BIT_PER_S, said
    for phase in (found.alone, found.watched):
        assert phase.missing() == 0, said
        assert not any(phase.dropped.values()), said
