"""A subscriber on the robot itself."""

from __future__ import annotations

import time
from dataclasses import dataclass

from tests.system.live import LiveDeployment
from tests.system.outside import Outside
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session


@dataclass(frozen=True)
class Phase:
    """One state of the link, and what was measured during it."""

    name: str
    at_ns: int
    #: from the last packet to the pose, for the poses of this phase
    latencies_ms: list[float]
    poses_outside: float
    #: age of the last pose when it was received outside
    age_outside_s: float


class Inside:
    """Receives poses on the robot itself, directly from integration."""

    def __init__(self, live: LiveDeployment) -> None:
        address = live.deployment.replicas("integration")[0].address
        self._session = open_session([f"tcp/{address}:7464"], "tcp/0.0.0.0:0")
        self.link = Link(self._session, Keys("robot"))

    def during(self, name: str, who: Outside | None, seconds: float) -> Phase:
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
