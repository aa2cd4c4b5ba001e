"""Zenoh locks shared memory: a stage with a low limit on locked memory must not lose messages.

A reader that cannot lock a publisher's pool never sees the messages in it, neither first nor
repeated ones, and gets no error.
"""

import os
import resource
import shutil
import time
from pathlib import Path

import pytest

from tests.integration.conftest import Capture, digests
from zloam_monitor import sources
from zloam_monitor.chain import Chain
from zloam_monitor.records import StatusRecord
from zloam_monitor.robot_file import names

FILES = ("trajectory.tum", "odometry.tum", "map.pcd")
RUN_SECONDS = 120.0
LOCKABLE_MIB = 8
ATTEMPTS = 3
#: Runs a program with a low limit on locked memory, without the capability CAP_IPC_LOCK that lifts
#: the limit; only root has it to drop.
SMALL = [
    *(["setpriv", "--bounding-set=-ipc_lock", "--inh-caps=-ipc_lock"] if os.getuid() == 0 else []),
    "prlimit",
    f"--memlock={LOCKABLE_MIB << 20}:{LOCKABLE_MIB << 20}",
]

#: more than all pools of a chain
ENOUGH_BYTES = 512 << 20
CAP_IPC_LOCK = 14


def may_lock_enough() -> bool:
    """Whether this process may lock all pools. Otherwise (default containers) no stage shares
    memory, and no message can be lost in it."""
    status = Path("/proc/self/status").read_text()
    capabilities = int(status.split("CapEff:")[1].split()[0], 16)
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    unlimited = limit == resource.RLIM_INFINITY or limit >= ENOUGH_BYTES
    return unlimited or bool(capabilities >> CAP_IPC_LOCK & 1)


pytestmark = [
    pytest.mark.skipif(
        any(shutil.which(tool) is None for tool in ("setpriv", "prlimit")),
        reason="needs setpriv and prlimit (util-linux)",
    ),
    pytest.mark.skipif(
        not may_lock_enough(), reason="this user may not lock 512 MiB (ulimit -l): no shared memory"
    ),
]


class SmallChain(Chain):
    """A chain in which some stages may lock little memory; a sweep without progress is soon sent
    again."""

    def __init__(
        self,
        build: Path,
        robot_file: Path,
        capture: Capture,
        logs: Path,
        small: tuple[str, ...],
        *options: str,
    ) -> None:
        robot = names(robot_file, [])
        settings = [
            *sources.from_pcap(capture.pcap).driver_settings("max"),
            f"integration.output_dir={logs}",
            f"mapping.map_path={logs / 'map.pcd'}",
            "flow.retransmit_ms=100",
            "recovery.gap_replay_ms=50",
        ]
        super().__init__(build, robot_file, robot.robot, settings, logs, robot.sensor)
        for stage in small:
            sets = [word for option in options for word in ("--set", option)]
            self._commands[stage] = [*SMALL, *self._commands[stage], *sets]

    def follow(self) -> dict[str, StatusRecord]:
        """Follows the run to its end; returns the final statuses."""
        ends = time.monotonic() + RUN_SECONDS
        with self:
            while not self.finished():
                self.link.poll(0.2)
                self.check()
                assert time.monotonic() < ends, f"stands still at {self.progress()}"
            self.link.query_statuses()
            assert set(self.stop().values()) == {0}
        return self.statuses()


@pytest.fixture(scope="module")
def unlimited(
    build: Path, robot_file: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    """Digests of a run without limits on locked memory."""
    logs = tmp_path_factory.mktemp("unlimited")
    statuses = SmallChain(build, robot_file, capture, logs, ()).follow()
    assert statuses["mapping"].inputs[0].recovered == 0
    return digests(logs, FILES)


def test_a_pool_that_the_reader_cannot_lock(
    build: Path, robot_file: Path, capture: Capture, unlimited: dict[str, str], tmp_path: Path
) -> None:
    """Mapping can lock pools as small as its own, but not odometry's larger one. Whether a link
    shares memory is negotiated at its start and may fail on a busy machine; then nothing can be
    lost, hence several attempts."""
    recovered = 0
    for attempt in range(ATTEMPTS):
        out = tmp_path / str(attempt)
        out.mkdir()
        chain = SmallChain(build, robot_file, capture, out, ("mapping",), "zenoh.pool_mib=1")
        account = chain.follow()["mapping"].inputs[0]
        assert account.balanced()
        assert account.lost == 0
        assert digests(out, FILES) == unlimited
        recovered += account.recovered
        if recovered > 0:
            break
    assert recovered > 0, "nothing was lost: the test shows nothing"


def test_without_room_for_the_pools_there_is_no_shared_memory(
    build: Path, robot_file: Path, capture: Capture, unlimited: dict[str, str], tmp_path: Path
) -> None:
    everybody = ("driver", "registration", "odometry", "mapping", "integration")
    chain = SmallChain(build, robot_file, capture, tmp_path, everybody, "zenoh.pool_mib=4")
    for stage, status in chain.follow().items():
        assert all(account.recovered == 0 for account in status.inputs), stage
        said = (tmp_path / f"{stage}.log").read_text()
        assert "can't be locked" in said, stage
    assert digests(tmp_path, FILES) == unlimited
