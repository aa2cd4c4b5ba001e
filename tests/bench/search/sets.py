"""Named drives with a truth, created once and kept outside the repository.

The name describes the drive: `hand5hz-911` has a world and rate of our simulator and a seed,
`city/5-307` a scene and seed of the reference generator with only every fifth scan.
"""

from __future__ import annotations

import functools
import hashlib
import lzma
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from tests.acceptance.framework import Skip
from tests.acceptance.point_files import SYNTH_POINT
from tests.bench.search import drawing
from zloam_monitor import trajectory

CACHE = Path(os.environ.get("ZLOAM_SEARCH_CACHE", Path.home() / ".cache" / "zloam-search"))
#: settings of deploy/robots/vlp16-handheld.yaml for platforms that are carried or walk
CARRIED = (
    "--set=odometry.acceleration_sigma_mps2=6",
    "--set=odometry.angular_acceleration_sigma_radps2=8",
)
TABLE, NORMAL, WORLDS, RINGLESS, SEARCH = "table", "normal", "worlds", "ringless", "search"


@dataclass(frozen=True)
class Drive:
    """Input of zloam-offline, and the true trajectory of the lidar."""

    input: Path
    #: None: the run itself writes it as truth.tum
    truth: Path | None
    #: further arguments of zloam-offline
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True)
class DataSet:
    """A drive that is created on demand."""

    name: str
    group: str
    make: Callable[[Places], Drive] = field(compare=False)
    #: The scene leaves a direction open, so Degenerate is right there.
    open_direction: bool = False


@dataclass(frozen=True)
class Places:
    """Folders of the programs and the shared files."""

    build: Path
    shared: Path

    def simulator(self) -> Path:
        found = self.build / "bin" / "zloam-simulator"
        if not found.exists():
            raise Skip(f"{found} is not built")
        return found

    def needed(self, name: str) -> Path:
        found = self.shared / name
        if not found.exists():
            raise Skip(f"{found} is missing; set ZLOAM_SHARED")
        return found


def ran(*command: object) -> str:
    """Runs a program and returns its standard output."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {done.stderr[-300:]}")
    return done.stdout


def kept(name: str, make: Callable[[Path], None]) -> Path:
    """A folder of the cache, filled by `make` and moved to its name only when complete."""
    folder = CACHE / name
    if folder.exists():
        return folder
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE) as beside:
        made = Path(beside) / "made"
        made.mkdir()
        make(made)
        if not folder.exists():
            made.rename(folder)
    return folder


def simulated(
    stem: str,
    world: str,
    seed: int,
    options: tuple[object, ...] = (),
    arguments: tuple[str, ...] = (),
    imu: bool = False,
) -> Callable[[Places], Drive]:
    """A drive in a world of the simulator; a world that ends in .yaml is one of the shared
    cases."""

    def make(places: Places) -> Drive:
        def fill(out: Path) -> None:
            where = places.needed(f"cases/worlds/{world}") if world.endswith(".yaml") else world
            files: tuple[object, ...] = (
                "--out",
                out / "capture.pcap",
                "--truth",
                out / "truth.tum",
            )
            if imu:
                files += ("--imu", out / "imu.csv")
            ran(
                *(places.simulator(), "--world", where, "--seed", seed, "--quiet"),
                *(*files, *options),
            )

        folder = kept(f"{stem}-{seed}", fill)
        more = ("--imu", str(folder / "imu.csv")) if imu else ()
        return Drive(folder / "capture.pcap", folder / "truth.tum", (*more, *arguments))

    return make


def synthetic(scene: str, seed: int, every: int = 1) -> Callable[[Places], Drive]:
    """Every n-th scan of the reference generator."""

    def make(places: Places) -> Drive:
        def fill(out: Path) -> None:
            generator = places.needed("reference/synth/synth_gen.py")
            ran(sys.executable, generator, scene, out, "--seed", seed)

        whole = kept(f"{scene}-{seed}", fill)
        if every == 1:
            return Drive(whole, whole / "gt_dense.tum")
        part = kept(f"{scene}-every{every}-{seed}", functools.partial(_every, whole, every))
        return Drive(part, part / "gt_dense.tum")

    return make


def _every(whole: Path, every: int, out: Path) -> None:
    (out / "scans").mkdir()
    stamps = (whole / "stamps.txt").read_text().splitlines()
    scans = sorted((whole / "scans").glob("*.bin"))
    for scan in scans[::every]:
        (out / "scans" / scan.name).symlink_to(scan)
    (out / "stamps.txt").write_text("\n".join(stamps[::every]) + "\n")
    shutil.copy(whole / "gt_dense.tum", out)


def changed(stem: str, case: str, base: Callable[[Places], Drive]) -> Callable[[Places], Drive]:
    """A capture modified by captures.py of the shared cases."""

    def make(places: Places) -> Drive:
        drive = base(places)

        def fill(out: Path) -> None:
            ran(sys.executable, places.needed("cases/captures.py"), drive.input, out, case)
            (out / f"{case}.pcap").rename(out / "capture.pcap")

        folder = kept(f"{stem}-{drive.input.parent.name}", fill)
        return Drive(folder / "capture.pcap", drive.truth, drive.arguments)

    return make


def own_box(stem: str, base: Callable[[Places], Drive]) -> Callable[[Places], Drive]:
    """A capture in which a flat plate of the robot, 1.3 m behind the sensor, hides 120 degrees of
    the view."""

    def make(places: Places) -> Drive:
        drive = base(places)

        def fill(out: Path) -> None:
            ran(
                *(sys.executable, "-m", "tests.bench.search.own_box"),
                *(places.needed("cases/tools.py"), drive.input, out / "capture.pcap"),
            )

        folder = kept(f"{stem}-{drive.input.parent.name}", fill)
        return Drive(folder / "capture.pcap", drive.truth, drive.arguments)

    return make


#: record of ouster_hand's clouds; coordinates in units of 4 mm
CLOUD_POINT = np.dtype([("xyz", "<i2", 3), ("intensity", "u1"), ("ring", "u1")])
CLOUD_UNIT_M = 0.004
TURN_NS = 100_000_000


def ouster_hand(places: Places) -> Drive:
    """A real walk at 2 Hz with deskewed clouds: all points refer to their cloud's stamp."""
    recording = places.needed("data/ouster_hand")

    def fill(out: Path) -> None:
        (out / "scans").mkdir()
        stamps = trajectory.read(recording / "poses.tum").stamps_ns
        with lzma.open(recording / "clouds.tar.xz") as file, tarfile.open(fileobj=file) as archive:
            # In the archive's order: going back would decompress it again from its start.
            for member in archive:
                if member.isfile():
                    cloud = np.frombuffer(archive.extractfile(member).read(), CLOUD_POINT)
                    scan = np.zeros(len(cloud), SYNTH_POINT)
                    scan["xyz"] = cloud["xyz"] * CLOUD_UNIT_M
                    scan["intensity"], scan["ring"] = cloud["intensity"], cloud["ring"]
                    scan.tofile(out / "scans" / Path(member.name).name)
        assert len(list((out / "scans").glob("*.bin"))) == len(stamps)
        # A pose refers to the end of its sweep.
        spans = [(int(s) - TURN_NS, int(s)) for s in stamps]
        texts = [" ".join(trajectory.stamp_text(s) for s in span) for span in spans]
        (out / "stamps.txt").write_text("\n".join(texts) + "\n")
        shutil.copy(recording / "poses.tum", out / "truth.tum")

    folder = kept("ouster-hand", fill)
    return Drive(folder, folder / "truth.tum", ("--deskewed", *CARRIED))


def drawn(seed: int, number: int) -> DataSet:
    """A random drive of the search, simulated when it runs."""
    description, kind = drawing.draw(seed, number)

    def make(_: Places) -> Drive:
        def fill(out: Path) -> None:
            text = yaml.safe_dump(description, sort_keys=False)
            (out / "drive.yaml").write_text(f"# {drawing.in_words(description, kind)}\n{text}")

        # The name includes a hash of the description: another version may draw another drive from
        # the same seed.
        mark = hashlib.sha256(repr(description).encode()).hexdigest()[:8]
        folder = kept(f"drive-{seed}-{number}-{mark}", fill)
        return Drive(folder / "drive.yaml", None, CARRIED if kind.carried else ())

    open_direction = description["world"] in drawing.OPEN_DIRECTION
    return DataSet(f"drive-{seed}-{number}", SEARCH, make, open_direction)


def by_name(name: str) -> DataSet | None:
    """A random drive by its name; None if the name is none of a random drive."""
    found = re.fullmatch(r"drive-(\d+)-(\d+)", name)
    return drawn(int(found[1]), int(found[2])) if found else None


def _table() -> Iterable[DataSet]:
    """The drives listed in issue 36, and similar ones."""
    for seed in (911, 912, 913, 1, 2):
        slow = ("--rpm", 300)
        yield DataSet(
            f"hand5hz-{seed}", TABLE, simulated("hand5hz", "handheld", seed, slow, CARRIED)
        )
    for seed in (307, 308):
        yield DataSet(f"fastrot/2-{seed}", TABLE, synthetic("fastrot", seed, 2))
    for world in ("swung", "legged"):
        for seed in range(1, 6):
            make = simulated(world, f"{world}.yaml", seed, (), CARRIED)
            yield DataSet(f"{world}-{seed}", TABLE, make)
    for scene in ("city", "indoor"):
        for every in (3, 5):
            for seed in (307, 308):
                yield DataSet(f"{scene}/{every}-{seed}", TABLE, synthetic(scene, seed, every))
    yield DataSet("ouster-hand", TABLE, ouster_hand)
    for seed in (911, 912, *range(1, 11)):
        make = simulated("tunnel-imu", "tunnel", seed, imu=True)
        yield DataSet(f"tunnel-imu-{seed}", TABLE, make, open_direction=True)
    for world in ("indoor", "flat"):
        base = simulated(f"sim-{world}", world, 1)
        yield DataSet(f"crowd-{world}-1", TABLE, changed("crowd", "crowd_moving_with", base))
        yield DataSet(f"box-{world}-1", TABLE, own_box("box", base))


def _normal() -> Iterable[DataSet]:
    """The drives that the algorithms were built on: none of them may become worse."""
    for scene in ("city", "indoor", "fastrot", "tunnel"):
        for seed in (307, 308):
            yield DataSet(
                f"{scene}-{seed}",
                NORMAL,
                synthetic(scene, seed),
                open_direction=scene == "tunnel",
            )


def _worlds() -> Iterable[DataSet]:
    for world in ("city", "indoor", "flat", "field", "park", "moving", "tunnel_weak"):
        yield DataSet(f"sim-{world}-1", WORLDS, simulated(f"sim-{world}", world, 1))
    yield DataSet("sim-handheld-1", WORLDS, simulated("sim-handheld", "handheld", 1, (), CARRIED))


#: lidars with and without rings; each drives the same drives
LIDARS: dict[str, dict[str, object]] = {
    "vlp16": {},
    "no-rings": {"has_rings": False},
    "mid360": {"pattern": "mid360"},
    "hap": {"pattern": "hap"},
    # like the rosettes, a view of 120 degrees ahead only, but with rings
    "ahead": {"view_deg": 120.0},
}


def described(name: str, description: dict[str, object]) -> Callable[[Places], Drive]:
    """A drive given by its description, cast when it runs."""

    def make(_: Places) -> Drive:
        def fill(out: Path) -> None:
            (out / "drive.yaml").write_text(yaml.safe_dump(description, sort_keys=False))

        mark = hashlib.sha256(repr(description).encode()).hexdigest()[:8]
        return Drive(kept(f"{name}-{mark}", fill) / "drive.yaml", None)

    return make


def _ringless() -> Iterable[DataSet]:
    """Sweeps without rings, and a VLP-16's in the same worlds."""
    for world in ("indoor", "city"):
        for seed in (1, 2, 3):
            for lidar, settings in LIDARS.items():
                name = f"{lidar}-{world}-{seed}"
                drive: dict[str, object] = {"seed": seed, "world": world, "world_seed": seed}
                drive |= {"duration_s": 40.0, "lidar": settings}
                yield DataSet(name, RINGLESS, described(name, drive))


def all_sets() -> list[DataSet]:
    """All named drives, in the order of the report."""
    return [*_table(), *_normal(), *_worlds(), *_ringless()]
