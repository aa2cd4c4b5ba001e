"""The chain live on a sensor's packets, for tests that do something to it meanwhile."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.acceptance import live
from tests.integration.conftest import Capture, kill
from zloam_monitor import messages, se3
from zloam_monitor.chain import Chain, binary
from zloam_monitor.records import HEALTH, PoseRecord, StatusRecord
from zloam_monitor.robot_file import names
from zloam_monitor.trajectory import Trajectory, from_records, interpolate, read

SECONDS = 9.0
#: the live capture is sent slower than it was recorded, so that a busy machine is no fault
SLOWER = 1.5
#: killed when so many poses have come
KILL_AT = 45
VOXELS_EVERY = 20
BRIDGING, LOST = HEALTH.index("bridging"), HEALTH.index("lost")
PATIENCE_S = 60.0
#: of each log, where a run did not get where it should
LAST_LINES = 8
#: what a killed publisher has sent is read within; less than a process takes to start
IN_FLIGHT_S = 0.1
STAGES = ("registration", "odometry", "mapping", "integration")
#: those of which one instance works and others stand by
REPLACED = ("odometry", "mapping", "integration")
#: mapping founds no map before the store is there; more than its link ever takes
STORE_LINK_S = 10


def written_in(folder: Path) -> Trajectory:
    """What integration wrote; sweep n is its n-th pose."""
    written = read(folder / "trajectory.tum")
    return Trajectory(written.transforms, written.stamps_ns, np.arange(len(written)))


def one_quick(stages: tuple[str, ...], quick: str) -> list[object]:
    """One of them in each run of the tests, all in `make test-full`."""
    slow = pytest.mark.slow
    return [stage if stage == quick else pytest.param(stage, marks=slow) for stage in stages]


def rmse_m(found: Trajectory, drive: Capture, from_ns: int = 0) -> float:
    """Of the positions from an instant on, in the frame of the map: nothing is aligned, so that a
    frame that has moved is an error."""
    assert found.stamps_ns is not None
    truth, inside = interpolate(read(drive.truth_base), found.stamps_ns)
    estimate = found.transforms[inside]
    assert found.sweeps[0] == 0
    wanted = se3.inverse(truth.transforms[0]) @ truth.transforms
    error = np.linalg.norm(wanted[:, :3, 3] - estimate[:, :3, 3], axis=1)
    after = found.stamps_ns[inside] >= from_ns
    assert after.any()
    return float(np.sqrt(np.mean(error[after] ** 2)))


def store_command(build: Path, robot_file: Path, chain: Chain, path: Path) -> list[str]:
    own = [f"zenoh.base_port={chain.base_port}", f"store.path={path}"]
    own.append(f"zenoh.connect=[{chain._own_endpoint()}]")
    command = [str(binary(build, "store")), "--config", str(robot_file)]
    return [*command, *(word for setting in own for word in ("--set", setting))]


def link_time(chain: Chain, times_s: dict[tuple[int, int], float]) -> Any:
    """A subscriber that notes when each pose came."""

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
    ) -> None:
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
        self.chain = Chain(build, robot_file, robot.robot, settings, out, robot.sensor)
        self._store: list[str] = []
        self._subscribers: list[Any] = []
        if store:
            self._store = store_command(build, robot_file, self.chain, out / "tiles")
        self._ended = threading.Event()
        self._sender = threading.Thread(
            target=live.send,
            args=(drive.pcap, self.port, seconds, slower),
            kwargs={"change": self._noting_the_first(change), "enough": self._ended},
        )
        #: when the first packet was sent, by this host's clock
        self._begun: queue.SimpleQueue[float] = queue.SimpleQueue()
        #: (run, sweep) -> pose, in the order of their coming
        self.poses: dict[tuple[int, int], PoseRecord] = {}
        self.mapped: dict[tuple[int, int], PoseRecord] = {}
        #: instance -> its sweeps, in the order of their coming
        self.odometry_poses: dict[str, list[int]] = {}
        self.odometry_commits: dict[str, list[int]] = {}
        #: when each first came here, by the monotonic clock
        self.pose_times_s: dict[tuple[int, int], float] = {}
        #: the newest of the odometry's commits that its readers kept when a stage was killed
        self.kept_commit = -1
        #: before the stages were ended
        self._heard_last = ""

    def __enter__(self) -> LiveRun:
        self.chain.__enter__()
        if self._store:
            self.chain.processes.start("store", self._store, self.out / "store.log")
            self._until(lambda: self.chain.link.stage("store") is not None)
        self.chain.wait_linked()
        keys = self.chain.link.keys
        self._note(keys.odometry, "Odometry", self.odometry_poses)
        self._note(keys.odometry_features, "OdometryFeatures", self.odometry_commits)
        self._subscribers.append(link_time(self.chain, self.pose_times_s))
        self._sender.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.chain.close()
        self._ended.set()
        self._sender.join()

    def _noting_the_first(self, change: live.Change) -> live.Change:
        begins = iter([True])

        def noted(seconds: float, payload: bytes) -> bytes | None:
            if next(begins, False):
                self._begun.put(time.time() - seconds)
            return change(seconds, payload)

        return noted

    def began_s(self) -> float:
        """When the capture's first packet was sent, by this host's clock; asked once."""
        return self._begun.get(timeout=PATIENCE_S)

    def reasons(self) -> list[str]:
        """What the stages say is wrong, each newest status."""
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
        """Between two poses, the later one after that, as they came here."""
        times = np.array(sorted(self.pose_times_s.values()))
        return float(np.diff(times)[times[1:] > from_s].max(initial=0.0))

    def wait(self, seconds: float) -> None:
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            self._poll()

    def assert_one_trajectory(self, last_sweep: int | None, bridged: int = 0) -> Trajectory:
        """Each sweep has its pose, in one map and one frame; what integration wrote."""
        assert last_sweep is not None
        assert len({run_id for run_id, _ in self.poses}) == 1
        written = read(self.out / "trajectory.tum")
        assert len(written) == last_sweep + 1, self._heard_last
        said = [pose.health for pose in self.poses.values()]
        assert said.count(LOST) == 0
        assert said.count(BRIDGING) <= bridged
        # nobody began a map or a frame of its own: at 10 Hz a car goes less than that in a sweep
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
        """What came here, for whoever looks why something did not."""
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
        """And until mapping is past the sweep at which it last gave its voxels to the store."""
        newest = VOXELS_EVERY * (count // VOXELS_EVERY)
        self._until(lambda: len(self.poses) >= count and len(self.mapped) > newest)

    def restart(self, *stages: str, away: int = 0) -> PoseRecord:
        """Kills and starts again, so many sweeps later; the last pose before."""
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
        """Of a dead odometry. Not what came here: each reader has its own connection, and what is
        on one when the publisher dies need not be on another."""
        time.sleep(IN_FLIGHT_S)
        link = self.chain.link
        kept = link.get(f"{link.keys.odometry_features}?kept=1")
        headers = [messages.decode("OdometryFeatures", each).Header() for each in kept]
        return int(max(header.Sweep() for header in headers))

    def _driver_sweep(self) -> int:
        status = self.chain.link.stage("driver")
        return -1 if status is None or status.last_sweep is None else status.last_sweep

    def killed(self, *stages: str, away: int = 0) -> tuple[PoseRecord, dict[str, StatusRecord]]:
        """Once in a whole run: the last pose before, and what the stages say at the end."""
        with self:
            self.until_poses(KILL_AT)
            last = self.restart(*stages, away=away)
            return last, self.end()

    def end(self) -> dict[str, StatusRecord]:
        """After the last packet: statuses, and exit codes that are all 0."""
        while self._sender.is_alive():
            self._poll()
        ends = time.monotonic() + live.AFTER_SECONDS
        while time.monotonic() < ends:
            self._poll()
        self.chain.link.query_statuses()
        statuses, self._heard_last = self.chain.statuses(), self._heard()
        codes = self.chain.stop()
        assert set(codes.values()) == {0}, codes
        return {**statuses, **self.chain.statuses()}

    def trajectory(self, undisturbed: Path) -> tuple[Trajectory, NDArray[np.int64]]:
        """Of the poses, at the instants that the capture gives the sweeps. Without those that say
        of themselves that they only bridge a gap (`bridging`; docs/protocol.md, section 7)."""
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
        """How many of the capture's sweeps came before a later run's first. Sweeps of all runs end
        at the same turn of the sensor, but a run's clock is set as its first packet comes, which
        may be late by more than a sweep: the number at which the poses lie best."""
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
