"""A recording can be opened at any time by the usual readers."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader, make_reader

from zloam_monitor.mcap_file import SYNC_SECONDS, McapFile, RecordingError

ROOT = Path(__file__).resolve().parents[3]
#: Program that writes as fast as a robot with a large lidar, and prints when it has begun, then the
#: time of each message.
WRITER = """
import os, sys, time
from pathlib import Path
from zloam_monitor.mcap_file import McapFile
file = McapFile(Path(sys.argv[1]), {"robot": "r"})
print("begun", flush=True)
for n in range(10**9):
    now = time.time_ns()
    file.put(f"loam/r/{n % 7}", ("zloam.msg.X", b"schema"), now, now, os.urandom(200_000))
    print(now, flush=True)
    time.sleep(0.005)
"""


#: Program that writes until it is told to end, and prints the writer's process and what it wrote.
SERVICE = """
import sys, time
from pathlib import Path
from zloam_monitor import ending
from zloam_monitor.mcap_file import McapFile
file = McapFile(Path(sys.argv[1]), {"robot": "r"})
written = 0
with ending.until_told() as goes_on:
    print(file._disk._process.pid, flush=True)
    while goes_on():
        file.put("loam/r/a", None, written, written, bytes(1000))
        written += 1
        time.sleep(0.001)
for _ in range(10):
    file.put("loam/r/a", None, written, written, bytes(1000))
    written += 1
file.close()
print(written, flush=True)
"""


def commands() -> list[str]:
    """Command lines of all processes."""
    found = []
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            found.append(each.read_text())
    return found


def wait_until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def read(path: Path) -> list[tuple[str, int, bytes]]:
    """Reads a file by the library's readers, with and without the index, which must agree."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(found)
    with path.open("rb") as file:
        one_by_one = NonSeekingReader(file, validate_crcs=True).iter_messages()
        assert sorted((c.topic, m.log_time, m.data) for _, c, m in one_by_one) == sorted(found)
    return found


def test_what_was_put_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    file = McapFile(path, {"robot": "r"})
    assert read(path) == []
    put = []
    for n in range(3000):
        put.append((f"topic{n % 5}", 10 * n, bytes([n % 256]) * (n % 3000)))
        schema = ("zloam.msg.A", b"a") if n % 5 else None
        file.put(put[-1][0], schema, put[-1][1], put[-1][1] + 1, put[-1][2])
        if n % 997 == 0:
            file.whole()
            assert read(path) == put
    file.close()
    assert read(path) == put
    with path.open("rb") as opened:
        reader = make_reader(opened)
        schemas = {c.topic: s for s, c, _ in reader.iter_messages()}
        assert schemas["topic0"] is None
        assert (schemas["topic1"].name, schemas["topic1"].encoding) == ("zloam.msg.A", "flatbuffer")
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("zloam", {"robot": "r"})]


def test_another_recording_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    with pytest.raises(RecordingError, match=r"a\.mcap is there already"):
        McapFile(path, {})
    assert path.read_text() == "precious"


@pytest.mark.parametrize("seed", range(20))
def test_a_killed_writer_leaves_a_file_that_opens(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "a.mcap"
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)],
        env={"PYTHONPATH": str(ROOT / "services/monitor/src"), "PATH": "/usr/bin:/bin"},
        stdout=subprocess.PIPE,
    )
    assert writer.stdout is not None
    assert writer.stdout.readline() == b"begun\n"
    time.sleep(random.Random(seed).uniform(0.2, 2.0))
    writer.kill()
    # Not the time of the kill: on a busy machine the writer may have been held up before.
    times_ns = list(map(int, writer.communicate()[0].split()))
    # The separate process still writes the pieces that it has received completely.
    wait_until(lambda: not any(str(path) in command for command in commands()))
    found = read(path)
    put_ns = max(times_ns, default=0)
    # Of an empty file everything since the first message is missing.
    first_ns = min(times_ns, default=0)
    missing_s = 1e-9 * (put_ns - max((m[1] for m in found), default=first_ns))
    assert missing_s < 1.0 + SYNC_SECONDS
    assert all(len(data) == 200_000 for _, _, data in found)


def test_a_supervisor_that_ends_all_processes_at_once_ends_it_well(tmp_path: Path) -> None:
    """systemd and a shutdown send SIGTERM to the writer, too, a closing terminal SIGHUP."""
    path = tmp_path / "a.mcap"
    service = subprocess.Popen(
        [sys.executable, "-c", SERVICE, str(path)],
        env={"PYTHONPATH": str(ROOT / "services/monitor/src"), "PATH": "/usr/bin:/bin"},
        stdout=subprocess.PIPE,
    )
    assert service.stdout is not None
    writer = int(service.stdout.readline())
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        os.kill(writer, number)
    service.terminate()
    said, _ = service.communicate(timeout=60)
    assert service.returncode == 0
    assert len(read(path)) == int(said)


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    """A limit on the file's size simulates a full disk: it makes a write fail half-way."""
    path = tmp_path / "a.mcap"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    put = []
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        file = McapFile(path, {})
        with pytest.raises(OSError):  # noqa: PT012
            for n in range(100):
                data = random.Random(n).randbytes(90_000)
                file.put("t", None, n, n, data)
                file.whole()
                put.append(data)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert len(put) >= 5
    with pytest.raises(OSError):
        file.close()
    assert [data for _, _, data in read(path)] == put
