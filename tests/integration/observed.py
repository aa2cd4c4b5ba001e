"""Observes a robot during a part of its run: poses, their latency, dropped sweeps, memory."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.integration.live_run import LiveRun
from zloam_monitor import messages

#: interval at which memory is measured
LOOK_S = 5.0
#: stages whose memory counts; the chain's other processes belong to the test
STAGES = ("driver", "registration", "odometry", "mapping", "integration", "store", "preview")
POSE_WAY = ("registration", "odometry", "integration")


@dataclass
class Phase:
    """What was observed during one part of the drive."""

    #: from the last packet of a sweep to the arrival of its pose here
    latencies_ms: list[float] = field(default_factory=list)
    sweeps: list[int] = field(default_factory=list)
    #: stage -> its memory at each measurement
    memory_mib: dict[str, list[float]] = field(default_factory=dict)
    #: sweeps that the stages between driver and pose dropped, by stage, at the end of the phase
    dropped: dict[str, int] = field(default_factory=dict)

    def missing(self) -> int:
        """Number of sweeps without a pose."""
        return self.sweeps[-1] - self.sweeps[0] + 1 - len(set(self.sweeps))

    def latency_ms(self, percent: float) -> float:
        return float(np.percentile(self.latencies_ms, percent))

    def growth_mib(self) -> dict[str, float]:
        """Growth of each stage's memory from the median of the first quarter to that of the last
        one."""
        found = {}
        for stage, looks in self.memory_mib.items():
            quarter = max(1, len(looks) // 4)
            found[stage] = float(np.median(looks[-quarter:]) - np.median(looks[:quarter]))
        return found


class Observed:
    """Observes a running robot."""

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
        """Observes the robot for `seconds` from now on."""
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
