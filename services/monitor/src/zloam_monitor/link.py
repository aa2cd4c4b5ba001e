"""A third party's link to one robot: subscribes to public keys, sends queries, keeps the results.

Zenoh's callbacks only queue a sample; poll() reads it on the caller's thread.
"""

from __future__ import annotations

import json
import math
import queue
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import zenoh
from numpy.typing import NDArray

from zloam_monitor import records
from zloam_monitor.clouds import POINT_LAYERS, Tile
from zloam_monitor.failures import Explained
from zloam_monitor.kept_poses import KeptPoses
from zloam_monitor.keys import Keys
from zloam_monitor.messages import DECODE_ERRORS
from zloam_monitor.preview_map import PreviewMap
from zloam_monitor.records import PoseRecord, ReplyRecord, RevisionRecord, StatusRecord
from zloam_monitor.stages import STAGES
from zloam_monitor.tokens import Claim, claim_of
from zloam_monitor.traffic import Lateness, Published, Rate, Taken
from zloam_monitor.trajectory import Trajectory, from_records

QUERY_SECONDS = 5.0
#: For all answers of tiles to one query.
TILES_SECONDS = 20.0
#: For the answer with the path of a long run.
PATH_SECONDS = 20.0
#: Time that a new link needs to come up; after that, an instance answers at once ...
PATIENCE_SECONDS = 2.0
#: ... unless its host is busy: an instance with a liveliness token is asked again for this long.
BUSY_SECONDS = 15.0
#: Reason in the status of a standby, which takes over when the working instance ends
#: (recovery.standby).
STANDING_BY = "standing by"
#: An instance that was silent for this long is forgotten when another one of its stage comes.
FORGOTTEN_SECONDS = 600.0
#: Limit on instances whose statuses are kept; more are a stranger's. Those heard last stay: a stage
#: publishes each second.
MOST_INSTANCES = 256
#: An answer overtakes the first status that is published if that one is older by less than this.
#: Statuses are published once a second.
OVERTAKEN_NS = 2 * 10**9
T = TypeVar("T")


class LinkError(Explained):
    """Zenoh could not open the session."""


@contextmanager
def _said() -> Iterator[None]:
    try:
        yield
    except zenoh.ZError as error:
        raise LinkError(f"no link to the stages: {error}") from error


def _opened(config: Any) -> Any:
    """Opens a session, without shared memory if there is no room for it: all messages then come
    over sockets."""
    try:
        return zenoh.open(config)
    except zenoh.ZError:
        config.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(config)


def _identifier(initiative: int) -> str:
    """A random Zenoh identifier ending with `initiative`. Of two peers the one with the greater
    identifier connects, so that never both do; Zenoh compares identifiers from their last two
    digits on (services/common/runtime/session_config.hpp)."""
    return f"{secrets.randbits(112) | 1 << 112:x}{initiative:02x}"


@_said()
def open_session(
    endpoints: list[str], listen: str = "tcp/127.0.0.1:0", shared_memory: bool = True
) -> Any:
    """Opens a peer that connects to these endpoints, retrying without end, and to the peers that
    they announce. Without endpoints it waits for others to connect. No multicast.

    Without shared memory nothing of a replay is lost, as its publishers then wait for this process:
    they can't know whether a shared message was read, and overwrite it when they need room."""
    config = zenoh.Config()
    if not shared_memory:
        config.insert_json5("transport/shared_memory/enabled", "false")
    config.insert_json5("id", json.dumps(_identifier(255 if endpoints else 0)))
    config.insert_json5("mode", '"peer"')
    config.insert_json5(
        "scouting/gossip/autoconnect_strategy",
        '{peer: {to_router: "always", to_peer: "greater-zid"}}',
    )
    config.insert_json5("connect/endpoints", json.dumps(endpoints))
    config.insert_json5("connect/timeout_ms", "-1")
    config.insert_json5("connect/exit_on_failure", "false")
    config.insert_json5("connect/retry", "{period_init_ms: 100, period_max_ms: 500}")
    config.insert_json5("listen/endpoints", json.dumps([listen]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return _opened(config)


@_said()
def open_client(endpoints: list[str]) -> Any:
    """Opens a client of a router, for programs outside the robot."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps(endpoints))
    config.insert_json5("scouting/multicast/enabled", "false")
    return _opened(config)


class Link:
    """Keeps the poses and statuses of one robot."""

    def __init__(
        self, session: Any, keys: Keys, newest: int | None = None, thin: bool = False
    ) -> None:
        """Keeps the `newest` poses of each kind; None: all of a run; 0: subscribes to nothing and
        only sends queries. `thin`: subscribes to the preview and statuses alone."""
        self.session = session
        self.keys = keys
        self.thin = thin
        #: Map from the previews, on a thin link.
        self.preview = PreviewMap()
        #: Monotonic time at which the newest preview came; before the first, of the construction.
        self.preview_s = time.monotonic()
        #: Traffic: what one subscriber of each key costs the robot, and what this link receives.
        self.published = Published()
        self.taken = Taken()
        #: Fused poses that come here.
        self.posed = Rate()
        #: How much later than at first statuses arrive here.
        self.late = Lateness()
        self.poses = KeptPoses(newest)
        self.odometry = KeptPoses(newest, _without_errors)
        self.mapped = KeptPoses(newest, _of_mapping)
        self.statuses: dict[tuple[str, str], StatusRecord] = {}
        #: (stage, instance) -> when its newest status came, by this host's monotonic clock,
        #: because the robot's clock may be set differently.
        self.heard: dict[tuple[str, str], float] = {}
        #: The same for its newest status that was published, and the stamp of that one in ns;
        #: answers to queries don't count.
        self._published: dict[tuple[str, str], tuple[float, int]] = {}
        #: Its greatest stamp so far, in ns.
        self._greatest_ns: dict[tuple[str, str], int] = {}
        #: Number of messages that could not be read.
        self.garbage = 0
        self.run: int | None = None
        #: Odometry and mapped poses of a run of which no fused pose has come yet.
        self._ahead: deque[tuple[KeptPoses, PoseRecord]] = deque(maxlen=64)
        #: Result of the last query_revisions().
        self.revisions: list[RevisionRecord] = []
        #: Living stages that did not answer the last query_configs().
        self.unanswered: set[str] = set()
        self._incoming: queue.SimpleQueue[tuple[Callable[[bytes], None], bytes, float]] = (
            queue.SimpleQueue()
        )
        #: Monotonic time at which the message that poll() reads came.
        self._came_s = 0.0
        self._subscribers = [] if newest == 0 else self._all_subscribed()

    def _all_subscribed(self) -> list[Any]:
        keys = self.keys
        if self.thin:
            return [
                self._subscribe(keys.preview, self._on_preview),
                self._subscribe(keys.every_status, self._on_status),
            ]
        return [
            self._subscribe(keys.pose, self._on_pose),
            self._subscribe(keys.odometry, self._on_odometry),
            self._subscribe(keys.map_odometry, self._on_mapped),
            self._subscribe(keys.every_status, self._on_status),
        ]

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()
        self._subscribers.clear()

    def _subscribe(self, key: str, read: Callable[[bytes], None]) -> Any:
        def hand_over(sample: Any) -> None:
            self._incoming.put((read, sample.payload.to_bytes(), time.monotonic()))

        return self.session.declare_subscriber(key, hand_over)

    def poll(self, seconds: float = 0.0) -> None:
        """Reads all received messages, waiting up to `seconds` for the first."""
        deadline = time.monotonic() + seconds
        while True:
            wait = deadline - time.monotonic()
            try:
                read, payload, self._came_s = (
                    self._incoming.get(timeout=wait) if wait > 0 else (self._incoming.get_nowait())
                )
            except queue.Empty:
                return
            deadline = 0.0
            self.taken.take(len(payload), self._came_s)
            try:
                read(payload)
            except DECODE_ERRORS:
                self.garbage += 1

    def _new_run(self, run: int) -> None:
        """On the first pose of another run: forgets the poses of the run before."""
        if run != self.run:
            self.run = run
            for kept in (self.poses, self.odometry, self.mapped):
                kept.clear()
            for kept, pose in self._ahead:
                if pose.run == run:
                    self._add(kept, pose)
            self._ahead.clear()

    def _add(self, kept: KeptPoses, pose: PoseRecord) -> None:
        if kept.add(pose) and kept is self.poses:
            self.posed.take(1, self._came_s)

    def _keep(self, kept: KeptPoses, pose: PoseRecord) -> None:
        """Only fused poses begin a new run, because stages refuse messages of other runs."""
        if self.run is None:
            self._new_run(pose.run)
        if pose.run == self.run:
            self._add(kept, pose)
        else:
            self._ahead.append((kept, pose))

    def _on_pose(self, payload: bytes) -> None:
        pose = records.map_pose(payload)
        self._new_run(pose.run)
        self._add(self.poses, pose)

    def _on_preview(self, payload: bytes) -> None:
        said = records.preview(payload)
        self.preview_s = time.monotonic()
        self.preview.take(said)
        if said.pose is not None:
            self._new_run(said.pose.run)
            self._add(self.poses, said.pose)

    def _on_odometry(self, payload: bytes) -> None:
        self._keep(self.odometry, records.odometry(payload))

    def _on_mapped(self, payload: bytes) -> None:
        self._keep(self.mapped, records.map_pose(payload))

    def _on_status(self, payload: bytes) -> None:
        self._take_published(records.status(payload), self._came_s)

    def _take_published(self, status: StatusRecord, came_s: float) -> None:
        """What is published is new even if its stamp is less than that of an answer: the robot's
        clock may have been set back. It is old only if an answer came here while it waited, or
        overtook it on the way, which answers can, as their priority is greater: then the stamps
        of what is published have not gone back."""
        who = (status.stage, status.instance)
        kept_ns = self.statuses[who].stamp_ns if who in self.statuses else status.stamp_ns
        _, before_ns = self._published.get(who, (0.0, kept_ns - OVERTAKEN_NS))
        self._published[who] = came_s, status.stamp_ns
        overtaken = before_ns < status.stamp_ns < kept_ns
        if came_s >= self.heard.get(who, came_s) and not overtaken:
            self._keep_status(status, came_s)

    def _take_answer(self, status: StatusRecord) -> None:
        """An answer may be an old status that a router keeps: it says nothing of the instance now.
        Only a stamp that was not reached before is new for certain."""
        if status.stamp_ns > self._greatest_ns.get((status.stage, status.instance), -1):
            self._keep_status(status, time.monotonic())

    def _keep_status(self, status: StatusRecord, came_s: float) -> None:
        who = (status.stage, status.instance)
        if who not in self.statuses:
            self._forget_ended(status.stage, came_s)
        self._greatest_ns[who] = max(status.stamp_ns, self._greatest_ns.get(who, 0))
        self.statuses[who] = status
        self.heard[who] = came_s
        self.late.take(status, round(1e9 * came_s))
        self.published.take(status)

    def _forget_ended(self, stage: str, now_s: float) -> None:
        """At the first status of another instance: forgets those that ended long ago, because each
        start of a stage has a name of its own."""
        for who in [each for each in self.statuses if each[0] == stage]:
            if now_s - self.heard[who] > FORGOTTEN_SECONDS:
                self._forget(who)
        if len(self.statuses) >= MOST_INSTANCES:
            self._forget(min(self.heard, key=lambda who: self.heard[who]))

    def _forget(self, who: tuple[str, str]) -> None:
        for kept in (self.statuses, self.heard, self._published, self._greatest_ns):
            kept.pop(who, None)
        self.late.forget(who)
        self.published.forget(who)

    def stage(self, stage: str) -> StatusRecord | None:
        """The newest status of a stage; that of a standby only if no other instance was heard. An
        instance that published later is newer, as the robot's clock may have been set back; stamps
        decide between those that only answered."""

        def age(status: StatusRecord) -> tuple[bool, float, int]:
            who = (status.stage, status.instance)
            published_s, _ = self._published.get(who, (-math.inf, 0))
            return status.reason != STANDING_BY, published_s, status.stamp_ns

        found = [s for (name, _), s in self.statuses.items() if name == stage]
        return max(found, key=age, default=None)

    def silent_s(self, status: StatusRecord, now: float) -> float:
        """Seconds since the status came; now: monotonic clock."""
        return max(0.0, now - self.heard_s(status))

    def heard_s(self, status: StatusRecord) -> float:
        """Time at which the status came, by the monotonic clock."""
        return self.heard[(status.stage, status.instance)]

    def newest_statuses(self) -> dict[str, StatusRecord]:
        """The newest status of each stage of the chain that was heard."""
        return {s: status for s in STAGES if (status := self.stage(s)) is not None}

    def get(
        self,
        selector: str,
        seconds: float = QUERY_SECONDS,
        payload: bytes | None = None,
        gently: bool = False,
    ) -> Iterator[bytes]:
        """Payloads of all answers to a query that are not errors. `gently`: below all other
        traffic, and dropped before a slow link."""
        for reply in self.replies(selector, seconds, payload, gently):
            if reply.ok is not None:
                answer = reply.ok.payload.to_bytes()
                self.taken.take(len(answer), time.monotonic())
                yield answer

    def replies(
        self,
        selector: str,
        seconds: float = QUERY_SECONDS,
        payload: bytes | None = None,
        gently: bool = False,
    ) -> Any:
        """All answers to a query, errors included; they have the query's priority."""
        return self.session.get(
            selector,
            payload=payload,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=seconds,
            congestion_control=zenoh.CongestionControl.DROP if gently else None,
            priority=zenoh.Priority.DATA_LOW if gently else None,
        )

    def _decoded(self, read: Callable[[bytes], T], payloads: Iterable[bytes]) -> Iterator[T]:
        """The messages that can be read; the others are counted, as poll() does."""
        for payload in payloads:
            try:
                value = read(payload)
            except DECODE_ERRORS:
                self.garbage += 1
                continue
            yield value

    def query_statuses(self) -> None:
        """Asks all stages for their status now."""
        for status in self.answering():
            self._take_answer(status)

    def living_instances(self) -> set[tuple[str, str]]:
        """(stage, instance) of all liveliness tokens."""
        replies = self.session.liveliness().get(self.keys.every_alive, timeout=QUERY_SECONDS)
        parts = [str(reply.ok.key_expr).split("/") for reply in replies if reply.ok is not None]
        return {(part[-3], part[-2]) for part in parts}

    def claims(self) -> set[Claim]:
        """The tokens by which instances say that they work or could work."""
        replies = self.session.liveliness().get(self.keys.every_active, timeout=QUERY_SECONDS)
        found = (claim_of(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None)
        return {claim for claim in found if claim is not None}

    def answering(self) -> list[StatusRecord]:
        """The present statuses of all instances, standbys too; also of ended ones that a router
        keeps."""
        return list(self._decoded(records.status, self.get(self.keys.every_status)))

    def living(self) -> set[str]:
        """Stages with a liveliness token."""
        return {stage for stage, _ in self.living_instances()}

    def until_all(self, ask: Callable[[], Iterable[str]]) -> set[str]:
        """Calls `ask`, which returns the stages that answered, until all living ones have: over a
        new link a stage's token may come before its answers. Returns those that have not."""
        deadline = time.monotonic() + BUSY_SECONDS
        answered: set[str] = set()
        while True:
            answered |= set(ask())
            missing = self.living() - answered
            if not missing or time.monotonic() > deadline:
                return missing
            time.sleep(0.1)

    def query_configs(self) -> dict[str, dict[str, Any]]:
        """Stage -> effective configuration, of all living stages but those in `unanswered`."""
        found: dict[str, dict[str, Any]] = {}

        def ask() -> Iterable[str]:
            answers = self.get(self.keys.every_config)
            found.update(self._decoded(records.effective_config, answers))
            return found

        self.unanswered = self.until_all(ask)
        return found

    def query_revisions(self) -> list[RevisionRecord]:
        """All live configuration changes that any stage knows, each once, by stage and number."""
        found = self._decoded(records.config_revision, self.get(self.keys.every_revision))
        self.revisions = [r for _, r in sorted({(r.stage, r.rev): r for r in found}.items())]
        return self.revisions

    def command(self, stage: str, verb: str, arguments: dict[str, Any]) -> ReplyRecord | None:
        """Sends a command to a stage; None: nobody answered."""
        payload = json.dumps(arguments).encode()
        replies = self.get(self.keys.command(stage, verb), payload=payload)
        return next(self._decoded(records.command_reply, replies), None)

    def query_tiles(self, layers: Sequence[str] = POINT_LAYERS) -> list[Tile]:
        """All tiles of these layers of the map; each in its greatest version. While a new map
        begins, the answers may be of two: then those of the greater map_id are last."""
        newest: dict[tuple[int, str, tuple[int, int, int]], Tile] = {}
        for layer in layers:
            answers = self.get(self.keys.tiles_of(layer), seconds=60.0)
            for tile in self._decoded(records.tile, answers):
                which = (tile.map_id, tile.layer, tile.index)
                kept = newest.get(which)
                if kept is None or tile.version > kept.version:
                    newest[which] = tile
        return sorted(newest.values(), key=lambda tile: tile.map_id)

    def tiles_at(self, selector: str) -> list[Tile]:
        """The tiles that answer, below all other traffic; they may be dropped on a slow link."""
        return list(self._decoded(records.tile, self.get(selector, TILES_SECONDS, gently=True)))

    def trajectory(self) -> Trajectory:
        """Fused poses T_map_base that were received."""
        return _heard(self.poses)

    def odometry_trajectory(self) -> Trajectory:
        """Odometry poses T_odom_base that were received."""
        return _heard(self.odometry)

    def query_path(self) -> tuple[int, NDArray[Any]] | None:
        """(run, messages.STAMPED_POSE) of all mapped sweeps, by a query to mapping; None: no
        answer came."""
        return next(self._decoded(records.path, self.get(self.keys.path_map, PATH_SECONDS)), None)


def _without_errors(pose: PoseRecord) -> PoseRecord:
    """Of old odometry only the trajectory is needed."""
    return replace(pose, covariance=(), trace=())


def _of_mapping(pose: PoseRecord) -> PoseRecord:
    """Of old mapped poses only mapping's times are needed; fused poses have those of the others."""
    trace = tuple(step for step in pose.trace if step.stage == "mapping")
    return replace(pose, covariance=(), trace=trace)


def _heard(poses: KeptPoses) -> Trajectory:
    if not poses:
        return Trajectory(np.empty((0, 4, 4)), np.empty(0, np.int64))
    return from_records({n: (p.instant_ns, p.translation, p.quaternion) for n, p in poses.items()})
