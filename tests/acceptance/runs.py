"""Runs that several checks use: made once and kept for the rest of the session."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dpkt
import numpy as np
from numpy.typing import NDArray

from tests.acceptance.framework import Skip
from zloam_monitor.chain import Chain

ROOT = Path(__file__).resolve().parents[2]
CACHE = Path.home() / ".cache" / "zenoh-loam"
SYNTH_SEED = 7
#: Least share of the poses that must have a truth: of the others no error is known. One or two at
#: the ends of a drive may have none.
LEAST_MATCHED = 0.98


def own_outputs(out: Path) -> list[str]:
    """Settings by which a chain writes into this folder, emptied before: in the stages' default
    folder they would find, and go on with, what an earlier run left."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    return [f"integration.output_dir={out}", f"mapping.map_path={out / 'map.pcd'}"]


def ended_well(chain: Chain) -> dict[str, int]:
    """Ends the stages of a chain; refuses the results of one of which a stage died or failed."""
    codes = chain.stop()
    if any(codes.values()):
        raise RuntimeError(f"the stages ended with {codes}")
    return codes


def is_newer(made: Path, *than: Path) -> bool:
    """Whether a file is there and as new as what it was made from or by. Files of an earlier build
    are made again: otherwise the worlds of an older simulator would be judged."""
    if not made.exists():
        return False
    return all(made.stat().st_mtime >= each.stat().st_mtime for each in than if each.exists())


@dataclass
class Demo:
    """A demo that has ended."""

    code: int
    said: str
    out: Path

    @property
    def results(self) -> Path:
        """Folder with the files of a demo that ended well. Those of another may be of a part of the
        drive, on which any limit is held easily."""
        if self.code != 0:
            raise RuntimeError(f"exit code {self.code}: {self.last_words()}")
        return self.out

    @property
    def report(self) -> dict[str, Any]:
        path = self.results / "report.json"
        if not path.exists():
            raise RuntimeError(f"the demo left no report: {self.last_words()}")
        found: dict[str, Any] = json.loads(path.read_text())
        return found

    def pose_errors(self, reference: str | None = None) -> dict[str, float]:
        """Errors of the fused pose against this reference, or against the only one."""
        known = self.report["references"]
        name = reference or next(iter(known), "no reference")
        if len(known) != 1 and reference is None:
            raise RuntimeError(f"{len(known)} references where one is expected")
        found: dict[str, Any] = known[name]["pose"]
        check_matched(found["matched"], found["poses"], name)
        return found

    def last_words(self) -> str:
        lines = [line for line in self.said.splitlines() if line.strip()]
        return " / ".join(lines[-3:])


def check_matched(matched: int, poses: int, reference: str) -> None:
    """Refuses errors that are of a part of the poses only."""
    if matched < LEAST_MATCHED * poses or not matched:
        raise RuntimeError(f"only {matched} of {poses} poses have a truth in {reference}")


@dataclass
class Setting:
    """The folders, and runs that are made only once."""

    build: Path
    out: Path
    shared: Path
    _demos: dict[str, Demo] = field(default_factory=dict)

    @classmethod
    def here(cls, build: Path, out: Path) -> Setting:
        shared = Path(os.environ.get("ZLOAM_SHARED", ROOT.parent / "shared"))
        return cls(build.resolve(), out.resolve(), shared)

    def recording(self, name: str) -> Path:
        """A path below the folder of recordings, which is not in the repository."""
        path = self.shared / name
        if not path.exists():
            raise Skip(f"{path} is missing; set ZLOAM_SHARED")
        return path

    def python(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        """Runs this Python from the root of the repository."""
        paths = os.pathsep.join([str(ROOT / "services/monitor/src"), str(ROOT)])
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=ROOT,
            env={
                **os.environ,
                "PYTHONPATH": paths,
                "ZLOAM_BUILD": str(self.build),
                "ZLOAM_FREE_PORTS": "1",
            },
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )

    def kiss(self, *arguments: object) -> dict[str, Any]:
        """The summary of a run of KISS-ICP (tests/acceptance/kiss.py)."""
        done = self.python("-m", "tests.acceptance.kiss", *arguments)
        if done.returncode != 0:
            said = f"KISS-ICP did not run: {done.stdout.strip()[-200:]}"
            # Only where it is not installed: it may also fail because of the sweeps that it got.
            missing = "No module named 'kiss_icp" in said
            raise Skip(said) if missing else RuntimeError(said)
        found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        return found

    def demo(self, name: str, *arguments: object) -> Demo:
        """Runs `make demo` with these options, once; its log lies beside its files."""
        if name not in self._demos:
            out = self.out / "accept" / name
            # A demo that is refused would leave the files of an earlier one, also of another build.
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir(parents=True)
            done = self.python(
                "-m", "zloam_monitor", "demo", "--preset-dir", self.build, "--out", out, *arguments
            )
            (out / "demo.log").write_text(done.stdout)
            self._demos[name] = Demo(done.returncode, done.stdout, out)
        return self._demos[name]

    def simulated(self, world: str, seed: int) -> tuple[Path, Path]:
        """Capture and true lidar trajectory of a world (a name or a .yaml file), simulated once by
        each build."""
        folder = self.out / "accept" / "worlds"
        folder.mkdir(parents=True, exist_ok=True)
        stem = f"{Path(world).stem}-{seed}"
        capture, truth = folder / f"{stem}.pcap", folder / f"{stem}.tum"
        simulator = self.build / "bin" / "zloam-simulator"
        if not simulator.exists():
            raise Skip(f"{simulator} is not built")
        of = (simulator, ROOT / world) if world.endswith(".yaml") else (simulator,)
        if not all(is_newer(made, *of) for made in (capture, truth, _readings(capture))):
            files = ["--out", str(capture), "--truth", str(truth)]
            files += ["--imu", str(_readings(capture))]
            subprocess.run(
                [str(simulator), "--world", world, "--seed", str(seed), *files],
                cwd=ROOT,
                check=True,
                capture_output=True,
            )
        return capture, truth

    def world(self, world: str, seed: int, *, imu: bool = False, late_ms: float = 0.0) -> Demo:
        """A simulated world's packets through the chain; with `imu` also the simulated IMU's
        readings, with stamps late by `late_ms`."""
        capture, truth = self.simulated(world, seed)
        name = f"world-{Path(world).stem}-{seed}" + ("-imu" if imu else "")
        readings = ["--imu", _readings(capture)] if imu else []
        if late_ms:
            name += f"-late-{late_ms:g}"
            readings += ["--set", f"driver.imu_delay_ms={-late_ms}"]
        return self.demo(name, "--pcap", capture, "--truth", truth, *readings)

    def city(self) -> Demo:
        return self.demo("city")

    def capture(self) -> Path:
        """The packets of the simulated city loop."""
        capture = self.city().out / "capture.pcap"
        if not capture.exists():
            raise RuntimeError(f"no capture: {self.city().last_words()}")
        return capture

    def kitti(self) -> Demo:
        return self.demo("kitti", "--kitti", self.recording("data/hdl64e_drive"))

    def synth_folder(self, scene: str = "city") -> Path:
        """Scans of the reference generator; made once (takes minutes), kept in the cache."""
        folder = CACHE / "synth" / f"{scene}-{SYNTH_SEED}"
        if not (folder / "gt_dense.tum").exists():
            generator = self.recording("reference/synth/synth_gen.py")
            done = self.python(generator, scene, folder, "--seed", SYNTH_SEED)
            if done.returncode != 0:
                raise RuntimeError(f"{generator.name} failed: {done.stdout[-300:]}")
        return folder

    def synth(self) -> Demo:
        return self.demo("synth", "--scans", self.synth_folder())


def _readings(capture: Path) -> Path:
    """The simulated IMU's readings that belong to a capture."""
    return capture.with_suffix(".imu.csv")


def write_later_part(capture: Path, out: Path, after_s: float) -> None:
    """Writes the packets from `after_s` after the first one on to another pcap."""
    part = out.with_suffix(".part")
    with capture.open("rb") as source, part.open("wb") as sink:
        later = dpkt.pcap.Writer(sink)
        began_s = None
        for stamp_s, packet in dpkt.pcap.Reader(source):
            began_s = stamp_s if began_s is None else began_s
            if stamp_s - began_s >= after_s:
                later.writepkt(packet, stamp_s)
    part.replace(out)


def said_of_poses(demo: Demo) -> NDArray[Any]:
    """poses.csv of a run, by column name."""
    return np.genfromtxt(demo.results / "poses.csv", delimiter=",", names=True)
