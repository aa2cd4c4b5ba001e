"""What a subscriber on the robot itself hears, and how much memory the robot's processes have."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.system.compose import Deployment, inspect
from tests.system.live import LiveDeployment
from tests.system.outside import Outside
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session

SAMPLE_S = 5.0


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


class Inside:
    """Hears poses on the robot itself, from integration."""

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


class Memory:
    """Resident memory of the main process of each of a deployment's containers, again and again."""

    def __init__(self, deployment: Deployment) -> None:
        found = {name: inspect(str(c["Name"])) for name, c in deployment.containers().items()}
        self._pids = {name: container.pid for name, container in found.items() if container.pid}
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._look)
        #: (instant of the host's clock, service -> MiB)
        self.seen: list[tuple[int, dict[str, float]]] = []

    def _look(self) -> None:
        while not self._ends.wait(SAMPLE_S):
            mib = {name: _resident_mib(pid) for name, pid in self._pids.items()}
            self.seen.append((time.time_ns(), mib))

    def peaks_mib(self, begin_ns: int, seconds: float) -> dict[str, float]:
        """Service -> the most within the seconds after an instant: the store's rises and falls, as
        it writes its log anew."""
        ends_ns = begin_ns + int(1e9 * seconds)
        within = [mib for at_ns, mib in self.seen if begin_ns <= at_ns < ends_ns]
        return {service: max(mib[service] for mib in within) for service in within[0]}

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        self._thread.start()
        try:
            yield
        finally:
            self._ends.set()
            self._thread.join()


def _resident_mib(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS"))
