"""Two hosts, as network namespaces, whose link is cut and restored. The working instance is on one
side and its standby on the other, in both arrangements (docs/protocol.md, section 6)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import Capture, simulate
from tests.integration.hosts import Far, far_host
from tests.integration.live_run import REPLACED, LiveRun, one_quick
from tests.integration.test_handover import until_waiting
from zloam_monitor import chain as chains
from zloam_monitor import settings
from zloam_monitor.chain import Chain
from zloam_monitor.ports import Ports

#: length of the drives, at least, and of their capture
SECONDS, CAPTURE_S = 20.0, 32.0
FIRST, APART = 40, 30
#: longer than the time after which a silent link ends (zenoh.lease_ms)
CUT_S = 6.0


@pytest.fixture
def far(monkeypatch: pytest.MonkeyPatch) -> Iterator[Far]:
    with far_host() as other:
        # All processes of this host, including this one, listen at the address that the other host
        # reaches.
        monkeypatch.setattr(chains, "Ports", lambda base: Ports(base, other.near_address))
        monkeypatch.setattr(
            Chain, "_own_endpoint", lambda self: f"tcp/{other.near_address}:{self._own_port}"
        )
        yield other


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    return simulate(build, folder, "--world", "city", "--seed", "4", "--duration", str(CAPTURE_S))


def start_far(run: LiveRun, other: Far, stage: str) -> str:
    """Starts an instance on the other host, which stands by."""
    name = f"{stage}-far"
    command = [*run.chain._commands[stage], "--instance", name]
    command += ["--set", f"zenoh.listen=[tcp/{other.address}:0]"]
    run.chain._commands[name] = other.command(command)
    run.chain.start(name)
    until_waiting(run, stage, name)
    return name


def cut(run: LiveRun, other: Far) -> None:
    """Cuts the link for CUT_S and checks that poses keep coming."""
    other.link("down")
    before = len(run.poses)
    run.wait(CUT_S)
    run._until(lambda: len(run.poses) > before + 20)
    other.link("up")


@pytest.mark.slow
@pytest.mark.parametrize("works", one_quick(("near", "far"), "far"))
@pytest.mark.parametrize("stage", one_quick(REPLACED, "odometry"))
def test_a_cut_link_costs_no_pose(
    build: Path,
    robot_file: Path,
    drive: Capture,
    far: Far,
    tmp_path: Path,
    stage: str,
    works: str,
) -> None:
    more = ("recovery.standby=true",)
    run = LiveRun(build, robot_file, drive, tmp_path, seconds=SECONDS, more=more)
    run._store += ["--set", f"zenoh.host={far.near_address}"]
    with run:
        name = start_far(run, far, stage)
        run.until_poses(FIRST)
        if works == "far":
            reply = settings.commanded(run.chain.link, stage, "handover", {"to": name})
            assert reply.ok, reply.message
            own = next(i for s, i in run.chain.link.statuses if s == stage and i != name)
            until_waiting(run, stage, own)
        run.until_poses(len(run.poses) + APART)
        cut(run, far)
        # Mapping may be missing for as long as a search for the place takes; poses keep coming.
        enough = len(run.poses) + APART
        run._until(lambda: len(run.poses) >= enough)
        statuses = run.end()
    run.assert_one_trajectory(statuses["driver"].last_sweep)
    # Each sweep has one odometry pose, except that the newest is published again at a take-over.
    counts = np.bincount(list(itertools.chain(*run.odometry_poses.values())))
    assert (counts > 1).sum() <= 3
