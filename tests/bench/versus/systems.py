"""Runs one system over a data set: its trajectory and its cost."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tests.acceptance.checks import ALGORITHMS
from tests.acceptance.framework import Skip
from tests.acceptance.runs import CACHE, ROOT
from tests.bench.setting import BenchSetting
from tests.bench.versus import peer as peer_program
from tests.bench.versus import score
from tests.bench.versus.data import Scans
from tests.bench.versus.score import Scored
from zloam_monitor import methods, se3, trajectory
from zloam_monitor.chain import binary
from zloam_monitor.stages import STAGES
from zloam_monitor.trajectory import Trajectory

OURS = "zloam"
#: the stages of services/aloam instead of ours
ALOAM = "a-loam"
PEERS = tuple(peer_program.PEERS)
SYSTEMS = (OURS, ALOAM, *PEERS)
#: Additional arguments of the demo for each chain of processes. A-LOAM's result is the mapped pose,
#: which the fused pose equals if the correction has no delay.
CHAINS: dict[str, tuple[str, ...]] = {
    OURS: (),
    ALOAM: ("--method", "aloam", "--set", "integration.correction_delay=0"),
}
#: the robot files for scans with times, and for KITTI's
ROBOTS = ("vlp16-outdoor", "hdl64e")
KEPT = CACHE / "peers" / "results"
PEER = ROOT / "tests/bench/versus/peer.py"


@dataclass(frozen=True)
class Taken:
    """One run of one system."""

    scored: Scored
    version: str
    sweeps: int
    #: None for a cached run: costs are comparable only within one session
    cpu_ms_per_sweep: float | None
    rss_mib: float | None
    more: dict[str, Any] = field(default_factory=dict)


@functools.cache
def peers_python() -> Path:
    """The interpreter of the peers' virtual environment, which is installed on first use."""
    done = subprocess.run(
        [str(ROOT / "deploy/build/peers.sh")], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise Skip(f"the peers can't be installed: {' '.join(done.stderr.split())[-200:]}")
    return Path(done.stdout.strip().splitlines()[-1])


@functools.cache
def version_of(name: str) -> str:
    """Version of the installed peer; skips if it cannot be installed."""
    package = peer_program.PEERS[name].package  # type: ignore[attr-defined]
    said = f"import importlib.metadata as m; print(m.version('{package}'))"
    done = subprocess.run(
        [str(peers_python()), "-c", said], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        log = peers_python().parents[1] / f"{package}.log"
        why = log.read_text().strip().splitlines()[-1:] if log.exists() else []
        raise Skip(f"{package} is not installed ({' '.join(why)[:120] or 'no build log'})")
    return done.stdout.strip()


def peers_environment() -> dict[str, str]:
    """The environment for the peers' own Python: it finds this tree, but not the packages of our
    environment."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_WAIT_POLICY": "passive"}


def run_peer(name: str, scans: Scans, out: Path) -> Taken:
    """Runs a peer in a process of its own; its result is cached for runs that need only errors."""
    version = version_of(name)
    result = out / f"{name}.npz"
    with (out / f"{name}.log").open("w") as log:
        done = subprocess.run(
            [str(peers_python()), str(PEER), name, str(scans.folder), str(result)],
            stdout=log,
            stderr=subprocess.STDOUT,
            env=peers_environment(),
            check=False,
        )
    if done.returncode != 0:
        said = (out / f"{name}.log").read_text().strip().splitlines()[-1:]
        raise RuntimeError(f"{name} ended with {done.returncode}: {' '.join(said)[:200]}")
    kept = kept_file(name, version, scans)
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.with_suffix(".part").write_bytes(result.read_bytes())
    kept.with_suffix(".part").replace(kept)
    return _of_file(result, scans)


def kept_peer(name: str, scans: Scans) -> Taken:
    """The errors of an earlier run with the same version, settings and scans."""
    kept = kept_file(name, version_of(name), scans)
    if not kept.exists():
        raise Skip(f"no kept result of {name}")
    found = _of_file(kept, scans)
    return Taken(found.scored, found.version, found.sweeps, None, None, {"kept": True})


def kept_file(name: str, version: str, scans: Scans) -> Path:
    """Cached result of a peer; the name is a hash of everything that determines its trajectory."""
    digest = hashlib.sha256(PEER.read_bytes())
    digest.update(version.encode())
    meta = json.loads((scans.folder / "meta.json").read_text())
    digest.update(json.dumps(meta, sort_keys=True).encode())
    files = peer_program.Data.at(scans.folder).files
    for file in (files[0], files[-1]):
        digest.update(file.read_bytes())
    return KEPT / f"{scans.folder.name}-{name}-{digest.hexdigest()[:16]}.npz"


def _of_file(path: Path, scans: Scans) -> Taken:
    with np.load(path) as found:
        poses, cpu_ms, facts = found["poses"], found["cpu_ms"], json.loads(str(found["facts"]))
    scored = score.by_scan(poses, scans.starts_ns, scans.period_ns, scans.truth)
    more = {"rss_before_first_sweep_mib": facts["rss_before_mib"], "settings": facts["settings"]}
    cpu = float(np.mean(cpu_ms))
    return Taken(scored, facts["version"], len(poses), cpu, facts["rss_mib"], more)


def run_ours(setting: BenchSetting, scans: Scans, out: Path) -> Taken:
    """Runs our own stages."""
    return run_chain(OURS, setting, scans, out)


def run_chain(system: str, setting: BenchSetting, scans: Scans, out: Path) -> Taken:
    """Runs a chain of processes on the same scans, with the robot file that fits the sensor."""
    place = out / system
    place.mkdir(parents=True, exist_ok=True)
    arguments = ("--preset-dir", setting.build, "--out", place, *scans.demo, *CHAINS[system])
    done = setting.python("-m", "zloam_monitor", "demo", *arguments)
    (out / f"{system}.log").write_text(done.stdout)
    if done.returncode != 0:
        said = " / ".join(done.stdout.strip().splitlines()[-2:])
        raise RuntimeError(f"the chain ended with {done.returncode}: {said[:300]}")
    return _taken_by_chain(place, scans)


def _taken_by_chain(place: Path, scans: Scans) -> Taken:
    report = json.loads((place / "report.json").read_text())
    cpu, rss = report["cpu_ms_per_sweep"], report["rss_mib"]
    scored = _of_chain(place, scans)
    more = {
        "cpu_ms_by_stage": cpu,
        "cpu_all_processes_ms_per_sweep": sum(cpu.values()),
        "rss_all_processes_mib": sum(r["peak"] for r in rss.values()),
        "realtime_factor": report["realtime_factor"],
    }
    return Taken(
        scored,
        commit(),
        scored.scores.poses,
        sum(cpu[stage] for stage in ALGORITHMS),
        sum(rss[stage]["peak"] for stage in ALGORITHMS),
        more,
    )


def _of_chain(place: Path, scans: Scans) -> Scored:
    of_base = trajectory.read(place / "trajectory.tum")
    return score.stamped(of_base.carried(T_base_lidar(scans)), scans.starts_ns, scans.truth)


def last_trajectories(scans: Scans, out: Path) -> dict[str, Trajectory]:
    """The trajectories that the systems left in this folder, for the picture."""
    found = {}
    for system in CHAINS:
        if (out / system / "trajectory.tum").exists():
            found[system] = _of_chain(out / system, scans).trajectory
    for name in PEERS:
        if (out / f"{name}.npz").exists():
            found[name] = _of_file(out / f"{name}.npz", scans).scored.trajectory
    return found


def T_base_lidar(scans: Scans) -> Any:
    """The mounting in the robot file for these scans; needed as the truth is the sensor's."""
    robot = ROBOTS[scans.demo[0] == "--kitti"]
    text = (ROOT / "deploy/robots" / f"{robot}.yaml").read_text()
    mounting = yaml.safe_load(text)["mounting"]
    return se3.from_xyz_rpy_deg(mounting["xyz_m"], mounting["rpy_deg"])


@functools.cache
def programs(build: Path) -> str:
    """Hash of our measured programs and their configuration."""
    digest = hashlib.sha256()
    for program in (*STAGES, *methods.programs("aloam").values()):
        digest.update(binary(build, program).read_bytes())
    for robot in ROBOTS:
        digest.update((ROOT / f"deploy/robots/{robot}.yaml").read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def commit() -> str:
    """Commit for the report, marked if the tree differs from it."""
    done = subprocess.run(
        ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=9"],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or "unknown"
