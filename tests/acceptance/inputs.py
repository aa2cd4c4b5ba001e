"""Checks of users' data and of what networks do to them (issue 37, C to E): late and truncated
times, clocks that are set, other capture formats, folders of scans. The generators beside the
recordings inject the faults."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tests.acceptance.faults import RECORD
from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import Setting, is_newer
from zloam_monitor.chain import binary

SECONDS, SEED = 24, 3
#: The sensor's stamps are whole microseconds.
TIME_LIMIT_S = 2e-6
STALL_ATE_M = 0.02
#: ways in which the recording host stamped packets; the times between points are the sensor's in
#: all of them
ARRIVALS = ("stall_burst", "host_back_30", "no_time", "one_time")
#: ways in which the capture was written; no point is lost in any of them
FORMATS = ("ng_two_snaplens", "ng_unused_other_link", "fragments", "sensor_new_address")
#: folder -> number of its sweeps, or words of the refusal
FOLDERS: dict[str, int | str] = {
    "unpadded": 80,
    "macos": 80,
    "empty_one": 80,
    "cut_one": 80,
    "nan": 80,
    "by_azimuth": "ring by ring",
    "millimetres": "metres",
}


@dataclass(frozen=True)
class Decoded:
    """The result of zloam-decode on a source."""

    code: int
    summary: dict[str, int]
    said: str
    #: time of each point, ns
    times_ns: np.ndarray[tuple[int], np.dtype[np.int64]]


def _decoded(setting: Setting, kind: str, path: Path, folder: Path) -> Decoded:
    points = folder / "points.bin"
    done = subprocess.run(
        [binary(setting.build, "decode"), kind, path, "--out", points],
        capture_output=True,
        text=True,
        check=False,
    )
    summary = json.loads(done.stdout) if done.returncode == 0 else {}
    times = np.fromfile(points, RECORD)["time_ns"].astype(np.int64)
    points.unlink()
    return Decoded(done.returncode, summary, done.stderr, times)


def _generated(setting: Setting, generator: str, *arguments: object) -> None:
    script = setting.recording(f"cases/{generator}")
    done = subprocess.run(
        [sys.executable, str(script), *map(str, arguments)], capture_output=True, text=True
    )
    if done.returncode != 0:
        raise RuntimeError(f"{script}: {done.stderr[-300:]}")


def _base(setting: Setting) -> tuple[Path, Path, Path]:
    """Capture, truth, and the folder for everything made from them."""
    folder = setting.out / "accept" / "inputs"
    folder.mkdir(parents=True, exist_ok=True)
    capture, truth = folder / "base.pcap", folder / "base.tum"
    simulator = binary(setting.build, "simulator")
    if not is_newer(capture, simulator):
        command = [simulator, "--world", "city", "--seed", SEED, "--quiet"]
        command += ["--duration", SECONDS, "--truth", truth, "--out", capture]
        subprocess.run([str(c) for c in command], check=True)
    return capture, truth, folder


def _case(setting: Setting, name: str) -> Path:
    capture, _, folder = _base(setting)
    _generated(setting, "captures.py", capture, folder, name)
    return next(folder.glob(f"{name}.pcap*"))


def _compared(setting: Setting, name: str) -> tuple[Decoded, Decoded]:
    capture, _, folder = _base(setting)
    made = _case(setting, name)
    if made.read_bytes() == capture.read_bytes():
        raise RuntimeError(f"the generator changed nothing for {name}")
    plain = _decoded(setting, "--pcap", capture, folder)
    found = _decoded(setting, "--pcap", made, folder)
    made.unlink()
    if found.code != 0:
        raise RuntimeError(found.said)
    return plain, found


def _time(setting: Setting, name: str) -> Measured:
    plain, found = _compared(setting, name)
    if len(found.times_ns) != len(plain.times_ns):
        return Measured(f"{len(found.times_ns)} of {len(plain.times_ns)} points", False)
    apart = (found.times_ns - found.times_ns[0]) - (plain.times_ns - plain.times_ns[0])
    worst_s = float(np.abs(apart).max()) * 1e-9
    ascending = bool((np.diff(found.times_ns) >= 0).all())
    steps = found.summary["host_clock_steps"]
    figure = f"{worst_s * 1e6:.1f} us, {'ascending' if ascending else 'NOT ascending'}"
    return Measured(f"{figure}, {steps} steps of the host", worst_s <= TIME_LIMIT_S and ascending)


def _points(setting: Setting, name: str) -> Measured:
    plain, found = _compared(setting, name)
    lost = len(plain.times_ns) - len(found.times_ns)
    return Measured(f"{lost} of {len(plain.times_ns)} points lost", lost == 0)


def _stall(setting: Setting) -> Measured:
    _, truth, _ = _base(setting)
    demo = setting.demo("stall_burst", "--pcap", _case(setting, "stall_burst"), "--truth", truth)
    ate_m = demo.pose_errors()["ate_rmse_m"]
    return Measured(f"{ate_m:.3f} m", ate_m < STALL_ATE_M)


def _folder(setting: Setting, name: str) -> Measured:
    archive = setting.recording("data/hdl64e_drive/velodyne.tar.xz")
    _, _, folder = _base(setting)
    if not (folder / "velodyne").is_dir():
        subprocess.run(["tar", "-xJf", str(archive), "-C", str(folder)], check=True)
    if not (folder / "kitti").is_dir():
        _generated(setting, "kitti_folders.py", folder / "velodyne", folder / "kitti")
    if not (folder / "kitti" / name).is_dir():
        raise Skip(f"the generator makes no {name}")
    found = _decoded(setting, "--kitti", folder / "kitti" / name, folder)
    expected = FOLDERS[name]
    said = found.said.strip().splitlines()
    if isinstance(expected, str):
        reason = said[0].split(": ", 2)[-1] if said else "nothing said"
        return Measured(f"exit code {found.code}: {reason}", found.code == 3 and expected in reason)
    figure = f"{found.summary.get('sweeps', 0)} sweeps; said: {said[0] if said else 'nothing'}"
    complete = found.code == 0 and found.summary["sweeps"] == expected
    return Measured(figure, complete and bool(said) == name.endswith("_one"))


def _check(
    part: str,
    name: str,
    line: str,
    limit: str,
    measure: Callable[[Setting, str], Measured],
    setting: Setting,
) -> Check:
    label = f"inputs-{name.replace('_', '-')}"
    command = f"make accept ONLY={label}"
    return Check(label, line, limit, command, partial(measure, setting, name), part)


def checks(setting: Setting) -> list[Check]:
    """All checks, in the order of the issue."""
    times = "times between points as the sensor says, to 2 us"
    lines = [_check("C", n, f"capture {n}", times, _time, setting) for n in ARRIVALS]
    lines.append(
        Check(
            "inputs-stall",
            "packets of 0.8 s that arrive late together, through the chain",
            f"ATE < {STALL_ATE_M} m",
            "make accept ONLY=inputs-stall",
            lambda: _stall(setting),
            "C",
        )
    )
    lines += [_check("D", n, f"capture {n}", "no point lost", _points, setting) for n in FORMATS]
    for name, expected in FOLDERS.items():
        refused = isinstance(expected, str)
        limit = f"refused: {expected}" if refused else f"{expected} sweeps, damage said"
        lines.append(_check("D", name, f"folder of scans {name}", limit, _folder, setting))
    return lines
