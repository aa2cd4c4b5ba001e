"""A recording is complete, readable by other libraries, and replayed to the same bytes."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader

from tests.integration.conftest import PATIENCE_S, ROOT, Done, digests, monitor, simulate
from zloam_monitor import messages, records, se3, trajectory
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.processes import free_port

SAME = ("trajectory.tum", "odometry.tum", "map.pcd")
ROBOT = "taped"
#: pace of a replay during which a busy machine starts other processes; it ends with its test
SLOW = 0.4
RUST = ROOT / "deploy/build/rust.sh"
READER = ROOT / "tests/mcap_reader/Cargo.toml"
#: bytes that a recorder has written before it is killed
WRITTEN_BYTES = 500_000


@dataclass(frozen=True)
class Recorded:
    """A run and its recording."""

    out: Path
    mcap: Path
    said: str


def demo(build: Path, out: Path, *options: object) -> Done:
    done = monitor("demo", "--preset-dir", build, "--out", out, *options)
    assert done.code == 0, done.said
    return done


@pytest.fixture(scope="module")
def recorded(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A run with an IMU, non-default configuration, and a parameter changed during the run."""
    folder = tmp_path_factory.mktemp("recorded")
    done = demo(
        *(build, folder / "out", "--world", "indoor", "--seed", 5, "--imu", "simulated"),
        *("--simulate=--duration=6", "--record", folder / "run.mcap"),
        *("--set", f"robot={ROBOT}", "--set", "mounting.xyz_m=[0.1, 0.2, 0.3]"),
        *("--set", "odometry.window_sweeps=12", "--set-at", "20:mapping.voxel_planes.stride=3"),
    )
    return Recorded(folder / "out", folder / "run.mcap", done.said)


def opened(path: Path) -> Iterator[tuple[str, Any, Any]]:
    """(topic, schema, message), read by the library of the file format (mcap)."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            yield channel.topic, schema, message


def test_it_has_every_message_once(recorded: Recorded) -> None:
    counts = Counter(topic.removeprefix(f"loam/{ROBOT}/") for topic, _, _ in opened(recorded.mcap))
    poses = len(trajectory.read(recorded.out / "trajectory.tum"))
    for topic in ("lidar/lidar/sweep", "odometry", "pose", "map/odometry", "map/correction"):
        assert counts[topic] == poses, topic
    assert counts["map/tile"] > 10
    assert counts["config/mapping"] == 1
    assert sum(n for topic, n in counts.items() if topic.endswith("/config")) == 5
    assert "odometry/features" not in counts


def test_its_schemas_are_those_of_the_messages(recorded: Recorded) -> None:
    """A reader that has only the file can interpret the messages, by FlatBuffers' own
    reflection."""
    schemas = {schema.name: schema for _, schema, _ in opened(recorded.mcap) if schema}
    assert {"zloam.msg.Sweep", "zloam.msg.MapPose", "foxglove.PointCloud"} <= schemas.keys()
    for name, schema in schemas.items():
        assert schema.encoding == "flatbuffer"
        assert schema.data[4:8] == b"BFBS"
        assert name.encode() in schema.data
        assert b"reserved" in schema.data or not name.endswith(".Sweep")


def test_replayed_it_gives_the_same_bytes(build: Path, recorded: Recorded, tmp_path: Path) -> None:
    for again in ("first", "second"):
        done = demo(build, tmp_path / again, "--bag", recorded.mcap)
        assert f"of robot {ROBOT}" in done.said
        assert digests(tmp_path / again, SAME) == digests(recorded.out, SAME)


def test_by_another_configuration_it_gives_others(
    build: Path, recorded: Recorded, tmp_path: Path
) -> None:
    demo(build, tmp_path / "out", "--bag", recorded.mcap, "--set", "odometry.window_sweeps=6")
    assert digests(tmp_path / "out", SAME) != digests(recorded.out, SAME)


def test_foxglove_is_shown_what_the_stages_said(recorded: Recorded) -> None:
    """Foxglove messages agree with the stages' own; they are read by the code that Foxglove
    publishes with its schemas."""
    shown: dict[str, list[Any]] = {}
    clouds, poses = [], {}
    for topic, schema, message in opened(recorded.mcap):
        if schema is not None and schema.name.startswith("foxglove."):
            name = schema.name.removeprefix("foxglove.")
            module = importlib.import_module(f"foxglove_schemas_flatbuffer.{name}")
            shown.setdefault(topic, []).append(getattr(module, name).GetRootAs(message.data))
        elif topic.endswith("/pose"):
            pose = records.map_pose(message.data)
            poses[pose.instant_ns] = pose
        elif topic.endswith("/sweep"):
            clouds.append(messages.decode("Sweep", message.data).PointsLength())
    assert {"/tf", "/pose", "/path", "/points", "/map", "/log"} <= shown.keys()
    assert len(shown["/points"]) == len(shown["/pose"]) == len(poses)
    for cloud in shown["/points"]:
        assert cloud.FrameId() == b"base_link"
        assert 0 < cloud.DataLength() / cloud.PointStride() <= max(clouds)
        fields = [cloud.Fields(i).Name() for i in range(cloud.FieldsLength())]
        assert fields == [b"x", b"y", b"z", b"intensity"]
    joined = chained(shown["/tf"])
    assert len(joined) >= len(poses) - 1
    for stamp_ns, T_map_base in joined.items():
        expected = se3.matrices(
            poses[stamp_ns].translation[None], poses[stamp_ns].quaternion[None]
        )[0]
        np.testing.assert_allclose(T_map_base, expected, atol=1e-9)


def chained(messages_of_tf: list[Any]) -> dict[int, np.ndarray]:
    """Instant -> map -> odom -> base_link, for instants at which both transforms exist."""
    found: dict[str, dict[int, np.ndarray]] = {"odom": {}, "base_link": {}, "lidar": {}}
    for message in messages_of_tf:
        for i in range(message.TransformsLength()):
            t = message.Transforms(i)
            p, q, at = t.Translation(), t.Rotation(), t.Timestamp()
            matrix = se3.matrices(
                np.array([[p.X(), p.Y(), p.Z()]]), np.array([[q.X(), q.Y(), q.Z(), q.W()]])
            )[0]
            found[t.ChildFrameId().decode()][at.Sec() * 10**9 + at.Nsec()] = matrix
    np.testing.assert_allclose(next(iter(found["lidar"].values()))[:3, 3], [0.1, 0.2, 0.3])
    return {
        stamp: found["odom"][stamp] @ found["base_link"][stamp]
        for stamp in found["odom"].keys() & found["base_link"].keys()
    }


def started(*words: object) -> subprocess.Popen[str]:
    """Starts `zloam ...` and returns the running process."""
    return subprocess.Popen(
        [sys.executable, "-m", "zloam_monitor", *map(str, words)],
        cwd=ROOT,
        env={"PYTHONPATH": str(ROOT / "services/monitor/src"), "PATH": "/usr/bin:/bin"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


class Replaying:
    """`zloam replay` in a process of its own."""

    def __init__(self, *options: object) -> None:
        self.port = free_port()
        self.process = started("replay", *options, "--listen", f"127.0.0.1:{self.port}")

    def ended(self) -> Done:
        said, _ = self.process.communicate(timeout=120)
        return Done(self.process.returncode, said)

    def __enter__(self) -> Replaying:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
            self.ended()


@contextlib.contextmanager
def linked(replaying: Replaying, robot: str) -> Iterator[Link]:
    """A link to a replay, which may come up on the way."""
    session = open_session([f"tcp/127.0.0.1:{replaying.port}"])
    link = Link(session, Keys(robot))
    try:
        yield link
    finally:
        link.close()
        session.close()


def until(link: Link, holds: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline
        link.poll(0.1)


def heard(robot: str, *options: object) -> tuple[Link, Done]:
    """Follows a replay with a subscriber to which it connects before its first message."""
    port = free_port()
    session = open_session([], f"tcp/127.0.0.1:{port}")
    link = Link(session, Keys(robot))
    with Replaying(*options, "--connect", f"127.0.0.1:{port}") as replaying:
        while replaying.process.poll() is None:
            link.poll(0.1)
        done = replaying.ended()
    link.poll(0.2)
    link.close()
    session.close()
    return link, done


def test_published_again_it_is_the_robot(recorded: Recorded) -> None:
    link, done = heard(ROBOT, recorded.mcap, "--rate", 4)
    assert done.code == 0, done.said
    written = trajectory.read(recorded.out / "trajectory.tum")
    # The replay does not wait for its readers, and a busy one misses some.
    assert len(link.poses) > 0.8 * len(written)
    np.testing.assert_allclose(link.trajectory().positions[-1], written.positions[-1], atol=1e-6)
    assert set(link.newest_statuses()) >= {"odometry", "mapping", "integration"}


def test_a_part_of_it_under_another_name(recorded: Recorded) -> None:
    options = ("--robot", "ghost", "--from", 0.5, "--rate", SLOW)
    with Replaying(recorded.mcap, *options) as replaying, linked(replaying, "ghost") as link:
        until(link, lambda: link.poses and link.query_configs())
        assert link.query_configs()["odometry"]["odometry.window_sweeps"] == 12
        assert "odometry" in link.living()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--from", 1000), "nothing lies from 1000 s"),
        (("--from", 2, "--to", 1), "nothing lies from 2 s"),
    ],
)
def test_a_part_that_is_not_there_is_said(
    recorded: Recorded, options: tuple[object, ...], words: str
) -> None:
    done = Replaying(recorded.mcap, *options).ended()
    assert done.code == 2
    assert words in done.said
    assert "Traceback" not in done.said


def test_the_robot_itself_is_not_talked_over(recorded: Recorded) -> None:
    with Replaying(recorded.mcap, "--rate", SLOW) as first:
        assert first.process.stdout is not None
        assert f"robot {ROBOT}" in first.process.stdout.readline()
        with linked(first, ROBOT) as link:
            until(link, link.living)
        second = Replaying(recorded.mcap, "--connect", f"127.0.0.1:{first.port}").ended()
    assert second.code == 3
    assert f"robot {ROBOT} is there and alive" in second.said


def test_what_is_no_recording_is_said(recorded: Recorded, tmp_path: Path) -> None:
    text = tmp_path / "a.mcap"
    text.write_text("no recording")
    for path in (text, tmp_path / "absent.mcap"):
        done = Replaying(path).ended()
        assert done.code == 3
        assert str(path) in done.said
        assert "Traceback" not in done.said


def cut_off(recorded: Recorded, folder: Path) -> Path:
    """A copy of the recording, truncated to three quarters."""
    cut = folder / "cut.mcap"
    whole = recorded.mcap.read_bytes()
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    return cut


def test_of_a_recording_that_was_cut_off_the_rest_is_replayed(
    build: Path, recorded: Recorded, tmp_path: Path
) -> None:
    cut = cut_off(recorded, tmp_path)
    done = monitor("demo", "--preset-dir", build, "--out", tmp_path / "out", "--bag", cut)
    assert "is cut off or damaged" in done.said
    poses = len(trajectory.read(tmp_path / "out" / "trajectory.tum"))
    assert 10 < poses < len(trajectory.read(recorded.out / "trajectory.tum"))


def test_another_recording_is_not_replaced(build: Path, recorded: Recorded, tmp_path: Path) -> None:
    before = recorded.mcap.read_bytes()
    capture = simulate(build, tmp_path, "--world", "city", "--duration", "1")
    done = monitor(
        *("demo", "--preset-dir", build, "--out", tmp_path / "out", "--pcap", capture.pcap),
        *("--record", recorded.mcap),
    )
    assert done.code == 3
    assert "is there already" in done.said
    assert recorded.mcap.read_bytes() == before


@pytest.fixture(scope="module")
def rust_reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built as the programs' Rust part is, and rebuilt when its sources change. Skips where its
    crates cannot be obtained; fails if they are there and it does not compile."""
    if shutil.which("cargo") is None:
        pytest.skip("no cargo: the crate mcap reads nothing here")
    program = tmp_path_factory.mktemp("rust") / "zloam-mcap-reader"
    built = subprocess.run(
        [RUST, "--mcap-reader", program], capture_output=True, text=True, check=False
    )
    if built.returncode != 0:
        fetch = ["cargo", "fetch", "--locked", "--manifest-path", str(READER)]
        fetched = subprocess.run(fetch, capture_output=True, text=True, check=False)
        if fetched.returncode != 0:
            pytest.skip(f"no registry of crates: {fetched.stderr.strip().splitlines()[-1]}")
    assert built.returncode == 0, built.stderr
    return program


def by_rust(reader: Path, path: Path) -> dict[str, Any]:
    """Result of the crate mcap: `topics`, the number of messages in its index, and why it
    stopped."""
    done = subprocess.run([reader, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def in_order(path: Path) -> Iterator[tuple[str, bytes]]:
    """(topic, data) in file order, by the Python reader, up to where the file is truncated."""
    with path.open("rb") as file:
        messages_of = NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)
        try:
            for _, channel, message in messages_of:
                yield channel.topic, message.data
        except McapError:
            return


def counted(messages_of: Iterable[tuple[str, bytes]]) -> dict[str, dict[str, int]]:
    """Counts by topic, in the form of the Rust program's output."""
    found: dict[str, dict[str, int]] = {}
    for topic, data in messages_of:
        of = found.setdefault(topic, {"messages": 0, "bytes": 0, "crc32": 0})
        of["messages"] += 1
        of["bytes"] += len(data)
        of["crc32"] = zlib.crc32(data, of["crc32"])
    return found


def total(topics: dict[str, dict[str, int]]) -> int:
    return sum(each["messages"] for each in topics.values())


def test_rust_reads_the_same(recorded: Recorded, rust_reader: Path) -> None:
    found = by_rust(rust_reader, recorded.mcap)
    assert found["stopped"] is None
    assert found["topics"] == counted(in_order(recorded.mcap))
    assert found["indexed"] == total(found["topics"]) > 100


def test_rust_reads_a_part_as_far_as_it_goes(
    recorded: Recorded, rust_reader: Path, tmp_path: Path
) -> None:
    cut = cut_off(recorded, tmp_path)
    found = by_rust(rust_reader, cut)
    assert found["stopped"]
    assert found["indexed"] is None
    count = total(found["topics"])
    assert found["topics"] == counted(itertools.islice(in_order(recorded.mcap), count))
    assert count >= total(counted(in_order(cut))) > 100


def writes(path: Path) -> bool:
    """Whether a process has this file among its arguments. A separate process writes a recording;
    when the recorder is killed, it writes what has completely arrived and ends."""
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if str(path).encode() in each.read_bytes():
                return True
    return False


def test_rust_reads_what_a_killed_recorder_left(
    recorded: Recorded, rust_reader: Path, tmp_path: Path
) -> None:
    path = tmp_path / "killed.mcap"
    deadline = time.monotonic() + PATIENCE_S
    with Replaying(recorded.mcap, "--rate", SLOW) as replaying:
        assert replaying.process.stdout is not None
        assert f"robot {ROBOT}" in replaying.process.stdout.readline()
        recorder = started("record", path, "--connect", f"127.0.0.1:{replaying.port}")
        try:
            while not path.exists() or path.stat().st_size < WRITTEN_BYTES:
                assert time.monotonic() < deadline
                assert replaying.process.poll() is None, "the replay was too short"
                time.sleep(0.05)
        finally:
            recorder.kill()
            recorder.communicate()
    while writes(path):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    found = by_rust(rust_reader, path)
    assert found["stopped"] is None
    assert found["topics"] == counted(in_order(path))
    assert found["indexed"] == total(found["topics"]) > 10
