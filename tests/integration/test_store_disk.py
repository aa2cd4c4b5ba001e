"""A store says what its folder lacks, in its health and by its exit code: what a full disk did not
take, and what mapping did not send. It deletes no map of a live run."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh

from tests.integration.conftest import PATIENCE_S, Capture, simulate
from tests.integration.live_run import SECONDS, SPARE_S, LiveRun
from tests.integration.store_records import append_unknown
from zloam_monitor import compose, messages
from zloam_monitor.chain import binary
from zloam_monitor.keys import Keys
from zloam_monitor.link import open_session
from zloam_monitor.processes import free_port

#: the map of some seconds is larger
SIZE = "200k"
IO_CODE = 3


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    seconds = str(SECONDS + SPARE_S)
    return simulate(build, folder, "--world", "city", "--seed", "4", "--duration", seconds)


def test_what_does_not_fit_on_the_disk_is_told_until_the_end(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-m", "true"]).returncode:
        pytest.skip("needs the right to mount in a name space of its own")
    run = LiveRun(build, robot_file, drive, tmp_path)
    tiles = tmp_path / "tiles"
    tiles.mkdir()
    mount = f'mount -t tmpfs -o size={SIZE} tmpfs {tiles} && exec "$@"'
    run._store = ["unshare", "-m", "sh", "-c", mount, "sh", *run._store]

    def says_so() -> bool:
        store = run.chain.link.stage("store")
        return store is not None and f"messages of the map are not in {tiles}" in store.reason

    with run:
        run._until(says_so)
        poses = len(run.poses)
        run.until_poses(poses + 5)
        codes = run.chain.stop()
    assert codes.pop("store") == IO_CODE
    assert set(codes.values()) == {0}, codes
    assert f"are not in {tiles}" in (tmp_path / "store.log").read_text()


class Mapping:
    """Stands in for a mapping that has no time for those who ask for its tiles."""

    def __init__(
        self,
        port: int,
        *,
        replay: bool = False,
        end_of_run: bool = False,
        map_id: int = 0,
        place: int = 0,
    ) -> None:
        self.session, keys = open_session([], f"tcp/127.0.0.1:{port}"), Keys("robot")
        now_ns = time.time_ns()
        values = compose.HeaderValues(
            now_ns,
            0,
            0,
            stamp_ns=now_ns,
            frame="map",
            instance="mapping-1",
            map_id=map_id,
            end_of_run=end_of_run,
            replay=replay,
        )
        points = np.zeros(3, messages.MAP_POINT)
        self.tile = compose.tile(values, "plane", (place, 0, 0), points)
        self.tile_key = keys.below(f"map/tile/plane/{place}/0/0")
        self.pose = compose.pose("MapPose", values, now_ns, (0, 0, 0), (0, 0, 0, 1))
        self.key, self.asked = keys.map_odometry, 0
        self._kept = [
            self.session.declare_queryable(self.key, self._answer),
            self.session.declare_queryable(keys.below("map/tile/**"), self._refuse),
        ]

    def _answer(self, query: zenoh.Query) -> None:
        query.reply(self.key, self.pose, encoding=messages.encoding("MapPose"))

    def _refuse(self, query: zenoh.Query) -> None:
        query.reply_err(b"too many questions wait already")
        self.asked += 1

    def publish(self) -> None:
        self.session.put(self.key, self.pose, encoding=messages.encoding("MapPose"))

    def publish_tile(self) -> None:
        self.session.put(self.tile_key, self.tile, encoding=messages.encoding("MapTile"))

    def stored(self) -> set[bytes]:
        """The tile and the pose that a store answers with."""
        remote = zenoh.Locality.REMOTE  # not itself
        return {
            r.ok.payload.to_bytes()
            for key in (self.tile_key, self.key)
            for r in self.session.get(key, timeout=5.0, allowed_destination=remote)
            if r.ok is not None
        }


@contextlib.contextmanager
def store_on(
    build: Path, tiles: Path, port: int, robot: str = "robot"
) -> Iterator[subprocess.Popen[str]]:
    """A store that connects to this port."""
    settings = (
        "zenoh.base_port=0",
        f"zenoh.connect=[tcp/127.0.0.1:{port}]",
        f"store.path={tiles}",
        f"robot={robot}",
    )
    command = [str(binary(build, "store")), *(w for s in settings for w in ("--set", s))]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as store:
        try:
            yield store
        finally:
            store.terminate()


def until_stored(mapping: Mapping) -> None:
    deadline = time.monotonic() + PATIENCE_S
    # A replay's pose is stored only in a map of which a tile is there.
    for message, publish in (
        (mapping.tile, mapping.publish_tile),
        (mapping.pose, mapping.publish),
    ):
        while message not in mapping.stored() and time.monotonic() < deadline:
            publish()
            time.sleep(0.1)
        assert message in mapping.stored()


def map_in(
    build: Path, tiles: Path, *, replay: bool = False, map_id: int = 0, place: int = 0
) -> bytes:
    """Lets a store take a map of one tile into this folder; returns the tile."""
    port = free_port()
    mapping = Mapping(port, replay=replay, map_id=map_id, place=place)
    try:
        with store_on(build, tiles, port) as store:
            until_stored(mapping)
            store.terminate()
            assert store.wait(PATIENCE_S) == 0
    finally:
        mapping.session.close()
    return mapping.tile


def kept_in(build: Path, tiles: Path) -> set[bytes]:
    """What a store on this folder answers with."""
    port = free_port()
    asks = open_session([], f"tcp/127.0.0.1:{port}")
    found: set[bytes] = set()
    try:
        with store_on(build, tiles, port):
            deadline = time.monotonic() + PATIENCE_S
            while not found and time.monotonic() < deadline:
                replies = asks.get(Keys("robot").tiles, timeout=5.0)
                found = {r.ok.payload.to_bytes() for r in replies if r.ok is not None}
    finally:
        asks.close()
    return found


def test_the_map_of_a_live_run_is_kept_when_another_begins(build: Path, tmp_path: Path) -> None:
    tiles = tmp_path / "tiles"
    monday, tuesday = map_in(build, tiles), map_in(build, tiles)
    # A replay can be repeated, so its map is replaced.
    map_in(build, tiles, replay=True)
    again = map_in(build, tiles, replay=True)
    assert sorted(p.name for p in tiles.iterdir() if p.is_dir()) == ["earlier-1", "earlier-2"]
    assert kept_in(build, tiles / "earlier-1") == {monday}
    assert kept_in(build, tiles / "earlier-2") == {tuesday}
    assert kept_in(build, tiles) == {again}


def test_the_newest_three_maps_of_live_runs_are_kept(build: Path, tmp_path: Path) -> None:
    tiles = tmp_path / "tiles"
    maps = [map_in(build, tiles) for _ in range(5)]
    kept = sorted(p.name for p in tiles.iterdir() if p.is_dir())
    assert kept == ["earlier-2", "earlier-3", "earlier-4"]
    assert kept_in(build, tiles / "earlier-2") == {maps[1]}
    assert kept_in(build, tiles) == {maps[4]}


def test_the_map_of_a_live_run_that_a_replay_extended_is_kept(build: Path, tmp_path: Path) -> None:
    tiles, monday = tmp_path / "tiles", time.time_ns()
    live = map_in(build, tiles, map_id=monday)
    extension = map_in(build, tiles, map_id=monday, replay=True, place=1)
    assert kept_in(build, tiles) == {live, extension}
    map_in(build, tiles)
    assert kept_in(build, tiles / "earlier-1") == {live, extension}


def test_a_map_that_cant_be_read_is_replaced_by_the_next_one(build: Path, tmp_path: Path) -> None:
    tiles = tmp_path / "tiles"
    monday = map_in(build, tiles)
    port = free_port()
    mapping = Mapping(port)
    try:
        with store_on(build, tiles, port) as store:
            deadline = time.monotonic() + PATIENCE_S
            while monday not in mapping.stored() and time.monotonic() < deadline:
                time.sleep(0.1)
            (tiles / "00000001.log").unlink()
            until_stored(mapping)
            store.terminate()
            said = store.communicate()[1]
    finally:
        mapping.session.close()
    assert store.returncode == 0, said
    assert f"the files of the map in {tiles}" in said, "the reason why it is not kept"
    assert not [p for p in tiles.iterdir() if p.is_dir()]


def reason_for(build: Path, tiles: Path, awaited: str, robot: str = "robot") -> str:
    """Reason in the status of a store in this folder, once it contains the text."""
    port = free_port()
    asks = open_session([], f"tcp/127.0.0.1:{port}")
    reason = ""
    try:
        with store_on(build, tiles, port, robot=robot):
            deadline = time.monotonic() + PATIENCE_S
            while awaited not in reason and time.monotonic() < deadline:
                replies = asks.get(Keys(robot).below("service/store/*/status"), timeout=5.0)
                payloads = [r.ok.payload.to_bytes() for r in replies if r.ok is not None]
                statuses = [messages.decode("Status", each) for each in payloads]
                reason = " ".join(messages.text(each.Reason()) for each in statuses)
    finally:
        asks.close()
    return reason


def test_the_map_of_another_robot_is_named(build: Path, tmp_path: Path) -> None:
    tiles = tmp_path / "tiles"
    monday = map_in(build, tiles)
    reason = reason_for(build, tiles, "map of robot robot", robot="other")
    assert f"{tiles} holds the map of robot robot, and this is other" in reason
    assert kept_in(build, tiles) == {monday}


def test_records_of_a_later_version_are_told(build: Path, tmp_path: Path) -> None:
    tiles = tmp_path / "tiles"
    monday = map_in(build, tiles)
    append_unknown(tiles)
    reason = reason_for(build, tiles, "unknown format")
    assert f"{tiles} is damaged: records of an unknown format: 1" in reason
    assert kept_in(build, tiles) == {monday}


def test_tiles_that_mapping_did_not_send_are_in_the_exit_code(build: Path, tmp_path: Path) -> None:
    port, tiles = free_port(), tmp_path / "tiles"
    mapping = Mapping(port, end_of_run=True)
    try:
        with store_on(build, tiles, port) as store:
            deadline = time.monotonic() + PATIENCE_S
            # It asks three times.
            while mapping.asked < 3 and time.monotonic() < deadline:
                mapping.publish()
                time.sleep(0.1)
            store.terminate()
            said = store.communicate()[1]
    finally:
        mapping.session.close()
    assert mapping.asked == 3, said
    assert store.returncode == IO_CODE, said
    assert f"the map in {tiles} may lack them" in said
