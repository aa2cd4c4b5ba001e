"""What some time of a robot's run was like: its poses, their latency, what it lost, its memory."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.integration.live_run import LiveRun
from zloam_monitor import messages

#: memory is looked at so often
LOOK_S = 5.0
#: those whose memory counts; others of the chain's processes are the test's
STAGES = ("driver", "registration", "odometry", "mapping", "integration", "store", "preview")
POSE_WAY = ("registration", "odometry", "integration")


@dataclass
class Phase:
    """Some time of the drive."""

    #: from the last packet of a sweep to its pose here
    latencies_ms: list[float] = field(default_factory=list)
    sweeps: list[int] = field(default_factory=list)
    #: stage -> at each look
    memory_mib: dict[str, list[float]] = field(default_factory=dict)
    #: what the stages on the way of the pose left out, at its end
    dropped: dict[str, int] = field(default_factory=dict)

    def missing(self) -> int:
        """Sweeps without a pose."""
        return self.sweeps[-1] - self.sweeps[0] + 1 - len(set(self.sweeps))

    def latency_ms(self, percent: float) -> float:
        return float(np.percentile(self.latencies_ms, percent))

    def growth_mib(self) -> dict[str, float]:
        """Of each stage, from the first quarter to the last one."""
        found = {}
        for stage, looks in self.memory_mib.items():
            quarter = max(1, len(looks) // 4)
            found[stage] = float(np.median(looks[-quarter:]) - np.median(looks[:quarter]))
        return found


class Observed:
    """A robot that runs."""

    def __init__(self, run: LiveRun) -> None:
        self._run = run
        self._phase = Phase()
        self._subscriber = run.chain.link.session.declare_subscriber(
            run.chain.link.keys.pose, self._note
        )

    def _note(self, sample: Any) -> None:
        now_ns = time.time_ns()
        pose = messages.decode("MapPose", sample.payload.to_bytes())
        self._phase.sweeps.append(pose.Header().Sweep())
        self._phase.latencies_ms.append(1e-6 * (now_ns - pose.Header().LastPacketNs()))

    def _dropped(self) -> dict[str, int]:
        link = self._run.chain.link
        link.query_statuses()
        statuses = link.newest_statuses()
        return {
            stage: sum(sum(account.dropped.values()) for account in statuses[stage].inputs)
            for stage in POSE_WAY
        }

    def during(self, seconds: float) -> Phase:
        """What it is like from now on, so long."""
        before = self._dropped()
        phase = self._phase = Phase()
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            self._run.wait(LOOK_S)
            for stage, mib in self._run.chain.processes.pss_mib().items():
                if stage in STAGES:
                    phase.memory_mib.setdefault(stage, []).append(mib)
        self._phase = Phase()
        phase.dropped = {s: count - before[s] for s, count in self._dropped().items()}
        return phase
