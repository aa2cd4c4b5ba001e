"""Somebody outside hears every key over a bad link, or none at all: the robot goes on as if nobody
were there, and the one outside hears again when the link is good."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from tests.system.compose import ROOT
from tests.system.conftest import Drive, drive_of
from tests.system.live import Driven, LiveDeployment, running
from tests.system.outside import Outside, outside, relay, slow
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session

pytestmark = pytest.mark.system
BEFORE_SWEEPS = 50
PHASE_S = 15.0
RATE_BIT_PER_S = 1_000_000
LOSS, DELAY_S = 0.2, 0.2
#: after the cut, until poses come again: Zenoh's lease, and the pause between tries to connect
HEARS_AGAIN_S = 45.0
DRIVE_SECONDS = 240
REPORT = ROOT / "out" / "system" / "outside_link.json"


@dataclass(frozen=True)
class Phase:
    """What the link was like, and what came of it."""

    name: str
    at_ns: int
    #: last packet to pose, of the poses of this time
    latencies_ms: list[float]
    poses_outside: float
    #: of the last pose that was heard outside, when it was
    age_outside_s: float


@dataclass(frozen=True)
class Observed:
    """The drive with all phases."""

    phases: list[Phase]
    driven: Driven
    poses_after_cut: float


class Inside:
    """Hears poses on the robot itself, from integration."""

    def __init__(self, live: LiveDeployment) -> None:
        address = live.deployment.replicas("integration")[0].address
        self._session = open_session([f"tcp/{address}:7464"], "tcp/0.0.0.0:0")
        self.link = Link(self._session, Keys("robot"))

    def during(self, name: str, who: Outside | None, seconds: float = PHASE_S) -> Phase:
        self.link.poll()
        known, at_ns = set(self.link.poses), time.time_ns()
        before = who.heard().get("pose", 0.0) if who else 0.0
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            self.link.poll(0.2)
        new = [pose for sweep, pose in self.link.poses.items() if sweep not in known]
        latencies = [1e-6 * (p.trace[-1].published_ns - p.last_packet_ns) for p in new]
        said = who.heard() if who else {}
        heard = said.get("pose", before) - before
        return Phase(name, at_ns, latencies, heard, said.get("pose_age_s", 0.0))

    def close(self) -> None:
        self.link.close()
        self._session.close()


@pytest.fixture(scope="module")
def link_drive(images: None, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return drive_of(tmp_path_factory.mktemp("link-drive"), DRIVE_SECONDS, "--laps", "4")


def hears(who: Outside) -> float:
    """Poses that came outside from now on, as soon as there are some."""
    before = who.heard().get("pose", 0.0)
    deadline = time.monotonic() + HEARS_AGAIN_S
    while who.heard().get("pose", 0.0) <= before + 10 and time.monotonic() < deadline:
        time.sleep(1.0)
    return float(who.heard().get("pose", 0.0) - before)


def phases(live: LiveDeployment, inside: Inside) -> Iterator[Phase | float]:
    yield inside.during("nobody outside", None)
    with outside(live.deployment) as who:
        hears(who)
        yield inside.during("good link", who)
        with slow(who.name, RATE_BIT_PER_S):
            yield inside.during("1 Mbit/s", who)
        with who.losing(LOSS):
            yield inside.during("20 % loss", who)
        with who.cut():
            yield inside.during("cut", who)
        yield hears(who)
    with (
        relay(live.deployment, DELAY_S) as endpoint,
        outside(live.deployment, endpoint) as who,
    ):
        yield inside.during("200 ms", who)


@pytest.fixture(scope="module")
def observed(link_drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Observed:
    out = tmp_path_factory.mktemp("outside")
    with running(link_drive.pcap, out) as live:
        live.until_sweep(BEFORE_SWEEPS)
        with contextlib.closing(Inside(live)) as inside:
            found = list(phases(live, inside))
        driven = live.end()
    seen = [phase for phase in found if isinstance(phase, Phase)]
    (after_cut,) = [count for count in found if isinstance(count, float)]
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    percentiles = {p.name: np.percentile(p.latencies_ms, (50, 95)).round(2).tolist() for p in seen}
    outside_s = {p.name: [p.poses_outside, round(p.age_outside_s, 3)] for p in seen}
    found_all = {"latency_ms.p50_p95": percentiles, "outside.poses_and_last_age_s": outside_s}
    REPORT.write_text(json.dumps(found_all, indent=1) + "\n")
    return Observed(seen, driven, after_cut)


def test_the_robot_misses_nothing(observed: Observed) -> None:
    windows = observed.driven.windows([phase.at_ns for phase in observed.phases])
    absent = {p.name: w.absent for p, w in zip(observed.phases, windows, strict=True)}
    assert absent == {phase.name: [] for phase in observed.phases}


def test_the_robot_drops_nothing_on_the_way_of_the_pose(observed: Observed) -> None:
    for (stage, _), status in observed.driven.statuses.items():
        if stage in ("registration", "odometry", "integration"):
            for account in status.inputs:
                assert not any(account.dropped.values()), (stage, account)


def test_each_pose_was_heard_inside(observed: Observed) -> None:
    for phase in observed.phases:
        assert len(phase.latencies_ms) >= 10 * PHASE_S - 2, phase.name


def test_outside_hears_over_a_bad_link(observed: Observed) -> None:
    heard = {phase.name: phase.poses_outside for phase in observed.phases}
    assert heard["good link"] >= 8 * PHASE_S
    # A subscriber to every key wants fifty times what this link carries: poses go first.
    assert heard["1 Mbit/s"] >= 3 * PHASE_S
    # How many is TCP's luck: each loss in a row doubles its pause. Seen: 93, 11.
    assert heard["20 % loss"] > 0
    assert heard["200 ms"] >= 3 * PHASE_S


def test_outside_hears_again_after_a_cut(observed: Observed) -> None:
    cut = next(phase for phase in observed.phases if phase.name == "cut")
    assert cut.poses_outside < 5 * PHASE_S
    assert observed.poses_after_cut > 10
