"""A store says what its folder lacks, in its health and by its exit code: what a full disk did not
take, and what mapping did not send."""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

import pytest
import zenoh

from tests.integration.conftest import Capture, simulate
from tests.integration.live_run import PATIENCE_S, LiveRun
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
    return simulate(build, folder, "--world", "city", "--seed", "4", "--duration", "10")


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
    """Stands in for a mapping that ends a run, and has no time for those who ask for its tiles."""

    def __init__(self, port: int) -> None:
        self.session, keys = open_session([], f"tcp/127.0.0.1:{port}"), Keys("robot")
        now_ns = time.time_ns()
        values = compose.HeaderValues(
            now_ns, 0, 0, stamp_ns=now_ns, frame="map", instance="mapping-1", end_of_run=True
        )
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


def test_tiles_that_mapping_did_not_send_are_in_the_exit_code(build: Path, tmp_path: Path) -> None:
    port, tiles = free_port(), tmp_path / "tiles"
    mapping = Mapping(port)
    settings = ("zenoh.base_port=0", f"zenoh.connect=[tcp/127.0.0.1:{port}]", f"store.path={tiles}")
    command = [str(binary(build, "store")), *(w for s in settings for w in ("--set", s))]
    try:
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as store:
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
