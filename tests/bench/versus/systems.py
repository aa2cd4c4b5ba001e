"""Runs a system over a data set once: what it gave and what it took."""

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
#: its stages (services/aloam) in the place of ours
ALOAM = "a-loam"
PEERS = tuple(peer_program.PEERS)
SYSTEMS = (OURS, ALOAM, *PEERS)
#: what a chain of processes adds to the demo's command line. A-LOAM's result is the mapped pose,
#: and without the delay the fused pose is that
CHAINS: dict[str, tuple[str, ...]] = {
    OURS: (),
    ALOAM: ("--method", "aloam", "--set", "integration.correction_delay=0"),
}
#: configurations that the demo takes: for scans with times, and for KITTI's
ROBOTS = ("vlp16-outdoor", "hdl64e")
KEPT = CACHE / "peers" / "results"
PEER = ROOT / "tests/bench/versus/peer.py"


@dataclass(frozen=True)
class Taken:
    """One run of one system."""

    scored: Scored
    version: str
    sweeps: int
    #: None when the run was kept from another day: a cost counts within its own session only
    cpu_ms_per_sweep: float | None
    rss_mib: float | None
    more: dict[str, Any] = field(default_factory=dict)


@functools.cache
def peers_python() -> Path:
    """The interpreter that has the peers; installs them the first time."""
    done = subprocess.run(
        [str(ROOT / "deploy/build/peers.sh")], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise Skip(f"the peers can't be installed: {' '.join(done.stderr.split())[-200:]}")
    return Path(done.stdout.strip().splitlines()[-1])


@functools.cache
def version_of(name: str) -> str:
    """Of the installed peer; without one there is nothing to run."""
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
    """Theirs is another Python: of ours it finds this tree, without what is installed beside it."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_WAIT_POLICY": "passive"}


def run_peer(name: str, scans: Scans, out: Path) -> Taken:
    """In a process of its own; its result is kept for days on which only errors are wanted."""
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
    """Named by all that decides a peer's trajectory."""
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
    """Our own stages."""
    return run_chain(OURS, setting, scans, out)


def run_chain(system: str, setting: BenchSetting, scans: Scans, out: Path) -> Taken:
    """The chain of processes on the same scans, with the configuration that fits the sensor."""
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
    """What every system left in this folder, for the picture."""
    found = {}
    for system in CHAINS:
        if (out / system / "trajectory.tum").exists():
            found[system] = _of_chain(out / system, scans).trajectory
    for name in PEERS:
        if (out / f"{name}.npz").exists():
            found[name] = _of_file(out / f"{name}.npz", scans).scored.trajectory
    return found


def T_base_lidar(scans: Scans) -> Any:
    """Of the configuration that the demo takes for the scans: truth is the sensor's."""
    robot = ROBOTS[scans.demo[0] == "--kitti"]
    text = (ROOT / "deploy/robots" / f"{robot}.yaml").read_text()
    mounting = yaml.safe_load(text)["mounting"]
    return se3.from_xyz_rpy_deg(mounting["xyz_m"], mounting["rpy_deg"])


@functools.cache
def programs(build: Path) -> str:
    """What of ours is measured: the bytes of the programs and their configuration."""
    digest = hashlib.sha256()
    for program in (*STAGES, *methods.programs("aloam").values()):
        digest.update(binary(build, program).read_bytes())
    for robot in ROBOTS:
        digest.update((ROOT / f"deploy/robots/{robot}.yaml").read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def commit() -> str:
    """For the reader; with a mark when the tree differs from it."""
    done = subprocess.run(
        ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=9"],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or "unknown"
