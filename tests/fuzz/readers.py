"""Fuzzes the Python readers: each mutated input is read, or refused with its reason.

readers.py SECONDS: trajectories (TUM, KITTI, CSV), robot files (YAML) and the messages that the
monitor receives (FlatBuffers, and JSON inside them), a third of the time each.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "services/monitor/src"))

import numpy as np

from zloam_monitor import records, robot_file, trajectory
from zloam_monitor.messages import DECODE_ERRORS
from zloam_monitor.robot_file import RobotFileError
from zloam_monitor.trajectory import TrajectoryError

ROOT = Path(__file__).resolve().parents[2]
POSE = "1704067210.{i}00000000 {i}.5 -0.25 0.125 0 0 0 1"
TRAJECTORIES = (
    "\n".join(POSE.format(i=i) for i in range(6)) + "\n",
    "# timestamp tx ty tz qx qy qz qw\r\n" + "\r\n".join(POSE.format(i=i) for i in range(4)),
    "\n".join(POSE.format(i=i).replace(" ", ",") for i in range(4)),
    "\n".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(5)),
)
ROBOTS = (
    "robot: 01\nsensor:\n  name: top\n  model: VLP-16\nzenoh: {base_port: 7460, host: 0.0.0.0}\n",
    "# a robot\nrobot: 'r'\nzenoh:\n  base_port: 7500\nmapping: {every: 2}\nlist: [1, a]\n",
)
#: nesting deeper than any parser's stack
NESTED = 100_000
BITS = (b"nan", b"-inf", b"1e999", b"\x00", b"\xff", b"\xef\xbb\xbf", b"\n", b"#", b";", b"9" * 40)
TEXT_BITS = (*BITS, b"[", b"{", b": ", b"- ", b"&a", b"*a", b"!!int ", b"[" * NESTED, b"'")

HEADER = {"robot": "r", "sensor": "top", "run": 7, "sweep": 3, "instance": "d", "frame": "map"}
HEADER_TRACED = {**HEADER, "trace": [{"stage": "driver", "host": "h", "received_ns": 5}]}
IDENTITY: dict[str, Any] = {
    "translation": {"x": 1.0, "y": 2.0, "z": 3.0},
    "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}
COVARIANCE = [1e-4] * 36
VALUES = json.dumps({"mapping.every": 2, "mapping.list": [1, 2]})
INPUT = {"key": "a", "received": 3, "dropped": [{"reason": "late", "count": 2}]}


class Message(NamedTuple):
    """The function that reads a kind of message, and an example of it."""

    read: Callable[[bytes], Any]
    value: dict[str, Any]


#: schema -> message; JSON texts inside are also tried with a nesting deeper than any parser's stack
MESSAGES = {
    "map_pose": Message(
        records.map_pose,
        {"header": HEADER_TRACED, "pose_map_base": IDENTITY, "covariance": COVARIANCE},
    ),
    "odometry": Message(
        records.odometry,
        {"header": HEADER_TRACED, "pose_odom_base": IDENTITY, "covariance": COVARIANCE},
    ),
    "status": Message(
        records.status,
        {
            "stage": "mapping",
            "instance": "d",
            "inputs": [INPUT, INPUT],
            "outputs": [{"key": "b", "published": 4}],
            "latencies": [{"name": "work", "count": 3, "p50_ms": 1.5}],
            "figures": [{"name": "points", "value": 2.0}],
        },
    ),
    "map_tile": Message(
        records.tile,
        {
            "header": HEADER,
            "layer": "planes",
            "edge_m": 20.0,
            "points": [{"x": 1.0, "y": 0.0, "z": 0.0, "intensity": 9.0}] * 4,
        },
    ),
    "path": Message(
        records.path,
        {"header": HEADER, "poses": [{"instant_ns": 1, "sweep": 0, "pose": IDENTITY}] * 3},
    ),
    "config": Message(
        records.effective_config, {"stage": "mapping", "instance": "d", "values_json": VALUES}
    ),
    "config_revision": Message(
        records.config_revision, {"stage": "mapping", "rev": 1, "values_json": VALUES, "by": "d"}
    ),
    "command": Message(
        records.command_reply, {"ok": True, "message": "done", "results_json": VALUES}
    ),
}


def mutated(rng: random.Random, seed: bytes, bits: Sequence[bytes] = BITS) -> bytes:
    """A well-formed input with a few random changes."""
    data = bytearray(seed)
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(data) + 1)
        end = min(len(data), at + rng.randint(0, 12))
        data[at:end] = rng.choice(
            (b"", rng.choice(bits), rng.randbytes(3), bytes(data[at:end]) * 2)
        )
    return bytes(data)


def mutated_in_place(rng: random.Random, seed: bytes) -> bytes:
    """A FlatBuffer with a few overwritten bytes: sizes and offsets elsewhere stay valid."""
    data = bytearray(seed)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(8, len(data))
        new = rng.choice(
            (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", rng.randbytes(rng.randint(1, 8)))
        )
        data[at : at + len(new)] = new[: len(data) - at]
    return bytes(data[: rng.randrange(8, len(data))] if rng.random() < 0.1 else data)


def built(folder: Path) -> dict[str, list[bytes]]:
    """A message of each schema, made by flatc; those with JSON also with too deep nesting."""
    made: dict[str, list[bytes]] = {}
    for schema, message in MESSAGES.items():
        variants = [message.value]
        for name in message.value:
            if name.endswith("_json"):
                variants.append({**message.value, name: "[" * NESTED})
                variants.append({**message.value, name: "[1]"})
        for value in variants:
            text = folder / f"{schema}.json"
            text.write_text(json.dumps(value), encoding="utf-8")
            source = ROOT / "schemas" / f"{schema}.fbs"
            command: list[str | Path] = [
                "flatc",
                "-b",
                "-I",
                ROOT / "schemas",
                "-o",
                folder,
                source,
                text,
            ]
            subprocess.run(command, check=True)
            binary = next(p for p in folder.iterdir() if p.stem == schema and p.suffix != ".json")
            made.setdefault(schema, []).append(binary.read_bytes())
            binary.unlink()
    return made


class Counts(NamedTuple):
    read: int
    refused: int


def tried(
    seconds: float,
    make: Callable[[], bytes],
    read: Callable[[bytes], None],
    refusals: tuple[type[Exception], ...],
) -> Counts:
    """Reads inputs until the time is over; any exception but the refusals is a finding."""
    ends, done, refused = time.monotonic() + seconds, 0, 0
    while time.monotonic() < ends:
        data = make()
        try:
            read(data)
            done += 1
        except refusals:
            refused += 1
        except BaseException:
            print(f"fuzz: {data[:400]!r} ({len(data)} bytes)", file=sys.stderr)
            raise
    return Counts(done, refused)


def trajectories(rng: random.Random, folder: Path, seconds: float) -> Counts:
    path = folder / "a.tum"

    def read(data: bytes) -> None:
        path.write_bytes(data)
        found = trajectory.read(path)
        assert len(found), data
        assert np.isfinite(found.transforms).all(), data

    def make() -> bytes:
        return mutated(rng, rng.choice(TRAJECTORIES).encode())

    return tried(seconds, make, read, (TrajectoryError,))


def robot_files(rng: random.Random, folder: Path, seconds: float) -> Counts:
    path = folder / "robot.yaml"

    def read(data: bytes) -> None:
        path.write_bytes(data)
        robot_file.names(path, [])

    def make() -> bytes:
        return mutated(rng, rng.choice(ROBOTS).encode(), TEXT_BITS)

    return tried(seconds, make, read, (RobotFileError,))


def heard(rng: random.Random, folder: Path, seconds: float) -> Counts:
    seeds = built(folder)
    schema = ""

    def make() -> bytes:
        nonlocal schema
        schema = rng.choice(list(seeds))
        seed = rng.choice(seeds[schema])
        return seed if rng.random() < 0.1 else mutated_in_place(rng, seed)

    return tried(seconds, make, lambda data: MESSAGES[schema].read(data), DECODE_ERRORS)


def main(seconds: float) -> int:
    rng = random.Random(1)
    targets = {"trajectories": trajectories, "robot files": robot_files, "messages": heard}
    with tempfile.TemporaryDirectory() as folder:
        for name, target in targets.items():
            counts = target(rng, Path(folder), seconds / len(targets))
            print(f"fuzz: {name}: {counts.read} read, {counts.refused} refused")
    return 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1])))
