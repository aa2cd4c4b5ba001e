"""Injects faults into a clean capture and checks what the decoder makes of them.

The clean and the faulty capture are decoded side by side. A point's position depends on its own
packet alone, so each point must be found bit by bit in the clean sweep of the same time.
"""

from __future__ import annotations

import json
import os
import random
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import Setting, is_newer
from zloam_monitor.chain import binary

SECONDS = 600
LOST, LATE, DOUBLED = 0.05, 0.01, 0.01
PACKET_S = 1327.104e-6
#: packets that overtake a late one
OVERTAKEN_BY = 3
#: steps of the sensor's clock, s
STEPS = (123.4, -45.6)
#: number of packets without faults around each step and at both ends, where the decoder cannot know
#: of losses
QUIET = 8
HOUR_US = 3_600_000_000
WIRE_BYTES, HEADER_BYTES = 42 + 1206, 42
RECORD = np.dtype(
    [("place", "V16"), ("time_ns", "<i8"), ("ring", "<u2"), ("rest", "V4"), ("sweep", "<u2")]
)
#: a yard, with a drive so slow that one round takes the whole capture
WORLD = """
path: {points: [[-8, -6], [8, -6], [8, 6], [-8, 6]], closed: true, corner_radius_m: 2}
drive: {max_speed_m_s: 0.085, max_lateral_m_s2: 1, acceleration_m_s2: 1, still_s: 2, height_m: 1.5}
ground: {low: [-30, -30], high: [30, 30]}
shapes:
  - {kind: box, centre: [0, 14, 2], size: [30, 1, 4]}
  - {kind: box, centre: [0, -14, 2], size: [30, 1, 4]}
  - {kind: box, centre: [16, 0, 2], size: [1, 30, 4], rpy_deg: [0, 0, 5]}
  - {kind: box, centre: [-16, 0, 2], size: [1, 30, 4]}
  - {kind: cylinder, centre: [1, 1, 1], size: [0.6, 0.6, 3]}
"""
#: every n-th sweep is compared point by point
EVERY = 10


@dataclass
class Injected:
    """The numbers of the injected faults."""

    packets: int = 0
    lost: int = 0
    late: int = 0
    doubled: int = 0
    steps: int = len(STEPS)
    log: list[tuple[int, str]] = field(default_factory=list)


def _records(file: IO[bytes]) -> Iterator[tuple[bytes, bytes]]:
    """(record header of 16 bytes, frame) of a pcap file, read from behind its file header."""
    while len(header := file.read(16)) == 16:
        yield header, file.read(struct.unpack("<8xI4x", header)[0])


def _stepped(frame: bytes, step_s: float) -> bytes:
    """The frame with its stamp in the hour shifted."""
    at = HEADER_BYTES + 1200
    toh = struct.unpack_from("<I", frame, at)[0]
    return frame[:at] + struct.pack("<I", (toh + round(step_s * 1e6)) % HOUR_US) + frame[at + 4 :]


def inject(clean: Path, faulty: Path, packets: int, seed: int = 1) -> Injected:
    """Copies the data packets with losses, late and duplicate packets, and two steps of the
    clock."""
    chance, done = random.Random(seed), Injected()
    steps_at = [packets * (i + 1) // (len(STEPS) + 1) for i in range(len(STEPS))]
    quiet = [(n - QUIET, n + QUIET) for n in (0, *steps_at, packets)]
    held: list[tuple[int, bytes]] = []
    step_s = 0.0
    with clean.open("rb") as source, faulty.open("wb") as target:
        target.write(source.read(24))
        for header, frame in _records(source):
            if len(frame) != WIRE_BYTES:
                continue
            n = done.packets
            done.packets += 1
            if n in steps_at:
                step_s += STEPS[steps_at.index(n)]
            frame = _stepped(frame, step_s)
            drawn = chance.random()
            if any(low <= n < high for low, high in quiet):
                drawn = 1.0
            if drawn < LOST:
                done.lost += 1
                done.log.append((n, "lost"))
                continue
            if drawn < LOST + LATE:
                done.late += 1
                done.log.append((n, "late"))
                held.append((OVERTAKEN_BY, frame))
                continue
            copies = 2 if drawn < LOST + LATE + DOUBLED else 1
            if copies == 2:
                done.doubled += 1
                done.log.append((n, "doubled"))
            target.write((header + frame) * copies)
            held = [(left - 1, late) for left, late in held]
            for _, late in (entry for entry in held if entry[0] == 0):
                target.write(header + late)
            held = [entry for entry in held if entry[0] > 0]
    return done


def count_packets(capture: Path) -> int:
    """Number of data packets in a capture."""
    with capture.open("rb") as file:
        file.read(24)
        return sum(len(frame) == WIRE_BYTES for _, frame in _records(file))


class Decoding:
    """A running zloam-decode; its points come through a pipe."""

    def __init__(self, setting: Setting, capture: Path, folder: Path) -> None:
        self._pipe = folder / (capture.stem + ".points")
        os.mkfifo(self._pipe)
        command = [binary(setting.build, "decode"), "--pcap", capture, "--out", self._pipe]
        self._process = subprocess.Popen(
            [str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def sweeps(self) -> Iterator[NDArray[Any]]:
        """The sweeps, one after the other."""
        with self._pipe.open("rb") as pipe:
            rest = np.empty(0, RECORD)
            while chunk := pipe.read(RECORD.itemsize << 16):
                points = np.concatenate([rest, np.frombuffer(chunk, RECORD)])
                ends = np.nonzero(np.diff(points["sweep"]))[0] + 1
                *whole, rest = np.split(points, ends)
                yield from whole
            yield rest

    def summary(self) -> dict[str, int]:
        """The counters, after zloam-decode has ended."""
        said, complaints = self._process.communicate()
        if self._process.returncode != 0:
            raise RuntimeError(f"zloam-decode: {complaints[-200:]}")
        found: dict[str, int] = json.loads(said)
        return found


def _misplaced(clean: Decoding, faulty: Decoding) -> tuple[int, int]:
    """(number of compared points, number of those missing in the clean sweeps around them)."""
    window: list[NDArray[Any]] = []
    clean_sweeps = clean.sweeps()
    looked_at = strangers = 0
    for number, sweep in enumerate(faulty.sweeps()):
        # The times of both decodings agree to the delay of a packet.
        while not window or window[-1]["time_ns"][0] < sweep["time_ns"][-1] + 5_000_000:
            following = next(clean_sweeps, None)
            if following is None:
                break
            window.append(following)
        begin = sweep["time_ns"][0] - 5_000_000
        window = [w for w in window if w["time_ns"][-1] >= begin] or window[-1:]
        if number % EVERY == 0:
            known = np.concatenate([w["place"] for w in window])
            looked_at += len(sweep)
            strangers += int((~np.isin(sweep["place"].view("S16"), known.view("S16"))).sum())
    for _ in clean_sweeps:
        pass
    return looked_at, strangers


def compare(setting: Setting, clean: Path, faulty: Path, done: Injected) -> Measured:
    """Compares the counters with the injected faults, and the points with the clean capture's."""
    with tempfile.TemporaryDirectory() as folder:
        reference = Decoding(setting, clean, Path(folder))
        decoding = Decoding(setting, faulty, Path(folder))
        looked_at, strangers = _misplaced(reference, decoding)
        reference.summary()
        found = decoding.summary()
    want = {
        "packets_decoded": done.packets - done.lost,
        "packets_lost": done.lost,
        "packets_reordered": done.late,
        "packets_late": 0,
        "packets_duplicate": done.doubled,
        "clock_steps": done.steps,
    }
    wrong = {name: (found[name], value) for name, value in want.items() if found[name] != value}
    words = ", ".join(f"{name} {found[name]}" for name in want)
    if wrong:
        words += f"; (found, injected) {wrong}"
    words += f"; {strangers} of {looked_at} points misplaced"
    return Measured(words, not wrong and strangers == 0 and looked_at > 0)


def _measure(setting: Setting) -> Measured:
    folder = setting.out / "accept" / "faults"
    folder.mkdir(parents=True, exist_ok=True)
    clean, faulty = folder / "clean.pcap", folder / "faulty.pcap"
    simulator = binary(setting.build, "simulator")
    if not is_newer(clean, simulator):
        (folder / "yard.yaml").write_text(WORLD)
        command = [simulator, "--world", folder / "yard.yaml", "--quiet"]
        subprocess.run(
            [str(c) for c in (*command, "--duration", SECONDS, "--out", clean)], check=True
        )
    packets = count_packets(clean)
    if packets * PACKET_S < SECONDS - 1:
        raise RuntimeError(f"the capture has {packets} packets only")
    done = inject(clean, faulty, packets)
    (folder / "faults.csv").write_text("".join(f"{n},{kind}\n" for n, kind in done.log))
    measured = compare(setting, clean, faulty, done)
    faulty.unlink()
    return measured


def checks(setting: Setting) -> list[Check]:
    return [
        Check(
            "driver-faults",
            f"simulated capture of {SECONDS // 60} minutes: 5 % lost, 1 % late, 1 % doubled, two "
            "steps of the clock",
            "counters as injected, no point misplaced",
            "make accept ONLY=driver-faults",
            lambda: _measure(setting),
        )
    ]
