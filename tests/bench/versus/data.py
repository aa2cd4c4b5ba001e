"""The data sets: scans that every system gets, and the truth. Created once, kept in the cache.

`city-7`: scene and seed of the reference generator, range noise 20 mm; `city-7-s8`: 8 mm;
`city-7-turned`: see turned.py. `drive`: the recorded HDL-64E. `sim-park-1`: world and seed of our
simulator, its packets decoded to scans.
"""

from __future__ import annotations

import fnmatch
import functools
import json
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.acceptance.framework import Skip
from tests.acceptance.point_files import DECODED_POINT, SYNTH_POINT, SYNTH_TICK_NS
from tests.acceptance.runs import CACHE
from tests.bench.setting import BenchSetting
from tests.bench.versus.turned import write_turned
from zloam_monitor import sources, trajectory
from zloam_monitor.trajectory import Trajectory

SCENES = ("city", "indoor", "fastrot", "tunnel")
SEEDS = (7, 11, 23)
QUIET_SIGMA_M = 0.008
#: sweeps of the sequences with low noise: 17 s
QUIET_SCANS = 170
QUIET, TURNED = "-s8", "-turned"
WORLDS = ("city", "indoor", "handheld", "tunnel_weak", "flat", "field", "park", "moving")
WORLD_SEED = 1
#: the only data sets that `make bench` measures by default
SMALL = ("fastrot-7",)
PERIOD_S = 0.1


@dataclass(frozen=True)
class Scans:
    """A data set on disk."""

    folder: Path
    #: arguments of `zloam_monitor demo` that select the data set
    demo: tuple[str, ...]
    truth: Trajectory
    #: start of each scan; None if the truth is given by scan number
    starts_ns: NDArray[np.int64] | None
    period_ns: int = round(PERIOD_S * 1e9)
    #: systems from whose own poses the truth was made
    truth_of: tuple[str, ...] = ()


@dataclass(frozen=True)
class DataSet:
    """The name of a data set and the function that provides it."""

    name: str
    get: Callable[[], Scans] = field(compare=False)


def scene_of(name: str) -> str:
    """The scene over whose seeds medians are taken; empty for the other data sets."""
    scene, *rest = name.removesuffix(TURNED).split("-")
    if scene not in SCENES or len(rest) != 1:
        return ""
    return scene + TURNED if name.endswith(TURNED) else scene


def all_sets(setting: BenchSetting) -> list[DataSet]:
    """All data sets, in the order of the tables."""
    synth = [(scene, seed, "") for scene in SCENES for seed in SEEDS]
    synth += [(scene, SEEDS[0], QUIET) for scene in SCENES]
    found = [
        DataSet(f"{scene}-{seed}{tail}", functools.partial(_synth, setting, scene, seed, tail))
        for scene, seed, tail in synth
    ]
    found += [
        DataSet(f"{scene}-{seed}{TURNED}", functools.partial(_turned, setting, scene, seed))
        for scene in SCENES
        for seed in SEEDS
    ]
    found.append(DataSet("drive", functools.partial(_drive, setting)))
    return found + [
        DataSet(f"sim-{world}-{WORLD_SEED}", functools.partial(_simulated, setting, world))
        for world in WORLDS
    ]


def chosen(sets: list[DataSet], wanted: str) -> list[DataSet]:
    """Selects by comma-separated names or patterns; `small` and `all` stand for several data
    sets."""
    if wanted == "all":
        return sets
    patterns = SMALL if wanted == "small" else [part.strip() for part in wanted.split(",")]
    found = [s for s in sets if any(fnmatch.fnmatch(s.name, p) for p in patterns)]
    unknown = [p for p in patterns if not any(fnmatch.fnmatch(s.name, p) for s in sets)]
    if unknown:
        known = ", ".join(s.name for s in sets)
        raise SystemExit(f"no data set {', '.join(unknown)}; there are: {known}")
    return found


def _appears_whole(folder: Path, make: Callable[[Path], None]) -> None:
    """Creates the folder in a temporary place and renames it, so that an existing folder is
    complete."""
    if (folder / "meta.json").exists():
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as beside:
        made = Path(beside) / "made"
        made.mkdir()
        make(made)
        if folder.exists() and not (folder / "meta.json").exists():
            raise RuntimeError(f"{folder} is incomplete: remove it")
        if not folder.exists():
            made.rename(folder)


def _with_stamps(folder: Path) -> Scans:
    starts = [
        trajectory.parse_stamp(line.split()[0])
        for line in (folder / "stamps.txt").read_text().splitlines()
    ]
    truth = trajectory.read(folder / "gt_dense.tum")
    return Scans(folder, ("--scans", str(folder)), truth, np.array(starts, np.int64))


def _synth(setting: BenchSetting, scene: str, seed: int, tail: str) -> Scans:
    folder = CACHE / "synth" / f"{scene}-{seed}{tail}"

    def make(out: Path) -> None:
        generator = setting.recording("reference/synth/synth_gen.py")
        quiet = ("--sigma", QUIET_SIGMA_M, "--max-scans", QUIET_SCANS) if tail else ()
        done = setting.python(generator, scene, out, "--seed", seed, *quiet)
        if done.returncode != 0:
            raise RuntimeError(f"{generator.name} failed: {done.stdout[-300:]}")

    _appears_whole(folder, make)
    return _with_stamps(folder)


def _turned(setting: BenchSetting, scene: str, seed: int) -> Scans:
    folder = CACHE / "synth" / f"{scene}-{seed}{TURNED}"
    straight = _synth(setting, scene, seed, "").folder
    _appears_whole(folder, functools.partial(write_turned, straight))
    return _with_stamps(folder)


def _simulated(setting: BenchSetting, world: str) -> Scans:
    simulator = setting.build / "bin" / "zloam-simulator"
    decode = setting.build / "bin" / "zloam-decode"
    for program in (simulator, decode):
        if not program.exists():
            raise Skip(f"{program} is not built")
    folder = CACHE / "synth" / f"sim-{world}-{WORLD_SEED}"

    def make(out: Path) -> None:
        capture, points = out / "capture.pcap", out / "points.bin"
        files = ("--out", capture, "--truth", out / "gt_dense.tum")
        _ran(simulator, "--world", world, "--seed", WORLD_SEED, "--quiet", *files)
        _ran(decode, "--pcap", capture, "--seam", 0, "--out", points)
        write_scans(out, np.fromfile(points, DECODED_POINT))
        capture.unlink()
        points.unlink()

    _appears_whole(folder, make)
    return _with_stamps(folder)


def _ran(*command: object) -> None:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {done.stderr[-300:]}")


def write_scans(out: Path, points: NDArray[np.void]) -> None:
    """Writes decoded points as the folder of scans that the reference generator would write.

    The first and the last sweep are partial and left out.
    """
    (out / "scans").mkdir()
    stamps, sweeps = [], np.unique(points["sweep"])[1:-1]
    for number, sweep in enumerate(sweeps):
        of_sweep = points[points["sweep"] == sweep]
        start_ns = int(of_sweep["time_ns"].min())
        scan = np.zeros(len(of_sweep), SYNTH_POINT)
        scan["xyz"] = of_sweep["xyz"]
        scan["intensity"] = np.clip(np.round(of_sweep["intensity"]), 0, 255)
        scan["ring"] = of_sweep["ring"]
        scan["t"] = np.round((of_sweep["time_ns"] - start_ns) / SYNTH_TICK_NS)
        scan[np.argsort(scan["t"], kind="stable")].tofile(out / "scans" / f"{number:06d}.bin")
        end_ns = start_ns + round(PERIOD_S * 1e9)
        stamps.append(f"{trajectory.stamp_text(start_ns)} {trajectory.stamp_text(end_ns)}")
    (out / "stamps.txt").write_text("\n".join(stamps) + "\n")
    meta = {"rings": 16, "period": PERIOD_S, "scans": len(sweeps), "timestamps": True}
    (out / "meta.json").write_text(json.dumps(meta) + "\n")


def _drive(setting: BenchSetting) -> Scans:
    recording = setting.recording("data/hdl64e_drive")
    folder = CACHE / "synth" / "drive"

    def make(out: Path) -> None:
        source = sources.from_kitti(recording, out)
        scans = {"scans_in": str(source.path.relative_to(out))}
        meta = {"rings": 64, "period": PERIOD_S, "scans": source.sweeps, "timestamps": False}
        (out / "meta.json").write_text(json.dumps({**meta, **scans}) + "\n")

    _appears_whole(folder, make)
    # The other reference is KISS-ICP's; neither is a truth for the system that it was made with.
    truth = trajectory.read(recording / "reference_small_gicp.kitti.txt")
    demo = ("--kitti", str(recording))
    return Scans(folder, demo, truth, None, truth_of=("small-gicp",))
