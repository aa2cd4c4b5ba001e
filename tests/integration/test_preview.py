"""The preview beside a replay: a subscriber of its key alone gets the pose and the whole map,
within the rate of a thin link."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.integration.conftest import Capture, kill, monitor, until
from tests.integration.replay_run import chain_of
from tests.integration.test_views import Program
from tests.integration.views import fetched
from zloam_monitor import messages, records
from zloam_monitor.chain import Chain
from zloam_monitor.clouds import Tile
from zloam_monitor.map_copy import MapCopy
from zloam_monitor.preview_map import Index, PreviewMap
from zloam_monitor.stages import PORT_ORDER

#: largest rate, message headers included (services/preview/config.hpp)
MOST_BYTES_PER_S = 50_000
#: longer than the ten seconds within which all blocks are sent
WHOLE_SECONDS = 15.0
#: numbers of mapped sweeps at which the preview is killed, and at which a new map is begun
KILLED_AT, RESET_AT = 15, 35


class Reader:
    """A subscriber of the key `preview` and of no other key."""

    def __init__(self, chain: Chain) -> None:
        self._came: list[bytes] = []
        self._read = 0
        #: (time of publication by the robot's clock, bytes) of each message
        self._sent: list[tuple[int, int]] = []
        self.map = PreviewMap()
        self.sweeps: list[int] = []
        self.sources: list[tuple[str, int, int]] = []
        keys = chain.link.keys
        self._subscriber = chain.link.session.declare_subscriber(
            keys.preview,
            lambda sample: self._came.append(sample.payload.to_bytes()),
        )

    def read(self) -> None:
        while self._read < len(self._came):
            payload = self._came[self._read]
            said = records.preview(payload)
            self._read += 1
            self._sent.append((published_ns(payload), len(payload)))
            self.map.take(said)
            if said.pose is not None:
                self.sweeps.append(said.pose.sweep)
            if said.source not in self.sources:
                self.sources.append(said.source)

    def is_whole(self) -> bool:
        self.read()
        return 0 < self.map.map_blocks == len(self.map.blocks)

    def most_bytes_in_a_second(self) -> int:
        """By the time of publication: messages may arrive here late, and two at once."""
        self.read()
        times_ns = np.array([at_ns for at_ns, _ in self._sent])
        sums = np.concatenate([[0], np.cumsum([count for _, count in self._sent])])
        ends = np.searchsorted(times_ns, times_ns + 10**9)
        return int((sums[ends] - sums[:-1]).max())

    def close(self) -> None:
        self._subscriber.undeclare()


def published_ns(payload: bytes) -> int:
    """Time of publication by the preview's own clock: the last trace point."""
    header = messages.decode("Preview", payload).Header()
    return int(header.Trace(header.TraceLength() - 1).PublishedNs())


def versions(tiles: list[Tile]) -> dict[Any, int]:
    return {(tile.layer, tile.index): tile.version for tile in tiles}


def published_points(chain: Chain) -> NDArray[np.float64]:
    tiles = [t for t in chain.link.query_tiles() if len(t.points)]
    copied = MapCopy(chain.link).update(60.0)
    assert versions(copied) == versions(tiles)
    assert sum(len(t.points) for t in copied) == sum(len(t.points) for t in tiles)
    axes = [[t.points[axis] for axis in "xyz"] for t in tiles]
    return np.concatenate([np.stack(each, axis=-1) for each in axes]).astype(np.float64)


def cells_by_block(shown: PreviewMap, points: NDArray[np.float64]) -> dict[Index, set[Any]]:
    """Block -> cells of the points, in the cell size with which the block is shown."""
    block_of = np.floor(points / shown.block_m).astype(int)
    blocks, of_point = np.unique(block_of, axis=0, return_inverse=True)
    found: dict[Index, set[Any]] = {}
    for number, row in enumerate(blocks):
        index = (int(row[0]), int(row[1]), int(row[2]))
        own = points[of_point.ravel() == number]
        depth = shown.blocks[index][0] if index in shown.blocks else 1
        cells = np.floor(own / (shown.block_m / 2**depth)).astype(int)
        found[index] = set(map(tuple, cells.tolist()))
    return found


def assert_shows(shown: PreviewMap, points: NDArray[np.float64]) -> None:
    """Checks that exactly the cells with at least one published point are shown."""
    wanted = cells_by_block(shown, points)
    assert wanted.keys() == shown.blocks.keys()
    for index, cells in wanted.items():
        assert set(map(tuple, shown.blocks[index][1].tolist())) == cells, index


def shows(shown: PreviewMap, points: NDArray[np.float64]) -> bool:
    wanted = cells_by_block(shown, points)
    return wanted == {i: set(map(tuple, cells.tolist())) for i, (_, cells) in shown.blocks.items()}


def test_it_keeps_up_with_a_drive_and_a_new_map(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    chain = chain_of(
        build, robot_file, capture.pcap, tmp_path, rate="realtime", beside=("preview",)
    )
    reader = Reader(chain)
    with chain:
        until(chain, lambda: len(chain.link.mapped) > KILLED_AT)
        kill(chain, "preview")
        chain.start("preview", "preview-again")
        until(chain, lambda: len(chain.link.mapped) > RESET_AT)
        reader.read()
        before_reset = set(reader.map.blocks)
        reply = chain.link.command("mapping", "reset", {})
        assert reply is not None
        assert reply.ok
        until(chain, chain.finished)
        points = published_points(chain)
        # The map at the end of the run, which is sent after its last change.
        until(chain, lambda: reader.is_whole() and shows(reader.map, points))
        assert_shows(reader.map, points)
        assert before_reset - set(reader.map.blocks), "the first map is not another one"
        late = Reader(chain)
        until(chain, late.is_whole)
        assert_shows(late.map, points)
        last = chain.link.poses[max(chain.link.poses)]
        assert late.sweeps[-1] == last.sweep
        assert reader.most_bytes_in_a_second() <= MOST_BYTES_PER_S
        for each in (reader, late):
            each.close()
        assert all(code == 0 for code in chain.stop().values())
    # Map ids: one for the first map, which the second preview announces with the same id, and one
    # for the map after the reset (0: id not known yet).
    assert len({map_id for _, map_id, _ in reader.sources} - {0}) == 2
    assert len({instance for instance, _, _ in reader.sources}) == 2
    # Poses come several times a second during the drive.
    assert len(set(reader.sweeps)) > 10
    assert reader.sweeps == sorted(reader.sweeps)


def test_nothing_is_done_before_somebody_reads_it(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    chain = chain_of(build, robot_file, capture.pcap, tmp_path, beside=("preview",))
    with chain:
        until(chain, chain.finished)
        preview, mapping = chain.link.stage("preview"), chain.link.stage("mapping")
        assert preview is not None
        assert mapping is not None
        assert preview.published[chain.link.keys.preview] == 0
        assert mapping.published[chain.link.keys.tiles] == 0
        # The preview now queries mapping for the existing map.
        reader = Reader(chain)
        until(chain, reader.is_whole)
        time.sleep(WHOLE_SECONDS)
        reader.read()
        assert_shows(reader.map, published_points(chain))
        assert reader.most_bytes_in_a_second() <= MOST_BYTES_PER_S
        reader.close()
        assert all(code == 0 for code in chain.stop().values())


def shows_in_rerun(endpoint: str, folder: Path) -> None:
    file = folder / "thin.rrd"
    # The blocks of an unchanging map are sent once in ten seconds.
    done = monitor("view", "--thin", "--connect", endpoint, "--save", file, "--seconds", 12)
    assert done.code == 0, done.said
    assert re.search(r"this view took \d+\.\d kB/s", done.said), done.said
    assert "nothing comes" not in done.said
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", file],
        env={**os.environ, "XDG_CONFIG_HOME": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    for entity in ("/map/preview/", "/map/path/", "/map/odom/base_link", "/plots/latency/odometry"):
        assert entity in printed, entity


def test_a_thin_page_shows_it_and_says_what_to_start(
    build: Path, robot_file: Path, capture: Capture, tmp_path: Path
) -> None:
    chain = chain_of(build, robot_file, capture.pcap, tmp_path, beside=("preview",))
    integration = chain.base_port + PORT_ORDER.index("integration")
    endpoint = f"tcp/127.0.0.1:{integration}"
    with chain, contextlib.ExitStack() as left:
        until(chain, chain.finished)
        robot = chain.link.keys.robot
        page = left.enter_context(Program("web", "--thin", "--port", 0, "--connect", endpoint))
        url = page.find(r"(http://127\.0\.0\.1:\d+)/")

        def state() -> Any:
            return fetched(f"{url}/robots/{robot}/state.json")

        until(chain, lambda: state().get("pose") is not None)
        until(chain, lambda: fetched(f"{url}/robots/{robot}/map.json")["cells"] != "")
        found = state()
        assert found["thin"]
        assert found["pose"]["sweep"] == max(chain.link.poses)
        assert 0.0 < found["kb_s"] <= 1e-3 * MOST_BYTES_PER_S
        # The driver of a replay has ended by then.
        health = {stage["name"]: stage["health"] for stage in found["stages"]}
        assert [health[name] for name in ("odometry", "mapping", "integration")] == ["ready"] * 3
        shows_in_rerun(endpoint, tmp_path)
        kill(chain, "preview")

        def is_said(words: str) -> bool:
            return any(words in each["what"] for each in state()["findings"])

        until(chain, lambda: is_said("nothing comes on"))
        assert "zloam preview --config" in state()["findings"][0]["do"]
        chain.start("preview", "preview-again")
        until(chain, lambda: not is_said("nothing comes on"))
        assert is_said("preview was started again")
        # The terminal shows both messages shortly after the page.
        page.find("nothing comes on .*(start on the robot)")
        page.find("^(the preview comes)$")
        code, said = page.end()
        assert code == 0, said
        assert said.rstrip().endswith("the preview comes"), said
        assert all(code == 0 for code in chain.stop().values())
