"""The doctor's reports on deliberately damaged captures and on recordings by `zloam record` (issue
41)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import dpkt
import pytest

from tests.integration.conftest import Capture, monitor
from tests.integration.robot_faults import HDL32E, HOUR_US, PRODUCT_BYTE, STAMP_BYTES

Frame = tuple[float, bytes]
#: bytes before the payload of a data packet's frame: Ethernet, IP and UDP headers
HEAD = 42
DATA_FRAME = HEAD + 1206
SNAP = 512


def with_payload(frame: bytes, change: Callable[[bytearray], None]) -> bytes:
    """Changes the payload of a data packet's frame; other frames stay as they are."""
    if len(frame) != DATA_FRAME:
        return frame
    payload = bytearray(frame[HEAD:])
    change(payload)
    return frame[:HEAD] + bytes(payload)


def each_payload(
    frames: Iterable[Frame], change: Callable[[bytearray, float], None]
) -> Iterator[Frame]:
    first = None
    for at, frame in frames:
        first = at if first is None else first
        since = at - first
        yield at, with_payload(frame, lambda payload, s=since: change(payload, s))  # type: ignore[misc]


def every_tenth_missing(frames: list[Frame]) -> Iterable[Frame]:
    return [frame for n, frame in enumerate(frames) if n % 10]


def cut_off(frames: list[Frame]) -> Iterable[Frame]:
    return [(at, frame[:SNAP]) for at, frame in frames]


def twice(frames: list[Frame]) -> Iterable[Frame]:
    return [frame for frame in frames for _ in range(2)]


def other_product(frames: list[Frame]) -> Iterable[Frame]:
    def change(payload: bytearray, _since: float) -> None:
        payload[PRODUCT_BYTE] = HDL32E

    return each_payload(frames, change)


def unknown_product(frames: list[Frame]) -> Iterable[Frame]:
    def change(payload: bytearray, _since: float) -> None:
        payload[PRODUCT_BYTE] = 0x77

    return each_payload(frames, change)


def unknown_mode(frames: list[Frame]) -> Iterable[Frame]:
    def change(payload: bytearray, _since: float) -> None:
        payload[PRODUCT_BYTE - 1] = 0x11

    return each_payload(frames, change)


def sensor_clock_set(frames: list[Frame]) -> Iterable[Frame]:
    def change(payload: bytearray, since: float) -> None:
        (stamp,) = struct.unpack("<I", payload[STAMP_BYTES])
        stamp = (stamp + (9_000_000 if since > 3.0 else 0)) % HOUR_US
        payload[STAMP_BYTES] = struct.pack("<I", stamp)

    return each_payload(frames, change)


def host_clock_set(frames: list[Frame]) -> Iterable[Frame]:
    begin = frames[0][0]
    return [(at + (30.0 if at - begin > 1.0 else 0.0), frame) for at, frame in frames]


def impossible_time(frames: list[Frame]) -> Iterable[Frame]:
    def change(payload: bytearray, _since: float) -> None:
        payload[STAMP_BYTES] = struct.pack("<I", 4_200_000_000)

    return each_payload(frames, change)


def none_of_a_lidar(frames: list[Frame]) -> Iterable[Frame]:
    return [(at, frame[:HEAD] + bytes(100)) for at, frame in frames[:200]]


def overwritten(frames: list[Frame]) -> Iterable[Frame]:
    """Zeros all data blocks with their flags, as if the file had been overwritten."""

    def change(payload: bytearray, _since: float) -> None:
        payload[:1200] = bytes(1200)

    return each_payload(frames, change)


def as_it_is(frames: list[Frame]) -> Iterable[Frame]:
    return frames


@dataclass(frozen=True)
class Damage:
    """What is done to the frames, and words that the doctor must say about it."""

    do: Callable[[list[Frame]], Iterable[Frame]]
    words: str
    #: bytes cut off at the end of the file
    cut_bytes: int = 0
    code: int = 1


DAMAGES = {
    "nothing": Damage(as_it_is, "all well", code=0),
    "every tenth packet missing": Damage(every_tenth_missing, "packets are missing"),
    "a short snap length": Damage(cut_off, "frames hold less than their packet"),
    "each packet twice": Damage(twice, "packets come twice"),
    "the product byte of another model": Damage(
        other_product, "they come at another pace than the model has"
    ),
    "an unknown product": Damage(unknown_product, "a model that is not known"),
    "an unknown return mode": Damage(unknown_mode, "unknown return mode"),
    "the sensor's clock set": Damage(sensor_clock_set, "the sensor's clock was set"),
    "the host's clock set": Damage(host_clock_set, "the host's clock was set"),
    "stamps that can't be": Damage(impossible_time, "have no time that can be"),
    "nothing of a lidar": Damage(none_of_a_lidar, "no packet of a lidar is in it"),
    "packets overwritten": Damage(overwritten, "no packet of it could be decoded"),
    "the end is missing": Damage(as_it_is, "truncated", cut_bytes=700),
}


def damaged(capture: Path, path: Path, damage: Damage) -> None:
    with capture.open("rb") as file:
        frames = [(float(at), bytes(frame)) for at, frame in dpkt.pcap.Reader(file)]
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file)
        for at, frame in damage.do(frames):
            writer.writepkt(frame, at)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - damage.cut_bytes])


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_named(build: Path, capture: Capture, tmp_path: Path, name: str) -> None:
    damage, path = DAMAGES[name], tmp_path / "damaged.pcap"
    damaged(capture.pcap, path, damage)
    done = monitor("doctor", path, "--preset-dir", build)
    assert damage.words in done.said
    assert done.code == damage.code, done.said


@pytest.fixture(scope="module")
def recording(build: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    files = ("--out", folder / "out", "--record", folder / "run.mcap")
    done = monitor("demo", "--preset-dir", build, "--pcap", capture.pcap, *files)
    assert done.code == 0, done.said
    return folder / "run.mcap"


def test_of_a_healthy_recording_all_is_well(build: Path, recording: Path) -> None:
    done = monitor("doctor", recording, "--preset-dir", build)
    assert done.code == 0, done.said
    assert "all well" in done.said


def test_what_a_stage_said_while_it_was_recorded_is_told(
    build: Path, capture: Capture, tmp_path: Path
) -> None:
    """Every tenth packet is missing before the driver reads the capture."""
    path = tmp_path / "lossy.pcap"
    damaged(capture.pcap, path, DAMAGES["every tenth packet missing"])
    files = ("--out", tmp_path / "out", "--record", tmp_path / "run.mcap")
    monitor("demo", "--preset-dir", build, "--pcap", path, *files, "--rate", "realtime")
    done = monitor("doctor", tmp_path / "run.mcap", "--preset-dir", build)
    assert done.code == 1, done.said
    assert "packets were lost on the way" in done.said


def test_of_a_recording_that_was_cut_off_what_is_whole_is_judged(
    build: Path, recording: Path, tmp_path: Path
) -> None:
    whole = recording.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: 2 * len(whole) // 3])
    done = monitor("doctor", cut, "--preset-dir", build)
    assert done.code == 1, done.said
    assert "cut off or damaged" in done.said
    assert "Traceback" not in done.said


def test_another_mcap_file_is_named(build: Path, tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    done = monitor("doctor", path, "--preset-dir", build)
    assert done.code == 3
    assert "other.mcap: zloam record did not write it" in done.said
