"""The chain live on a sensor's packets, for tests that disturb it during the run."""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.acceptance import live
from tests.integration.conftest import PATIENCE_S, Capture, kill
from zloam_monitor import messages, se3
from zloam_monitor.chain import Chain, binary
from zloam_monitor.records import HEALTH, PoseRecord, StatusRecord
from zloam_monitor.robot_file import names
from zloam_monitor.trajectory import Trajectory, from_records, interpolate, read

#: length of the drive that is sent, at least
SECONDS = 9.0
#: A capture is longer by this for tests that wait for sweeps on a busy machine; LiveRun sends it
#: only as long as they wait.
SPARE_S = 10.0
#: The live capture is sent this many times slower than recorded, so that a busy machine drops
#: nothing.
SLOWER = 1.5
#: number of received poses at which stages are killed
KILL_AT = 45
VOXELS_EVERY = 20
BRIDGING, LOST = HEALTH.index("bridging"), HEALTH.index("lost")
#: mapped poses of a run after which it has a map
IN_MAP = 5
#: lines of each log that are shown when a run fails
LAST_LINES = 8
#: Readers have read what a killed publisher had sent after this time, which is shorter than the
#: start of a process.
IN_FLIGHT_S = 0.1
STAGES = ("registration", "odometry", "mapping", "integration")
#: stages of which one instance works and the others stand by
REPLACED = ("odometry", "mapping", "integration")
#: How long mapping waits for the store before it creates a new map; more than its link ever needs,
#: on a busy machine too. Where a store is there, it waits no longer than for the link.
STORE_LINK_S = 30


def written_in(folder: Path) -> Trajectory:
    """The trajectory that integration wrote; sweep n is its n-th pose."""
    written = read(folder / "trajectory.tum")
    return Trajectory(written.transforms, written.stamps_ns, np.arange(len(written)))


def one_quick(values: tuple[str, ...], quick: str) -> list[object]:
    """Parameters of a test: one of them in each run of the tests, all in `make test-full`."""
    slow = pytest.mark.slow
    return [value if value == quick else pytest.param(value, marks=slow) for value in values]


def rmse_m(found: Trajectory, drive: Capture, from_ns: int = 0) -> float:
    """RMSE of the positions from an instant on, in the frame of the map. Nothing is aligned, so a
    frame that has moved counts as an error."""
    assert found.stamps_ns is not None
    truth, inside = interpolate(read(drive.truth_base), found.stamps_ns)
    estimate = found.transforms[inside]
    assert found.sweeps[0] == 0
    wanted = se3.inverse(truth.transforms[0]) @ truth.transforms
    error = np.linalg.norm(wanted[:, :3, 3] - estimate[:, :3, 3], axis=1)
    after = found.stamps_ns[inside] >= from_ns
    assert after.any()
    return float(np.sqrt(np.mean(error[after] ** 2)))


def beside_command(
    build: Path, robot_file: Path, chain: Chain, stage: str, *settings: str
) -> list[str]:
    """Command of a stage beside the chain."""
    own = [f"zenoh.base_port={chain.base_port}", f"zenoh.connect=[{chain._own_endpoint()}]"]
    command = [str(binary(build, stage)), "--config", str(robot_file)]
    return [*command, *(word for setting in (*own, *settings) for word in ("--set", setting))]


def store_command(build: Path, robot_file: Path, chain: Chain, path: Path) -> list[str]:
    return beside_command(build, robot_file, chain, "store", f"store.path={path}")


def link_time(chain: Chain, times_s: dict[tuple[int, int], float]) -> Any:
    """A subscriber that records the arrival time of each pose."""

    def note(sample: Any) -> None:
        header = messages.decode("MapPose", sample.payload.to_bytes()).Header()
        times_s.setdefault((header.Run(), header.Sweep()), time.monotonic())

    return chain.link.session.declare_subscriber(chain.link.keys.pose, note)


class LiveRun:
    """The chain on a sensor's packets; keeps the poses of all runs."""

    def __init__(
        self,
        build: Path,
        robot_file: Path,
        drive: Capture,
        out: Path,
        *,
        store: bool = True,
        slower: float = SLOWER,
        seconds: float = SECONDS,
        change: live.Change = live.as_recorded,
        more: tuple[str, ...] = (),
        programs: Mapping[str, str] | None = None,
    ) -> None:
        """`seconds` of the drive are sent at least, and what follows in the capture until the test
        calls end(): what it waits for needs sweeps, and may come late on a busy machine.
        `programs`: stage -> program that replaces its own."""
        self.out, self.port = out, live.free_udp_port()
        robot = names(robot_file, [])
        settings = [
            "driver.source=udp",
            f"driver.port={self.port}",
            "driver.position_port=0",
            f"integration.output_dir={out}",
            f"mapping.map_path={out / 'map.pcd'}",
            f"mapping.voxels_every={VOXELS_EVERY}",
            f"mapping.store_link_s={STORE_LINK_S if store else 0}",
            *more,
        ]
        where = (build, robot_file, robot.robot, settings, out, robot.sensor)
        self.chain = Chain(*where, programs=programs)
        self._store: list[str] = []
        self._subscribers: list[Any] = []
        if store:
            self._store = store_command(build, robot_file, self.chain, out / "tiles")
        self._seconds = seconds
        #: length of the drive that was sent so far
        self._sent_s = 0.0
        self._ended = threading.Event()
        self._sender = threading.Thread(
            target=live.send,
            args=(drive.pcap, self.port, float("inf"), slower),
            kwargs={"change": self._noting_times(change), "enough": self._ended},
        )
        #: time at which the first packet was sent, by this host's clock
        self._begun: queue.SimpleQueue[float] = queue.SimpleQueue()
        #: (run, sweep) -> pose, in order of arrival
        self.poses: dict[tuple[int, int], PoseRecord] = {}
        self.mapped: dict[tuple[int, int], PoseRecord] = {}
        #: instance -> its sweeps, in order of arrival
        self.odometry_poses: dict[str, list[int]] = {}
        self.odometry_commits: dict[str, list[int]] = {}
        #: arrival time of each pose (run, sweep), by the monotonic clock
        self.pose_times_s: dict[tuple[int, int], float] = {}
        #: newest sweep of the odometry's commits that its readers had kept when it was killed
        self.kept_commit = -1
        #: description of what had arrived, taken before the stages were ended
        self._heard_last = ""

    def __enter__(self) -> LiveRun:
        self.chain.__enter__()
        try:
            self._begin()
        except BaseException:
            self.chain.close()  # What was not entered is not left either.
            raise
        return self

    def _begin(self) -> None:
        if self._store:
            self.chain.processes.start("store", self._store, self.out / "store.log")
            self._until(lambda: self.chain.link.stage("store") is not None)
        self.chain.wait_linked()
        keys = self.chain.link.keys
        self._note(keys.odometry, "Odometry", self.odometry_poses)
        self._note(keys.odometry_features, "OdometryFeatures", self.odometry_commits)
        self._subscribers.append(link_time(self.chain, self.pose_times_s))
        self._sender.start()

    def __exit__(self, *_: object) -> None:
        self.chain.close()
        self._ended.set()
        self._sender.join()

    def _noting_times(self, change: live.Change) -> live.Change:
        begins = iter([True])

        def noted(seconds: float, payload: bytes) -> bytes | None:
            if next(begins, False):
                self._begun.put(time.time() - seconds)
            self._sent_s = seconds
            return change(seconds, payload)

        return noted

    def began_s(self) -> float:
        """Time at which the capture's first packet was sent, by this host's clock; may be called
        only once."""
        return self._begun.get(timeout=PATIENCE_S)

    def reasons(self) -> list[str]:
        """Reason of each stage's newest status."""
        return [status.reason for status in self.chain.link.newest_statuses().values()]

    def _note(self, key: str, table: str, sweeps: dict[str, list[int]]) -> None:
        def note(sample: Any) -> None:
            header = messages.decode(table, sample.payload.to_bytes()).Header()
            sweeps.setdefault(messages.text(header.Instance()), []).append(header.Sweep())

        self._subscribers.append(self.chain.link.session.declare_subscriber(key, note))

    def _poll(self) -> None:
        link = self.chain.link
        link.poll(0.1)
        for kept, found in ((self.poses, link.poses), (self.mapped, link.mapped)):
            for pose in found.values():
                kept.setdefault((pose.run, pose.sweep), pose)
        self.chain.processes.check()

    def longest_pause_s(self, from_s: float) -> float:
        """Longest time between the arrivals of two consecutive poses, the later of which came after
        `from_s`."""
        times = np.array(sorted(self.pose_times_s.values()))
        return float(np.diff(times)[times[1:] > from_s].max(initial=0.0))

    def wait(self, seconds: float) -> None:
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            self._poll()

    def assert_one_trajectory(self, last_sweep: int | None, bridged: int = 0) -> Trajectory:
        """Checks that each sweep has its pose, all in one map and one frame; returns the trajectory
        that integration wrote."""
        assert last_sweep is not None
        assert len({run_id for run_id, _ in self.poses}) == 1
        written = read(self.out / "trajectory.tum")
        assert len(written) == last_sweep + 1, self._heard_last
        said = [pose.health for pose in self.poses.values()]
        assert said.count(LOST) == 0
        assert said.count(BRIDGING) <= bridged
        # No stage began a new map or frame: at 10 Hz a car drives less than 2 m per sweep.
        assert np.linalg.norm(np.diff(written.positions, axis=0), axis=1).max() < 2.0
        return written

    def _health(self, stage: str) -> str:
        status = self.chain.link.stage(stage)
        return status.health if status is not None else ""

    def _until(self, done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            self._poll()
            assert time.monotonic() < deadline, f"it never happened; {self._heard()}"

    def _heard(self) -> str:
        """Describes what arrived here, for the message of a failed assertion."""
        link = self.chain.link
        peers = len(link.session.info.peers_zid())
        lines = [
            f"poses {len(self.poses)}, mapped {len(self.mapped)}, "
            f"odometry {sum(map(len, self.odometry_poses.values()))}, unread {link.garbage}; "
            f"connected to {peers}; sender {self._sender.is_alive()}"
        ]
        lines += [self._said_by(stage) for stage in ("driver", *STAGES)]
        for log in sorted(self.out.rglob("*.log")):
            last = log.read_text(errors="replace").splitlines()[-LAST_LINES:]
            lines += [f"{log.name}: {line}" for line in last]
        return "\n".join(lines)

    def _said_by(self, stage: str) -> str:
        status = self.chain.link.stage(stage)
        if status is None:
            return f"{stage}: silent"
        inputs = [
            f"{i.key} received {i.received}, processed {i.processed}, lost {i.lost}, {i.dropped}"
            for i in status.inputs
        ]
        packets = {name: count for name, count in status.figures.items() if "packets" in name}
        said = f"{stage}: {status.health} ({status.reason}), at sweep {status.last_sweep}"
        return "; ".join([said, *inputs, f"published {status.published}", str(packets)])

    def until_poses(self, count: int) -> None:
        """Waits for this many poses, and until mapping is past the sweep at which it last sent its
        voxels to the store."""
        newest = VOXELS_EVERY * (count // VOXELS_EVERY)
        self._until(lambda: len(self.poses) >= count and len(self.mapped) > newest)

    def until_poses_or_end(self, count: int) -> None:
        """Waits for this many poses, or until the last packet was sent, after which none comes."""
        self._until(lambda: len(self.poses) >= count or not self._sender.is_alive())

    def until_runs(self, count: int) -> None:
        """Waits until this many runs have a map; a part of a sweep, the first one of a live run,
        makes none."""

        def runs() -> int:
            return sum(n >= IN_MAP for n in Counter(run for run, _ in self.mapped).values())

        self._until(lambda: runs() >= count)

    def restart(self, *stages: str, away: int = 0) -> PoseRecord:
        """Kills the stages, starts them again `away` sweeps later, and returns the last pose
        before."""
        last = list(self.poses.values())[-1]
        kill(self.chain, *stages)
        if "odometry" in stages and "mapping" not in stages:
            self.kept_commit = self._newest_kept_commit()
        if away:
            self._until(lambda: self._driver_sweep() >= last.sweep + away)
        for stage in stages:
            self.chain.start(stage, f"{stage}-again")
        return last

    def _newest_kept_commit(self) -> int:
        """Newest commit of a dead odometry, as its readers kept it. What arrived here does not
        tell: each reader has its own connection, and when the publisher dies, one may lack what
        another has received."""
        time.sleep(IN_FLIGHT_S)
        link = self.chain.link
        kept = link.get(f"{link.keys.odometry_features}?kept=1")
        headers = [messages.decode("OdometryFeatures", each).Header() for each in kept]
        return int(max(header.Sweep() for header in headers))

    def _driver_sweep(self) -> int:
        status = self.chain.link.stage("driver")
        return -1 if status is None or status.last_sweep is None else status.last_sweep

    def killed(self, *stages: str, away: int = 0) -> tuple[PoseRecord, dict[str, StatusRecord]]:
        """A whole run in which the stages are killed once; returns the last pose before the kill
        and the final statuses."""
        with self:
            self.until_poses(KILL_AT)
            before = set(self.chain.link.statuses)
            last = self.restart(*stages, away=away)
            self._until(lambda: all(self._has_begun(stage, before) for stage in stages))
            # On a busy machine enough of the drive may have been sent before the first pose.
            self._until(lambda: self._has_pose_after(last) or not self._sender.is_alive())
            return last, self.end()

    def _has_pose_after(self, last: PoseRecord) -> bool:
        """Whether a later pose came that does not only bridge a gap."""
        later = (pose for pose in self.poses.values() if pose.instant_ns > last.instant_ns)
        return any(pose.health != BRIDGING for pose in later)

    def _has_begun(self, stage: str, before: set[tuple[str, str]]) -> bool:
        """Whether an instance that is not among those before has processed a sweep."""
        status = self.chain.link.stage(stage)
        if status is None or (stage, status.instance) in before:
            return False
        return status.last_sweep is not None

    def end(self) -> dict[str, StatusRecord]:
        """Waits until enough of the drive was sent, ends the stages, checks that all exit codes are
        0, and returns the final statuses."""
        while self._sender.is_alive() and self._sent_s < self._seconds:
            self._poll()
        self._ended.set()
        ends = time.monotonic() + live.AFTER_SECONDS
        while time.monotonic() < ends:
            self._poll()
        self.chain.link.query_statuses()
        statuses, self._heard_last = self.chain.statuses(), self._heard()
        codes = self.chain.stop()
        assert set(codes.values()) == {0}, codes
        return {**statuses, **self.chain.statuses()}

    def trajectory(self, undisturbed: Path) -> tuple[Trajectory, NDArray[np.int64]]:
        """The poses that were received, at the instants that the capture gives their sweeps,
        without those that only bridge a gap (`bridging`; docs/protocol.md, section 7)."""
        whole = read(undisturbed / "trajectory.tum")
        stamps = whole.stamps_ns
        assert stamps is not None
        first_run = next(iter(self.poses))[0]
        rows = {}
        for count, pose in enumerate(self.poses.values()):
            if pose.health == BRIDGING:
                continue
            own = pose.run == first_run
            sweep = pose.sweep if own else pose.sweep + self._skipped(pose.run, whole)
            rows[count] = (int(stamps[sweep]), pose.translation, pose.quaternion)
        return from_records(rows), stamps

    def _skipped(self, run: int, whole: Trajectory) -> int:
        """Number of the capture's sweeps before a later run's first one. The sweeps of all runs end
        at the same azimuth, but a run's clock is set when its first packet arrives, which may be
        late by more than a sweep: the number with which the poses fit best is taken."""
        assert whole.stamps_ns is not None
        begin = next(iter(self.poses.values())).instant_ns
        poses = [p for p in self.poses.values() if p.run == run]
        at = int(whole.stamps_ns[0]) + poses[0].instant_ns - begin
        near = int(np.argmin(np.abs(whole.stamps_ns - at))) - poses[0].sweep
        off = {
            skip: np.mean(
                [
                    np.linalg.norm(whole.transforms[p.sweep + skip, :3, 3] - p.translation)
                    for p in poses
                    if p.health != BRIDGING
                ]
            )
            for skip in (near - 1, near, near + 1)
        }
        return min(off, key=lambda skip: float(off[skip]))
