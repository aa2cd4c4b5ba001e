"""A recording is in parts that belong together; what is missing in it is told."""

from __future__ import annotations

import importlib
import itertools
import re
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from mcap.reader import make_reader

from fake_session import FakeSession, linked, needs_schemas, one_misses_a_query, revision
from zloam_monitor import (
    compose,
    doctor_files,
    intake,
    link,
    messages,
    recorded_keys,
    recorder,
    records,
)
from zloam_monitor.mcap_file import McapFile, RecordingError
from zloam_monitor.recorder import Options, Recorder
from zloam_monitor.recordings.robot_log import RobotLog
from zloam_monitor.stages import STAGES

MIB = 1 << 20
ABOUT = {"robot": "r", "sensor": "lidar", "version": "0.1.0"}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    needs_schemas()
    monkeypatch.setattr(link, "BUSY_SECONDS", 0.3)


@pytest.fixture
def session() -> FakeSession:
    return one_misses_a_query()


def recording(session: FakeSession, path: Path) -> Recorder:
    return Recorder(linked(session), Options(path, scene=False, split_bytes=MIB))


def published_keys() -> list[str]:
    """Keys of schemas/README.md on which stages publish, `<...>` as `*`; tiles as one."""
    text = (Path(__file__).parents[3] / "schemas" / "README.md").read_text()
    rows = [[cell.strip() for cell in line.split("|")] for line in text.splitlines()]
    table = [row for row in rows if len(row) == 10 and row[1].startswith("`")]
    assert len(table) > 30
    # The others are answered to queries, or are tokens.
    return [re.sub("<[a-z_]+>", "*", row[1].strip("`")) for row in table if row[4] != "-"]


@pytest.mark.parametrize("everything", [False, True])
def test_all_that_is_published_can_be_recorded(
    session: FakeSession, tmp_path: Path, everything: bool
) -> None:
    Recorder(linked(session), Options(tmp_path / "run.mcap", everything)).close()
    read = [zenoh.KeyExpr(each) for each in session.subscribers]
    left_out = {
        key
        for key in published_keys()
        if not any(each.includes(zenoh.KeyExpr(session.keys.below(key))) for each in read)
    }
    # The flow of a replay is between the stages alone.
    derived = set() if everything else set(recorded_keys.DERIVED) - {"odometry/sweep"}
    assert left_out == derived | {"flow/*/ack"}


def contents(path: Path) -> list[tuple[str, bytes]]:
    with path.open("rb") as file:
        return [(c.topic, m.data) for _, c, m in make_reader(file).iter_messages()]


def stages(path: Path) -> list[str]:
    """Stages whose configuration is in the file."""
    topics = (topic.split("/") for topic, _ in contents(path))
    return sorted(t[-3] for t in topics if t[-1] == "config")


def test_each_part_can_be_understood_alone(session: FakeSession, tmp_path: Path) -> None:
    made = recording(session, tmp_path / "run.mcap")
    made.settle()
    sent = []
    for n in range(3):
        sent.append(session.publish_long_pose(n))
        made.poll()
    made.close()
    names = ["run.mcap", "run_2.mcap", "run_3.mcap", "run_4.mcap"]
    assert [p.name for p in made.parts] == names
    poses = [
        data for part in made.parts for topic, data in contents(part) if topic.endswith("/pose")
    ]
    assert poses == sent
    for part in made.parts:
        assert stages(part) == ["mapping", "odometry"]
    log = RobotLog(tmp_path / "run.mcap")
    assert ([p.name for p in log.parts], log.remarks) == (names, [])
    assert len({(RobotLog(p).about or {})["recording"] for p in made.parts}) == 1
    assert made.lacks() == []


def test_a_name_that_is_taken_meanwhile_ends_it_well(session: FakeSession, tmp_path: Path) -> None:
    made = recording(session, tmp_path / "run.mcap")
    (tmp_path / "run_2.mcap").write_text("precious")
    sent = session.publish_long_pose(1)
    with pytest.raises(RecordingError, match=r"run_2\.mcap is there already"):
        made.poll()
    made.close()
    made.close()  # A second time it does nothing.
    assert [data for _, data in contents(tmp_path / "run.mcap")] == [sent]
    assert (tmp_path / "run_2.mcap").read_text() == "precious"


def test_a_part_of_an_earlier_recording_is_refused_at_once(
    session: FakeSession, tmp_path: Path
) -> None:
    for name in ("run_7.mcap", "run_2024-05-01.mcap", "run_02.mcap", "running_2.mcap"):
        (tmp_path / name).touch()
    with pytest.raises(RecordingError, match=r"run_7\.mcap is there already.* another name"):
        recording(session, tmp_path / "run.mcap")
    assert not (tmp_path / "run.mcap").exists()
    (tmp_path / "run_7.mcap").unlink()
    recording(session, tmp_path / "run.mcap").close()


def test_what_can_not_be_created_is_named(session: FakeSession, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match=r"file/run\.mcap can't be created: "):
        recording(session, tmp_path / "file" / "run.mcap")


def test_a_disk_that_is_full_at_the_beginning_is_told(tmp_path: Path) -> None:
    """A limit on the file's size simulates it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, hard))
    try:
        with pytest.raises(RecordingError, match=r"a\.mcap can't be written: File too large"):
            McapFile(tmp_path / "a.mcap", {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not (tmp_path / "a.mcap").exists()


def test_a_configuration_that_is_missing_is_told(
    session: FakeSession,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = Options(tmp_path / "whole.mcap", scene=False)
    assert recorder.record(linked(session), options, 0.0) == 0
    assert stages(options.path) == ["mapping", "odometry"]
    session.rounds[session.config_key("mapping")] = [[]]
    options = Options(tmp_path / "part.mcap", scene=False)
    assert recorder.record(linked(session), options, 0.0) == 1
    assert stages(options.path) == ["odometry"]
    assert "the configuration of mapping/mapping-1 is missing in" in capsys.readouterr().out


def test_messages_that_never_came_are_told(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    ended = Recorder.settle

    def settle(made: Recorder) -> None:
        ended(made)
        for n in (0, 1, 5, 5):
            header = compose.HeaderValues(1, n, n)
            session.publish(
                session.keys.pose, compose.pose("MapPose", header, n, (0, 0, 0), (0, 0, 0, 1))
            )

    monkeypatch.setattr(Recorder, "settle", settle)
    assert recorder.record(linked(session), Options(path, scene=False), 0.0) == 1
    with path.open("rb") as file:
        noted = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    assert noted["zloam.dropped"] == {"loam/robot/pose": "3"}


def test_the_configuration_of_a_stage_that_starts_later_is_in_every_part(
    session: FakeSession, tmp_path: Path
) -> None:
    made = recording(session, tmp_path / "run.mcap")
    made.settle()
    # A sweep before it, as `demo --bag` must not look for configurations only before the first.
    header = compose.HeaderValues(1, 0, 0)
    session.publish(session.keys.sweep, compose.sweep(header, np.zeros(1, messages.POINT)))
    # The first query comes too early for an answer.
    session.rounds[session.config_key("integration")] = [
        [],
        [compose.config("integration", {"integration.e": 3})],
    ]
    for _ in range(3):
        session.publish_status("integration")
        made.poll()
    session.publish_long_pose(1)
    made.poll()
    made.close()
    assert [stages(p) for p in made.parts] == [["integration", "mapping", "odometry"]] * 2
    assert made.lacks() == []
    assert RobotLog(made.parts[0]).settings() == ["integration.e=3"]


def test_of_a_stage_that_starts_again_the_first_configuration_is_replayed(
    session: FakeSession, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    key = session.config_key("mapping")
    session.rounds[key] = [[compose.config("mapping", {"mapping.a": 1})]]
    made = Recorder(linked(session), Options(path, scene=False))
    made.settle()
    again = key.replace("mapping-1", "mapping-2")
    session.rounds[again] = [[compose.config("mapping", {"mapping.a": 2})]]
    session.publish(
        again.replace("/config", "/status"), compose.status("mapping", 1, 1, None, [], {})
    )
    made.poll()
    made.close()
    assert stages(path) == ["mapping", "mapping", "odometry"]
    assert RobotLog(path).settings() == ["mapping.a=1"]


def test_all_changes_from_before_it_are_in_every_part(session: FakeSession, tmp_path: Path) -> None:
    """Each process answers with all revisions of a stage, which have one key."""
    made = [revision("mapping", n, {"mapping.a": n}) for n in (1, 2)]
    session.rounds[session.keys.revision("mapping")] = [made + made[::-1]]
    recorder_ = recording(session, tmp_path / "run.mcap")
    recorder_.settle()
    session.publish(session.keys.revision("mapping"), made[1])
    session.publish_long_pose(1)
    recorder_.poll()
    recorder_.close()
    for part in recorder_.parts:
        assert [data for topic, data in contents(part) if topic.endswith("/config/mapping")] == made
    assert RobotLog(recorder_.parts[0]).changes() == ["0:mapping.a=1", "0:mapping.a=2"]


def test_only_a_stage_that_works_lacks_its_configuration(
    session: FakeSession, tmp_path: Path
) -> None:
    made = recording(session, tmp_path / "run.mcap")
    made.settle()
    session.publish_status("registration", health="starting")  # So does a standby, which has none.
    made.poll()
    assert made.lacks() == []
    session.publish_status("integration")
    made.close()
    (lack,) = made.lacks()
    assert "the configuration of integration/integration-1 is missing in" in lack


def test_an_answer_at_the_last_moment_is_recorded(session: FakeSession, tmp_path: Path) -> None:
    made = recording(session, tmp_path / "run.mcap")
    made.settle()
    session.rounds[session.config_key("integration")] = [[], [compose.config("integration", {})]]
    session.publish_status("integration")
    made.close()
    assert stages(made.parts[0]) == ["integration", "mapping", "odometry"]
    assert made.lacks() == []


def a_tile(i: int, version: int, points: int, map_id: int = 7, seq: int = 0) -> bytes:
    head = compose.HeaderValues(1, 0, seq, map_id=map_id)
    return compose.tile(head, "plane", (i, 0, 0), np.zeros(points, messages.MAP_POINT), version)


def hold(session: FakeSession, i: int, answers: list[list[bytes]]) -> str:
    """A tile that mapping has, and its answers to queries for it; returns its key."""
    key = session.keys.tile("plane", (i, 0, 0))
    session.heads[key] = [a_tile(i, 2, 0)]
    session.rounds[key] = answers
    return key


def tiles_in(path: Path) -> list[tuple[int, int, int]]:
    """Index, version and map of each tile in the file."""
    found = [records.tile(data) for topic, data in contents(path) if topic.endswith("/map/tile")]
    return [(tile.index[0], tile.version, tile.map_id) for tile in found]


def until_asked(made: Recorder) -> None:
    made._map._thread.join(20.0)
    assert not made._map._thread.is_alive()


def test_the_map_from_before_it_is_recorded(session: FakeSession, tmp_path: Path) -> None:
    """Mapping publishes a tile only when it changes. What was dropped is asked for again, and
    numbers of messages from before are no gaps."""
    made = recording(session, tmp_path / "run.mcap")
    for i in range(2):
        dropped: list[list[bytes]] = [[]] * i
        hold(session, i, [*dropped, [a_tile(i, 1, 4), a_tile(i, 2, 5, seq=i), a_tile(i, 9, 6, 3)]])
    made.settle()
    until_asked(made)
    for seq in (5000, 5001):
        session.publish(session.keys.tile("plane", (7, 0, 0)), a_tile(7, seq, 5, seq=seq))
    made.close()
    path = made.parts[0]
    assert tiles_in(path) == [(0, 2, 7), (1, 2, 7), (7, 5000, 7), (7, 5001, 7)]
    assert made.lacks() == []


def test_of_several_answers_the_newest_map_is_recorded(
    session: FakeSession, tmp_path: Path
) -> None:
    """A store has older versions and the map before, and may answer first or last; a mapping
    without heads answers with whole tiles. All tiles of a recording are of one map."""
    made = recording(session, tmp_path / "run.mcap")
    older = [a_tile(0, 1, 4), a_tile(0, 9, 4, map_id=6)]
    whole = [*older, a_tile(0, 2, 5), *older]
    for i, answers in enumerate((whole, [a_tile(1, 3, 4, map_id=6)])):
        key = session.keys.tile("plane", (i, 0, 0))
        session.heads[key], session.rounds[key] = answers, [answers]
    key = hold(session, 2, [[a_tile(2, 1, 4)]])  # Mapping's own answer was dropped.
    session.heads[key].append(a_tile(2, 1, 4))
    made.settle()
    until_asked(made)
    assert tiles_in_order(made) == [(0, 2, 7)]
    (lack,) = made.lacks()
    assert lack.startswith("1 tiles that the map had before are missing in")


def test_heads_that_were_dropped_are_asked_for_again(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = recording(session, tmp_path / "run.mcap")
    status = compose.status("mapping", 1, 1, None, [], {}, figures={"map_tiles": 2.0})
    session.rounds[session.keys.below("service/mapping/mapping-1/status")] = [[status]]
    hold(session, 0, [[a_tile(0, 2, 5)]])
    get = session.get

    def then_the_other(selector: str, handler: Any = None, **more: Any) -> list[Any]:
        answers = get(selector, handler, **more)
        if selector.endswith("/plane/**?heads"):
            hold(session, 1, [[a_tile(1, 2, 5)]])
        return answers

    monkeypatch.setattr(session, "get", then_the_other)
    made.settle()
    until_asked(made)
    assert tiles_in_order(made) == [(0, 2, 7), (1, 2, 7)]
    assert made.lacks() == []


def test_a_tile_for_which_there_was_no_room_is_asked_for_again(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is no message that was dropped, too, and would be missing twice."""
    monkeypatch.setattr(intake, "MOST_WAIT_S", 0.0)
    monkeypatch.setattr(recorder, "MOST_WAITING_BYTES", 1)
    made = recording(session, tmp_path / "run.mcap")
    for i in range(2):
        hold(session, i, [[a_tile(i, 2, 5)]])
    made.settle()
    until_asked(made)  # The first one alone has room.
    made.close()
    assert session.selectors.count(session.keys.tile("plane", (1, 0, 0))) == 2
    (lack,) = made.lacks()
    assert "1 tiles that the map had before are missing in" in lack


def test_the_path_from_before_it_is_recorded(session: FakeSession, tmp_path: Path) -> None:
    rows = np.zeros(3, messages.STAMPED_POSE)
    rows["sweep"], rows["pose"]["rotation"]["w"] = range(3), 1.0
    path = compose.path(compose.HeaderValues(1, 2, 0), rows)
    session.rounds[session.keys.path_map] = [[path]]
    made = Recorder(linked(session), Options(tmp_path / "run.mcap"))
    made.settle()
    head = compose.HeaderValues(1, 3, 3)
    session.publish(session.keys.pose, compose.pose("MapPose", head, 3, (0, 0, 0), (0, 0, 0, 1)))
    made.close()
    found = dict(contents(made.parts[0]))
    assert found["loam/robot/path/map"] == path
    shown = importlib.import_module("foxglove_schemas_flatbuffer.PosesInFrame").PosesInFrame
    assert shown.GetRootAs(found["/path"]).PosesLength() == 4


@pytest.mark.parametrize("poses", [None, 0], ids=["none", "after a reset"])
def test_a_path_that_did_not_come_is_told(
    session: FakeSession, tmp_path: Path, poses: int | None
) -> None:
    if poses is not None:
        path = compose.path(compose.HeaderValues(1, 2, 0), np.zeros(poses, messages.STAMPED_POSE))
        session.rounds[session.keys.path_map] = [[path]]
    status = compose.status("mapping", 1, 1, 4, [], {})
    session.rounds[session.keys.below("service/mapping/mapping-1/status")] = [[status]]
    made = recording(session, tmp_path / "run.mcap")
    made.settle()
    made.close()
    said = ["the path so far is missing in" in each for each in made.lacks()]
    assert said == ([True] if poses is None else [])


def test_messages_are_written_while_mapping_hangs(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its answers may take a minute, in which a large lidar fills the room for waiting ones."""
    made = recording(session, tmp_path / "run.mcap")
    get, written = session.get, []

    def hanging(selector: str, handler: Any = None, **more: Any) -> list[Any]:
        if selector == session.keys.path_map or selector.endswith("heads"):
            before = made.written
            session.publish_long_pose(1)
            deadline = time.monotonic() + 5.0
            while made.written == before and time.monotonic() < deadline:
                time.sleep(0.01)
            written.append(made.written > before)
        return get(selector, handler, **more)

    monkeypatch.setattr(session, "get", hanging)
    made.settle()
    made.close()
    assert written == [True, True, True]


def test_a_tile_from_before_is_not_written_after_a_newer_one(
    session: FakeSession, tmp_path: Path
) -> None:
    """An answer may be overtaken by what is published. A tile of another map ends the one before
    in every view."""
    made = recording(session, tmp_path / "run.mcap")
    keys = [hold(session, i, [[a_tile(i, 2, 5)]]) for i in range(2)]
    session.publish(keys[0], a_tile(0, 3, 6))
    made.settle()
    until_asked(made)
    made.poll()
    assert tiles_in_order(made) == [(0, 3, 7), (1, 2, 7)]
    made = recording(session, tmp_path / "reset.mcap")
    session.publish(keys[0], a_tile(0, 1, 6, map_id=8))
    made.settle()
    until_asked(made)
    assert tiles_in_order(made) == [(0, 1, 8)]
    assert made.lacks() == []


def test_a_whole_tile_is_not_written_after_one_that_was_published_meanwhile(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a mapping without heads, which answers with the tiles that it has then."""
    made = recording(session, tmp_path / "run.mcap")
    get, key = session.get, session.keys.tile("plane", (0, 0, 0))

    def then_published(selector: str, handler: Any = None, **more: Any) -> list[Any]:
        answers = get(selector, handler, **more)
        if selector.endswith("/plane/**?heads"):
            session.publish(key, a_tile(0, 3, 6))
            deadline = time.monotonic() + 5.0
            while not made._intake.has_all(0.0) and time.monotonic() < deadline:
                time.sleep(0.01)
        return answers

    session.heads[key] = [a_tile(0, 2, 5)]
    monkeypatch.setattr(session, "get", then_published)
    made.settle()
    until_asked(made)
    assert tiles_in_order(made) == [(0, 3, 7)]
    assert made.lacks() == []


def test_a_map_that_was_reset_lacks_nothing_and_is_not_asked_for(
    session: FakeSession, tmp_path: Path
) -> None:
    """Else `zloam record` and then `zloam reset` would end with 1. The map has a greater number
    than the one before."""
    made = recording(session, tmp_path / "run.mcap")
    key = hold(session, 0, [[]])
    session.publish(key, a_tile(0, 5, 4, map_id=6))  # Just before the map that is there now.
    hold(session, 1, [[a_tile(1, 2, 5)]])
    made.settle()
    until_asked(made)
    made.poll()
    assert made._map.lacking() == 1
    session.publish(session.keys.tile("plane", (2, 0, 0)), a_tile(2, 1, 5, map_id=8))
    made.poll()
    session.selectors.clear()
    made._map._ask()
    assert key not in session.selectors
    assert tiles_in_order(made) == [(0, 5, 6), (1, 2, 7), (2, 1, 8)]
    assert made.lacks() == []


def tiles_in_order(made: Recorder) -> list[tuple[int, int, int]]:
    made.close()
    return tiles_in(made.parts[0])


def test_a_map_of_which_nothing_is_known_is_not_taken_for_another(
    session: FakeSession, tmp_path: Path
) -> None:
    made = recording(session, tmp_path / "run.mcap")
    status = compose.status("mapping", 1, 1, 1, [], {}, figures={"map_tiles": 3.0})
    session.rounds[session.keys.below("service/mapping/mapping-1/status")] = [[status]]
    made.settle()
    session.publish(session.keys.tile("plane", (0, 0, 0)), a_tile(0, 3, 6))
    made.close()
    assert made.lacks()[0].startswith("3 tiles that the map had before")


def test_a_map_from_before_that_did_not_come_is_told(
    session: FakeSession, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hold(session, 0, [[]])
    status = compose.status("mapping", 1, 1, 1, [], {}, figures={"map_tiles": 3.0})
    session.rounds[session.keys.below("service/mapping/mapping-1/status")] = [[status]]
    options = Options(tmp_path / "run.mcap", scene=False)
    assert recorder.record(linked(session), options, 0.0) == 1
    assert "3 tiles that the map had before are missing in" in capsys.readouterr().out
    with options.path.open("rb") as file:
        noted = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    assert noted["zloam.dropped"] == {"loam/robot/map/tile": "3"}


@pytest.mark.parametrize("step_s", [-60, 365 * 86400])
def test_a_step_of_the_clock_makes_no_stage_silent(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step_s: int
) -> None:
    path = tmp_path / "run.mcap"
    made = Recorder(linked(session), Options(path, scene=False))
    made.settle()
    stepped_ns = time.time_ns() + step_s * 10**9
    for n, stage in enumerate((*STAGES, *STAGES)):
        if n == len(STAGES) // 2:
            monkeypatch.setattr("zloam_monitor.intake.time.time_ns", lambda: stepped_ns)
        session.publish_status(stage, at_ns=n)
    made.close()
    assert RobotLog(path).extent().seconds < 60
    assert not [f for f in doctor_files.of_recording(path) if "is not there" in f.what]


@pytest.mark.parametrize(
    ("health", "silent_s", "told"),
    [("ready", 30, True), ("ready", 3, False), ("stopping", 30, False)],
)
def test_an_end_without_messages_is_told(
    session: FakeSession,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    health: str,
    silent_s: int,
    told: bool,
) -> None:
    """Unless a stage has said that it ends."""
    now_s = 100
    monkeypatch.setattr(intake.Clock, "now_ns", lambda _: now_s * 10**9)
    made = recording(session, tmp_path / "run.mcap")
    session.publish_status("odometry")
    now_s += 20
    session.publish_status("mapping", health=health)
    made.poll()
    now_s += silent_s
    made.close()
    assert made.silence() == [
        f"nothing came in the last 30 s of {made.parts[0]}: the link to the robot was cut, its "
        "stages were killed, or a replay of it was over; what was published since then is missing"
    ] * int(told)


def test_a_recording_of_nothing_is_no_success(
    session: FakeSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot vanished between its discovery and the first message."""
    times_ns = itertools.count(0, 10**10)
    monkeypatch.setattr(intake.Clock, "now_ns", lambda _: next(times_ns))
    options = Options(tmp_path / "run.mcap", scene=False)
    assert recorder.record(linked(session), options, 0.0) == 1


def part(path: Path, number: int, **about: str) -> Path:
    McapFile(path, {**ABOUT, "part": str(number), **about}).close()
    return path


@pytest.mark.parametrize("about", [{}, {"recording": "a1"}], ids=["older", "with identity"])
def test_only_parts_of_the_same_recording_are_read(tmp_path: Path, about: dict[str, str]) -> None:
    first = part(tmp_path / "run.mcap", 1, **about)
    parts = [first, *(part(tmp_path / f"run_{n}.mcap", n, **about) for n in (2, 10))]
    part(tmp_path / "run_3.mcap", 1, **about)  # A recording of its own.
    part(tmp_path / "run_11.mcap", 11, **{**about, "robot": "another"})
    (tmp_path / "run_12.mcap").write_bytes(b"\x89MCAP damaged")
    log = RobotLog(first)
    assert log.parts == parts
    assert log.parts == parts
    damaged, *gaps = log.remarks
    assert damaged.startswith("run_12.mcap is no recording of zloam, or its beginning is damaged")
    assert [gap.split()[0] for gap in gaps] == [f"run_{n}.mcap" for n in range(3, 10)]


def test_parts_of_two_recordings_of_one_robot_are_told_apart(tmp_path: Path) -> None:
    first = part(tmp_path / "run.mcap", 1, recording="a1")
    part(tmp_path / "run_2.mcap", 2, recording="b2")
    assert RobotLog(first).parts == [first]
