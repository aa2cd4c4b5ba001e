"""A recording is published again at its own pace, from any point of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zenoh

from fake_session import needs_schemas, revision
from zloam_monitor import compose, messages, records, replayer
from zloam_monitor.failures import Misuse
from zloam_monitor.mcap_file import CHUNK_BYTES, McapFile
from zloam_monitor.recorded_keys import schema_of
from zloam_monitor.recordings.robot_log import Logged, RobotLog
from zloam_monitor.replayer import Options

SECOND_NS = 10**9
ABOUT = {"robot": "r", "sensor": "lidar", "recording": "a", "version": "0.1.0"}
SWEEP, TILE = "loam/r/lidar/lidar/sweep", "loam/r/map/tile"


class Clock:
    """Takes the place of the module time."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_the_time_of_the_search_is_not_made_up_for(
    monkeypatch: pytest.MonkeyPatch, rate: float
) -> None:
    clock = Clock()
    monkeypatch.setattr(replayer, "time", clock)
    sent: list[tuple[int, float]] = []
    stand: Any = SimpleNamespace(
        put=lambda each: sent.append((each.log_ns, clock.now_s)), published=0
    )

    def logged() -> Iterator[Logged]:
        clock.sleep(3.0)
        yield Logged("standing", "", 2 * SECOND_NS, b"")
        clock.sleep(1.0)
        for tenth in range(100, 110):
            yield Logged("a", "", tenth * SECOND_NS // 10, b"")

    begins_ns = 0, 10 * SECOND_NS
    replayer._publish(stand, logged(), Options(Path(), rate), begins_ns, lambda: True)
    assert sent[0] == (2 * SECOND_NS, 1003.0)
    expected = [1004.0 + 0.1 * n / rate for n in range(10)]
    assert [at_s for _, at_s in sent[1:]] == pytest.approx(expected)


def put(file: McapFile, topic: str, at_s: float, payload: bytes) -> None:
    file.put(topic, schema_of(payload[4:8]), round(1e9 * at_s), 0, payload)


def sweep(number: int) -> bytes:
    """More than a chunk of a file, compressed."""
    random = np.random.default_rng(number)
    points = np.frombuffer(random.bytes(2 * CHUNK_BYTES // 24 * 24), messages.POINT)
    return compose.sweep(compose.HeaderValues(1, number, number), points)


def tile(version: int, index: int, map_id: int = 0) -> bytes:
    points = np.zeros(version, messages.MAP_POINT)
    head = compose.HeaderValues(1, 0, 0, map_id=map_id)
    return compose.tile(head, "plane", (index, 0, 0), points)


@pytest.fixture
def log(tmp_path: Path) -> RobotLog:
    """A recording in two parts: a sweep each second, tiles before and after second 3.5."""
    needs_schemas()
    path = tmp_path / "run.mcap"
    first = McapFile(path, {**ABOUT, "part": "1"})
    for n in range(4):
        put(first, SWEEP, n, sweep(n))
        put(first, TILE, n + 0.2, tile(n + 1, 0))
    put(first, TILE, 3.3, tile(9, 1))
    first.close()
    second = McapFile(tmp_path / "run_2.mcap", {**ABOUT, "part": "2"})
    for n in range(4, 8):
        put(second, SWEEP, n, sweep(n))
    put(second, TILE, 7.5, tile(10, 0))
    second.close()
    return RobotLog(path)


def numbers(found: Iterator[Logged]) -> list[tuple[str, int]]:
    """Of each message its topic's last word, and its sweep's or number of points."""
    named = []
    for each in found:
        if each.topic == SWEEP:
            named.append(("sweep", messages.decode("Sweep", each.payload).Header().Sweep()))
        else:
            named.append(("tile", messages.decode("MapTile", each.payload).PointsLength()))
    return named


def from_(log: RobotLog, begin_s: float, end_s: float) -> list[tuple[str, int]]:
    ends_ns = round(begin_s * 1e9), round(end_s * 1e9)
    return numbers(replayer._from(log, *ends_ns, lambda: True))


WANTED = [("tile", 4), ("tile", 9), ("sweep", 4), ("sweep", 5)]


def test_a_part_begins_with_the_newest_tiles_before_it(log: RobotLog) -> None:
    assert from_(log, 3.5, 5.0) == WANTED
    assert from_(log, 6.5, 7.5) == [*WANTED[:2], ("sweep", 7), ("tile", 10)]
    assert log.remarks == []


def test_a_part_after_a_reset_begins_without_the_map_before(tmp_path: Path) -> None:
    """A view ends a map at the first tile of another one: a tile of the old map that came last
    would leave the old one on the screen."""
    needs_schemas()
    file = McapFile(tmp_path / "run.mcap", {**ABOUT, "part": "1"})
    for at_s, points, index, map_id in ((0.0, 1, 0, 7), (1.0, 2, 1, 7), (2.0, 3, 0, 8)):
        put(file, TILE, at_s, tile(points, index, map_id))
    put(file, TILE, 4.0, tile(4, 2, 8))
    file.close()
    log = RobotLog(tmp_path / "run.mcap")
    assert from_(log, 1.5, 1.9) == [("tile", 1), ("tile", 2)]
    assert from_(log, 3.0, 5.0) == [("tile", 3), ("tile", 4)]


def test_what_lies_outside_is_not_read(log: RobotLog, monkeypatch: pytest.MonkeyPatch) -> None:
    from mcap import reader

    read = []
    breakup = reader.breakup_chunk

    def counted(chunk: Any, **options: Any) -> Any:
        read.append(chunk.message_start_time)
        return breakup(chunk, **options)

    monkeypatch.setattr(reader, "breakup_chunk", counted)
    assert from_(log, 5.5, 6.0)[2:] == [("sweep", 6)]
    # Sweeps 4, 5 and 7 lie in chunks without a tile.
    assert not {4 * SECOND_NS, 5 * SECOND_NS, 7 * SECOND_NS} & set(read)


def test_a_recording_without_an_index_gives_the_same(log: RobotLog) -> None:
    for part in log.parts:
        part.write_bytes(part.read_bytes()[:-1])
    assert from_(log, 3.5, 5.0) == WANTED
    assert [remark.split()[0] for remark in log.remarks] == ["run.mcap", "run_2.mcap"]


def test_the_search_ends_when_it_is_told_to(log: RobotLog) -> None:
    asked: list[int] = []

    def goes_on() -> bool:
        asked.append(len(asked))
        return len(asked) < 3

    assert numbers(replayer._from(log, 7 * SECOND_NS, 8 * SECOND_NS, goes_on)) == []
    assert len(asked) == 3


@pytest.mark.parametrize(
    ("begin_s", "end_s"), [(1000.0, None), (2.0, 1.0), (math.inf, None), (2.0, -math.inf)]
)
def test_a_part_that_is_not_there_is_a_wrong_command_line(
    log: RobotLog, begin_s: float, end_s: float | None
) -> None:
    wanted = Options(log.parts[0], begin_s=begin_s, end_s=end_s)
    with pytest.raises(Misuse, match=rf"run\.mcap is 7\.5 s long: nothing lies from {begin_s:g} s"):
        replayer.replay(wanted)


NAN = math.nan


@pytest.mark.parametrize(
    "wrong",
    [Options(Path(), rate=NAN), Options(Path(), begin_s=NAN), Options(Path(), end_s=NAN)],
)
def test_what_is_no_number_is_refused(log: RobotLog, wrong: Options) -> None:
    with pytest.raises(Misuse, match="not nan"):
        replayer.replay(replace(wrong, path=log.parts[0]))


def test_an_end_that_is_never_reached_is_that_of_the_recording(log: RobotLog) -> None:
    extent = log.extent()
    whole = extent.begin_ns, extent.end_ns
    assert replayer._span(extent, Options(Path(), end_s=math.inf)) == whole


def test_what_is_no_tile_is_left_out_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stranger published it on the key of a tile, and the recorder wrote it."""
    needs_schemas()
    file = McapFile(tmp_path / "run.mcap", {**ABOUT, "part": "1"})
    for at_s in (0.0, 1.0):
        put(file, TILE, at_s, tile(1, 0))
        put(file, TILE, at_s + 0.1, b"no tile at all")
    put(file, TILE, 1.2, tile(1, 0)[:40])
    put(file, TILE, 1.3, tile(1, 0))
    file.close()
    keys: list[str] = []
    session = SimpleNamespace(
        put=lambda key, *_, **__: keys.append(key),
        declare_queryable=lambda *_: None,
        close=lambda: None,
    )
    monkeypatch.setattr(replayer, "open_session", lambda *_: session)
    monkeypatch.setattr(replayer.Stand, "_alone", lambda _: None)
    assert replayer.replay(Options(file.path, rate=100.0, begin_s=0.5)) == 1
    assert keys == ["loam/r/map/tile/plane/0/0/0"] * 3
    assert "2 tiles could not be read: they are left out" in capsys.readouterr().out


class Ghost:
    """A replay under another name, of messages that a test gives it."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        needs_schemas()
        McapFile(folder / "run.mcap", {**ABOUT, "part": "1"}).close()
        self.answer: list[Any] = []
        #: Keys of what was published.
        self.published: list[str] = []
        session = SimpleNamespace(
            put=lambda key, *_, **__: self.published.append(key),
            declare_queryable=lambda key, each: self.answer.append((key, each)),
        )
        monkeypatch.setattr(replayer, "open_session", lambda *_: session)
        monkeypatch.setattr(replayer.Stand, "_alone", lambda _: None)
        self.stand = replayer.Stand(RobotLog(folder / "run.mcap"), Options(Path(), robot="ghost"))

    def asked(self, selector: str) -> list[tuple[str, bytes]]:
        found: list[tuple[str, bytes]] = []
        wanted = zenoh.KeyExpr(selector)
        query = SimpleNamespace(key_expr=wanted, reply=lambda *said: found.append(said))
        for key, each in self.answer:
            if wanted.intersects(zenoh.KeyExpr(key)):
                each(query)
        return found


def test_all_changes_are_answered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They have one key, and a stage answers with each of them; parts repeat them."""
    ghost = Ghost(tmp_path, monkeypatch)
    made = [revision("mapping", number, {"mapping.a": number}) for number in (1, 2)]
    for payload in (*made, made[0]):
        topic = "loam/r/config/mapping"
        ghost.stand.put(Logged(topic, "zloam.msg.ConfigRevision", 0, payload))
    assert [said for _, said in ghost.asked(ghost.stand.keys.every_revision)] == made


def mapped(run: int, sweep: int, map_id: int) -> bytes:
    head = compose.HeaderValues(run, sweep, sweep, map_id=map_id)
    return compose.pose("MapPose", head, sweep * 100, (float(sweep), 2.0, 3.0), (0, 0, 0, 1))


def test_the_path_is_answered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As mapping answers with it: of the newest run in the newest map. What was mapped before the
    part that is replayed belongs to it, and is not published."""
    ghost = Ghost(tmp_path, monkeypatch)
    keys, ghost.stand.begin_ns = ghost.stand.keys, 30
    for at_ns, payload in (
        (10, mapped(1, 4, 7)),
        (20, mapped(1, 5, 7)),
        (25, b"no pose at all"),
        (30, mapped(1, 6, 7)),
    ):
        ghost.stand.put(Logged("loam/r/map/odometry", "zloam.msg.MapPose", at_ns, payload))
    assert ghost.published == [keys.map_odometry]
    ((key, said),) = ghost.asked(keys.path_map)
    run, poses = records.path(said)
    assert (key, run, poses["sweep"].tolist()) == (keys.path_map, 1, [4, 5, 6])
    assert poses["instant_ns"].tolist() == [400, 500, 600]
    assert poses["pose"][1].tolist() == ((5.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    for run, map_id in ((1, 8), (2, 8)):
        payload = mapped(run, 9, map_id)
        ghost.stand.put(Logged("loam/r/map/odometry", "zloam.msg.MapPose", 40, payload))
        said_run, poses = records.path(ghost.asked(keys.path_map)[0][1])
        assert (said_run, poses["sweep"].tolist()) == (run, [9])


def test_the_path_from_before_the_recording_is_answered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recorder asked for it after its first messages had come, which it contains. Others came
    before its answer, too, and are later."""
    ghost = Ghost(tmp_path, monkeypatch)
    before = np.zeros(6, messages.STAMPED_POSE)
    before["sweep"] = range(6)
    path = compose.path(compose.HeaderValues(1, 5, 0, map_id=7), before)
    pose, whole = "zloam.msg.MapPose", "zloam.msg.Path"
    for topic, schema, payload in (
        ("map/odometry", pose, mapped(1, 4, 7)),
        ("map/odometry", pose, mapped(1, 6, 7)),
        ("path/map", whole, path),
        ("map/odometry", pose, mapped(1, 7, 7)),
    ):
        ghost.stand.put(Logged(f"loam/r/{topic}", schema, 10, payload))
    ((_, said),) = ghost.asked(ghost.stand.keys.path_map)
    assert records.path(said)[1]["sweep"].tolist() == list(range(8))
    assert set(ghost.published) == {ghost.stand.keys.map_odometry}


def test_a_part_begins_with_all_changes_and_the_path_before_it(tmp_path: Path) -> None:
    needs_schemas()
    file = McapFile(tmp_path / "run.mcap", {**ABOUT, "part": "1"})
    made = [revision("mapping", number, {"mapping.a": number}) for number in (1, 2)]
    for number, payload in enumerate(made):
        put(file, "loam/r/config/mapping", float(number), payload)
    for at_s, topic in ((2.0, "map/odometry"), (2.1, "pose"), (4.0, "pose")):
        put(file, f"loam/r/{topic}", at_s, mapped(1, 1, 7))
    file.close()
    log = RobotLog(file.path)
    found = list(replayer._from(log, 3 * SECOND_NS, 5 * SECOND_NS, lambda: True))
    assert [each.payload for each in found if each.topic.endswith("config/mapping")] == made
    others = [each.topic for each in found if not each.topic.endswith("config/mapping")]
    assert others == ["loam/r/map/odometry", "loam/r/pose"]


def test_queries_for_the_map_are_answered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`zloam web` and `map save` only query it, and other views ask for what came before them."""
    ghost = Ghost(tmp_path, monkeypatch)
    stand, asked = ghost.stand, ghost.asked
    for points, index, map_id in ((1, 0, 7), (2, 1, 7), (3, 0, 7)):
        stand.put(Logged(TILE, "zloam.msg.MapTile", 0, tile(points, index, map_id)))
    keys = [f"loam/ghost/map/tile/plane/{index}/0/0" for index in (0, 1)]
    assert asked(stand.keys.tiles_of("plane")) == [
        (keys[0], tile(3, 0, 7)),
        (keys[1], tile(2, 1, 7)),
    ]
    assert asked(stand.keys.tiles_of("edge")) == []
    stand.put(Logged(TILE, "zloam.msg.MapTile", 0, tile(4, 1, 8)))
    assert asked(stand.keys.tiles) == [(keys[1], tile(4, 1, 8))]


def test_an_instance_that_ended_is_not_alive_any_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else `zloam doctor` finds two instances of a stage that was started again at work."""
    needs_schemas()
    McapFile(tmp_path / "run.mcap", {**ABOUT, "part": "1"}).close()
    alive: list[str] = []

    def declare_token(key: str) -> Any:
        alive.append(key.split("/")[-2])
        return SimpleNamespace(undeclare=lambda: alive.remove(key.split("/")[-2]))

    answer: list[Any] = []
    session = SimpleNamespace(
        put=lambda *_, **__: None,
        declare_queryable=lambda _, each: answer.append(each),
        liveliness=lambda: SimpleNamespace(declare_token=declare_token),
    )
    monkeypatch.setattr(replayer, "open_session", lambda *_: session)
    monkeypatch.setattr(replayer.Stand, "_alone", lambda _: None)
    stand = replayer.Stand(RobotLog(tmp_path / "run.mcap"), Options(Path()))

    def says(instance: str, at_s: float, what: str = "status") -> None:
        topic = f"loam/r/service/mapping/{instance}/{what}"
        payload = compose.config("mapping", {})
        if what == "status":
            payload = compose.status("mapping", 1, 1, None, [], {}, instance=instance)
        kind = "zloam.msg.Status" if what == "status" else "zloam.msg.EffectiveConfig"
        stand.put(Logged(topic, kind, round(1e9 * at_s), payload))

    # The configurations are from before the part that is replayed.
    for name in ("mapping-1", "mapping-2"):
        says(name, 0.0, "config")
    says("mapping-1", 100.0)
    assert alive == ["mapping-1", "mapping-2"]
    for at_s in (104.0, 105.0, 106.0):
        says("mapping-2", at_s)
    assert alive == ["mapping-2"]
    found: list[str] = []
    wanted = zenoh.KeyExpr(stand.keys.below("service/mapping/**"))
    answer[0](SimpleNamespace(key_expr=wanted, reply=lambda key, _: found.append(key)))
    assert {key.split("/")[-2] for key in found} == {"mapping-2"}
    says("mapping-1", 107.0)
    assert alive == ["mapping-2", "mapping-1"]
