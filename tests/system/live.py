"""The deployment with a live sensor: the packets of a capture are sent to the driver's
container."""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from evo.core.geometry import umeyama_alignment
from numpy.typing import NDArray

from tests.acceptance import live
from tests.system.compose import Deployment
from tests.system.conftest import ask_statuses, up
from zloam_monitor.records import StatusRecord
from zloam_monitor.trajectory import Trajectory, interpolate, read

SENSOR_PORT = 2368
STAGES = ("registration", "odometry", "mapping", "integration")
#: The last sweeps are still being processed after the last packet.
AFTER_SECONDS = 3.0
#: limit of the wait for the driver's process
LISTENS_S = 60.0
#: Limit of the error: a factor on the undisturbed run's, plus metres for errors of a few
#: millimetres.
WORSE, FLOOR_M = 1.2, 0.01
#: A disturbance counts from the sweep that was being processed when it began.
IN_WORK_NS = 500_000_000


@dataclass
class LiveDeployment:
    """Running containers, and the sender of the packets."""

    deployment: Deployment
    sender: threading.Thread
    enough: threading.Event

    def statuses(self) -> dict[tuple[str, str], StatusRecord]:
        """Statuses of all instances, killed ones included."""
        return ask_statuses(self.deployment.router_port)

    def newest(self, stage: str) -> StatusRecord:
        """Newest status of the stage, which is that of its running instance."""
        return max(
            (s for (name, _), s in self.statuses().items() if name == stage),
            key=lambda s: s.stamp_ns,
        )

    def until_sweep(self, sweep: int, seconds: float = 60.0) -> None:
        """Waits until integration has published the pose of this sweep."""
        deadline = time.monotonic() + seconds
        while (self.newest("integration").last_sweep or 0) < sweep:
            assert time.monotonic() < deadline, f"no pose of sweep {sweep} within {seconds:.0f} s"
            time.sleep(0.5)

    def stop_sending(self) -> None:
        """Stops before the end of the capture, which proves that the observed phase lay within the
        drive."""
        assert self.sender.is_alive(), "the drive was too short"
        self.enough.set()
        self.sender.join()
        time.sleep(AFTER_SECONDS)

    def end(self) -> Driven:
        """Stops everything; returns what integration wrote after the last packet, and all
        statuses."""
        self.stop_sending()
        statuses = self.statuses()
        driver = (s.last_sweep or 0 for (stage, _), s in statuses.items() if stage == "driver")
        self.deployment.run("stop", "--timeout", "20")
        return Driven(read(self.deployment.out / "trajectory.tum"), max(driver) + 1, statuses)


def driver_says_something(deployment: Deployment) -> bool:
    return any(stage == "driver" for stage, _ in ask_statuses(deployment.router_port))


@contextlib.contextmanager
def running(
    capture: Path,
    out: Path,
    *options: str,
    layers: Sequence[str] = (),
    shared_memory: bool = False,
) -> Iterator[LiveDeployment]:
    """`docker compose up` with a sensor that starts when all stages are ready."""
    deployment = Deployment(
        f"zloam-live-{os.getpid()}",
        out,
        ["tests/system/live.yml", *layers],
        {"ZLOAM_SHARED_MEMORY": str(shared_memory).lower()},
    )
    with up(deployment, *options):
        # Packets sent before the driver listens would be lost, and with them the first sweep, from
        # which all sweeps are numbered.
        deployment.wait("a driver", LISTENS_S, lambda _: driver_says_something(deployment))
        address = deployment.replicas("driver")[0].address
        enough = threading.Event()
        sender = threading.Thread(
            target=live.send,
            args=(capture, SENSOR_PORT, float("inf")),
            kwargs={"host": address, "enough": enough},
        )
        sender.start()
        try:
            yield LiveDeployment(deployment, sender, enough)
        finally:
            enough.set()


def numbers(found: Trajectory) -> NDArray[np.int64]:
    """Sweep number of each pose by its stamp; the first pose is that of sweep 0. Step by step,
    since the duration of a revolution is known only to a firing and the error would add up."""
    assert found.stamps_ns is not None
    steps_ns = np.diff(found.stamps_ns)
    steps = np.rint(steps_ns / float(np.median(steps_ns))).astype(np.int64)
    return np.concatenate(([0], np.cumsum(steps)))


@dataclass(frozen=True)
class Window:
    """The effect of one disturbance: the time from its beginning to that of the next one."""

    #: mask of the trajectory's poses within the window
    poses: NDArray[np.bool_]
    #: sweeps without a pose
    absent: list[int]


@dataclass(frozen=True)
class Driven:
    """The results of a drive."""

    trajectory: Trajectory
    #: number of the driver's sweeps
    sweeps: int
    statuses: dict[tuple[str, str], StatusRecord]

    def absent(self) -> list[int]:
        """Sweeps without a pose."""
        found: list[int] = np.setdiff1d(np.arange(self.sweeps), numbers(self.trajectory)).tolist()
        return found

    def windows(self, begins_ns: list[int]) -> list[Window]:
        """Windows of the disturbances that began at these instants of the host's clock, which also
        stamps live poses."""
        assert self.trajectory.stamps_ns is not None
        numbered = numbers(self.trajectory)
        begins = np.searchsorted(self.trajectory.stamps_ns, [b - IN_WORK_NS for b in begins_ns])
        edges = [*numbered[begins].tolist(), self.sweeps]
        absent = np.array(self.absent())
        return [
            Window(
                (numbered >= first) & (numbered < last),
                absent[(absent >= first) & (absent < last)].tolist(),
            )
            for first, last in itertools.pairwise(edges)
        ]

    def assert_accounts_balance(self) -> None:
        for (stage, instance), status in self.statuses.items():
            for account in status.inputs:
                assert account.balanced(), (stage, instance, account)

    def assert_nothing_dropped(self) -> None:
        """Checks that no stage between driver and pose dropped a sweep."""
        for (stage, _), status in self.statuses.items():
            if stage in ("registration", "odometry", "integration"):
                for account in status.inputs:
                    assert not any(account.dropped.values()), (stage, account)

    def assert_as_good(
        self,
        undisturbed: Trajectory,
        truth: Trajectory,
        poses: NDArray[np.bool_] | NDArray[np.int64],
        aligned_sweeps: int,
    ) -> None:
        """Compares the error of these poses with that of the same sweeps of the undisturbed run."""
        errors = errors_m(self.trajectory, undisturbed, truth, aligned_sweeps)
        reference = errors_m(undisturbed, undisturbed, truth, aligned_sweeps)
        ours, theirs = rmse_m(errors[poses]), rmse_m(reference[numbers(self.trajectory)[poses]])
        assert ours <= WORSE * theirs + FLOOR_M, (ours, theirs)


def gap_of(status: StatusRecord) -> int:
    """Sweeps that a stage reports as missed while it was away, or as dropped since."""
    inputs = [i for i in status.inputs if not i.key.endswith("/correction")]
    dropped = sum(sum(i.dropped.values()) - i.dropped.get("duplicate", 0) for i in inputs)
    return int(status.figures.get("gap_sweeps", 0)) + dropped + sum(i.lost for i in inputs)


def errors_m(
    found: Trajectory, undisturbed: Trajectory, truth: Trajectory, aligned_sweeps: int
) -> NDArray[np.float64]:
    """Position errors, aligned with the truth by the first sweeps only, so that a frame that moves
    later counts as an error. The undisturbed replay tells to which instant of the truth a sweep's
    pose belongs. NaN beyond the end of the truth."""
    assert undisturbed.stamps_ns is not None
    sweeps = numbers(found)
    wanted, inside = interpolate(truth, undisturbed.stamps_ns[sweeps])
    first = sweeps[inside] < aligned_sweeps
    positions = found.positions[inside]
    rotation, shift, _ = umeyama_alignment(positions[first].T, wanted.positions[first].T)
    errors = np.full(len(found), np.nan)
    moved = positions @ rotation.T + shift
    errors[inside] = np.linalg.norm(moved - wanted.positions, axis=1)
    return errors


def rmse_m(errors: NDArray[np.float64]) -> float:
    """Root mean square of the errors that are not NaN."""
    return float(np.sqrt(np.nanmean(errors**2)))
