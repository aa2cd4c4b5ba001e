"""Bags whose files are compressed as wholes are unpacked one file at a time."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin

from tests.recordings import made, variants
from tests.recordings.made import streamed, texts
from tests.recordings.test_bag_clouds import assert_same, read
from tests.recordings.variants import PLAIN, Container
from zloam_monitor.recordings import bags, parts, stream

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

KINDS = (
    Container("sqlite3", compression="file"),
    Container("mcap", plugin=StoragePlugin.MCAP, compression="file"),
)
SCANS = made.scans(24)


@pytest.fixture(params=KINDS, ids=lambda kind: kind.name)
def bag(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A bag of two files with half of the scans each, as `ros2 bag record` splits it."""
    halves = [
        variants.write(tmp_path / f"half{n}", SCANS[12 * n : 12 * (n + 1)], PLAIN, request.param)
        for n in range(2)
    ]
    (second,) = halves[1].glob("*.zstd")
    shutil.copy(second, halves[0])
    described = halves[0] / "metadata.yaml"
    metadata = yaml.safe_load(described.read_text())
    about = metadata["rosbag2_bagfile_information"]
    about["relative_file_paths"].append(second.name)
    about["message_count"] = about["topics_with_message_count"][0]["message_count"] = len(SCANS)
    described.write_text(yaml.safe_dump(metadata))
    return halves[0]


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (folder := tmp_path / "scratch").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_at_most_one_file_is_unpacked_at_a_time(bag: Path, scratch: Path) -> None:
    assert_same(read(bag), SCANS)
    with bags.opened(bag) as opened:
        topic = opened.choose("")
        assert topic.messages == len(SCANS)
        for _ in opened.messages(topic):
            assert sum(path.is_file() for path in scratch.rglob("*")) <= 1
    assert not list(scratch.iterdir())


def no_room(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("size_known", [True, False])
def test_a_file_that_does_not_fit_is_refused_with_what_helps(
    bag: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch, size_known: bool
) -> None:
    """Before it is unpacked if its frame has its size, as rosbag2 writes it; or else in time."""
    if size_known:
        for file in bag.glob("*.zstd"):
            file.write_bytes(zstd.compress(zstd.decompress(file.read_bytes())))
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    else:
        monkeypatch.setattr(shutil, "copyfileobj", no_room)
    said = texts(streamed(bag), stream.REFUSAL)
    assert f"does not fit into {scratch}: " in said
    assert "TMPDIR" in said
    assert not list(scratch.iterdir())


def test_later_pythons_have_zstd_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (packed := tmp_path / "part.db3.zstd").write_bytes(zstd.compress(b"messages"))
    monkeypatch.setitem(sys.modules, "compression", SimpleNamespace(zstd=zstd))
    monkeypatch.setitem(sys.modules, "backports", None)
    monkeypatch.setattr(sys, "version_info", (3, 14))
    (folder := tmp_path / "unpacked").mkdir()
    assert parts._unpacked(packed, folder).read_bytes() == b"messages"


def test_what_is_whole_before_a_damaged_file_is_used(bag: Path, scratch: Path) -> None:
    last = sorted(bag.glob("*.zstd"))[-1]
    last.write_bytes(last.read_bytes()[:1000])
    frames = streamed(bag)
    assert len(frames[stream.SWEEP]) == 12
    assert "after 12 messages it cannot be read" in texts(frames, stream.REMARK)
    assert not list(scratch.iterdir())
