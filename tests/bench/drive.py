"""The recorded drive, which has no truth but two references that were made without deskewing.

`consistency-drive`: does each path agree with the drive's own scans (consistency.py)? References,
our path and the peers' are judged alike. A path that may be made without deskewing is compared with
the raw and with the deskewed scans, and the better figure counts.

`deskewed-drive`: where do the peers end up with scans deskewed by their own velocities? A peer runs
over the raw scans, the scans are deskewed by its path, the peer runs again, and so on. Nothing of
ours is involved.
"""

from __future__ import annotations

import functools
import itertools
import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.acceptance.framework import Skip
from tests.bench import consistency
from tests.bench.consistency import Array, Misfit
from tests.bench.framework import Benchmark, Outcome
from tests.bench.setting import BenchSetting
from tests.bench.versus import data, peer, systems
from tests.bench.versus.data import Scans
from zloam_monitor import evaluation, trajectory
from zloam_monitor.trajectory import Trajectory

CONSISTENCY, DESKEWED = "consistency-drive", "deskewed-drive"
#: every fifth sweep, from the first one that has a whole map before it
FIRST, EVERY = consistency.GAP_SWEEPS + consistency.MAP_SWEEPS, 5
#: limit of our figure, as a share of the best other path's
CONSISTENCY_LIMIT = 0.5
#: m; limit of issue 7 against the references
DESKEWED_ATE_M = 0.08
#: Number of times that a peer's scans are deskewed by its previous path; a third pass changes 1 mm.
PASSES = 2
#: Part of the sweep that a pose refers to if the scans have no times: when the sensor looks ahead.
MIDDLE = evaluation.SWEEP_PART_OF_REFERENCE
PERIOD_S = data.PERIOD_S


class DriveScans:
    """Scans in KITTI's layout; times as the drive's sensor rotates: clockwise from the rear
    (hdl64e.yaml)."""

    def __init__(self, scans: Scans, deskewed: bool) -> None:
        self._files = peer.Data.at(scans.folder).files
        self._deskewed = deskewed

    def __len__(self) -> int:
        return len(self._files)

    def __call__(self, sweep: int) -> tuple[Array, Array]:
        points = peer.untimed_points(self._files[sweep])
        part = np.full(len(points), MIDDLE)
        if self._deskewed:
            part = (np.pi - np.arctan2(points[:, 1], points[:, 0])) / (2 * np.pi)
        return points, (sweep + part) * PERIOD_S


def misfits(scans: Scans, transforms: Array, part: float, deskewed: bool) -> list[Misfit]:
    """The corrections of a path whose poses refer to this part of their sweeps."""
    times_s = (np.arange(len(transforms), dtype=np.float64) + part) * PERIOD_S
    path, scan = consistency.Path(transforms, times_s), DriveScans(scans, deskewed)
    return [
        consistency.misfit(scan, path, sweep, PERIOD_S)
        for sweep in range(FIRST, min(len(scan), len(transforms)), EVERY)
    ]


def _kinder(scans: Scans, transforms: Array) -> list[Misfit]:
    """The smaller corrections of those with raw and with deskewed scans, for a path of which it is
    not known whether it was deskewed."""
    both = [misfits(scans, transforms, MIDDLE, deskewed) for deskewed in (False, True)]
    return min(both, key=consistency.rms_m)


def _references(setting: BenchSetting) -> Iterator[tuple[str, Array]]:
    for file in sorted(setting.recording("data/hdl64e_drive").glob("reference_*.txt")):
        name = file.name.removesuffix(".kitti.txt").replace("_", " ")
        yield name, trajectory.read(file).transforms


class _Drive:
    """The raw scans and the poses of each system, which runs once."""

    def __init__(self, setting: BenchSetting) -> None:
        self.setting, self.out = setting, setting.out / "drive"
        self._poses: dict[str, Array] = {}

    @functools.cached_property
    def scans(self) -> Scans:
        self.out.mkdir(parents=True, exist_ok=True)
        return data.chosen(data.all_sets(self.setting), "drive")[0].get()

    def ours(self) -> Array:
        if systems.OURS not in self._poses:
            found = systems.run_ours(self.setting, self.scans, self.out)
            self._poses[systems.OURS] = found.scored.trajectory.transforms
        return self._poses[systems.OURS]

    def peers(self) -> Iterator[tuple[str, Array]]:
        for name in systems.PEERS:
            try:
                if name not in self._poses:
                    self._poses[name] = _peer_over(name, self.scans, self.out)
                yield name, self._poses[name]
            except Skip as skip:
                print(f"  {name}: {skip}", flush=True)


def _peer_over(name: str, scans: Scans, out: Path) -> Array:
    return systems.run_peer(name, scans, out).scored.trajectory.transforms


def _consistency(drive: _Drive) -> Outcome:
    found = {systems.OURS: misfits(drive.scans, drive.ours(), 1.0, deskewed=True)}
    for name, transforms in itertools.chain(_references(drive.setting), drive.peers()):
        found[name] = _kinder(drive.scans, transforms)
        print(f"  {name}: {consistency.rms_m(found[name]):.4f} m", flush=True)
    return _judged(found)


def _judged(found: dict[str, list[Misfit]]) -> Outcome:
    rms_m = {name: consistency.rms_m(of) for name, of in found.items()}
    best_other_m = min(m for name, m in rms_m.items() if name != systems.OURS)
    way_m = np.mean([m.travelled_m for m in found[systems.OURS]])
    words = ", ".join(f"{name} {m:.3f}" for name, m in rms_m.items())
    return Outcome(
        f"{words} m over {way_m:.1f} m of way",
        {
            "rms_m": rms_m,
            "ahead_m": {
                name: {m.sweep: round(m.ahead_m, 4) for m in of} for name, of in found.items()
            },
        },
        rms_m[systems.OURS] <= CONSISTENCY_LIMIT * best_other_m,
    )


def write_deskewed(scans: Scans, transforms: Array, out: Path) -> Scans:
    """Writes each scan as seen at the middle of its sweep, by a path through poses that refer to
    the middles."""
    scan = DriveScans(scans, deskewed=True)
    middles = (np.arange(len(scan), dtype=np.float64) + MIDDLE) * PERIOD_S
    path = consistency.Path(transforms, middles)
    positions, rotations = path.at(middles)
    (out / "scans").mkdir(parents=True)
    for sweep in range(len(scan)):
        seen = (path.moved(*scan(sweep)) - positions[sweep]) @ rotations[sweep]
        rows = np.hstack([seen, np.zeros((len(seen), 1))]).astype("<f4")
        rows.tofile(out / "scans" / f"{sweep:06d}.bin")
    meta = json.loads((scans.folder / "meta.json").read_text()) | {"scans_in": "scans"}
    (out / "meta.json").write_text(json.dumps(meta) + "\n")
    return replace(scans, folder=out)


def _deskewed_by_itself(name: str, transforms: Array, scans: Scans, out: Path) -> Array:
    for _ in range(PASSES):
        with tempfile.TemporaryDirectory(dir=out) as place:
            again = write_deskewed(scans, transforms, Path(place) / "drive-deskewed")
            transforms = _peer_over(name, again, out)
    return transforms


def _ate_m(transforms: Array, truth: Array) -> float:
    numbers = np.arange(len(truth), dtype=np.int64)
    of = [Trajectory(poses, None, numbers) for poses in (transforms, truth)]
    ate_m = evaluation.evaluate(*of).ate_rmse_m
    assert ate_m is not None
    return ate_m


def at_middles(transforms: Array) -> Array:
    """Moves poses from the sweeps' ends back to their middles."""
    ends = np.arange(1, len(transforms) + 1, dtype=np.float64) * PERIOD_S
    out = np.array(transforms)
    out[:, :3, 3], out[:, :3, :3] = consistency.Path(transforms, ends).at(ends - MIDDLE * PERIOD_S)
    return out


def _deskewed(drive: _Drive) -> Outcome:
    compared = {systems.OURS: at_middles(drive.ours()), **dict(_references(drive.setting))}
    ate_m: dict[str, dict[str, float]] = {}
    for name, transforms in drive.peers():
        truth = _deskewed_by_itself(name, transforms, drive.scans, drive.out)
        ate_m[name] = {other: _ate_m(poses, truth) for other, poses in compared.items()}
        words = ", ".join(f"{other} {m:.4f}" for other, m in ate_m[name].items())
        print(f"  {name}: {words} m", flush=True)
    if not ate_m:
        raise Skip("no peer can be run here")
    ranges = {name: [of[name] for of in ate_m.values()] for name in compared}
    said = ", ".join(f"{name} {min(m):.3f} to {max(m):.3f}" for name, m in ranges.items())
    held = max(ranges[systems.OURS]) <= DESKEWED_ATE_M
    return Outcome(f"{said} m from {len(ate_m)} peers that deskew", {"ate_m": ate_m}, held)


def benchmarks(setting: BenchSetting) -> list[Benchmark]:
    drive = _Drive(setting)
    return [
        Benchmark(
            CONSISTENCY,
            "the recorded drive: what correction its own scans, 2 s apart, ask of each path",
            functools.partial(_consistency, drive),
            f"≤ {CONSISTENCY_LIMIT} × any other's",
        ),
        Benchmark(
            DESKEWED,
            "the recorded drive: ATE of ours against peers whose scans their own path deskewed",
            functools.partial(_deskewed, drive),
            f"≤ {DESKEWED_ATE_M} m",
        ),
    ]
