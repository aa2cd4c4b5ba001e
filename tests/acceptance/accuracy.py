"""Checks of accuracy: reference scans, simulated worlds, the real drive."""

from __future__ import annotations

import functools

from tests.acceptance.framework import Check, Measured
from tests.acceptance.runs import SYNTH_SEED, Demo, Setting, is_newer, write_later_part

#: position error (m) of the better of A-LOAM's two runs on the same scans
SYNTH_ATE_M = {"city": 0.176, "indoor": 0.249, "fastrot": 0.129, "tunnel": 1.0}
CPU_BESIDE_KISS = 2.0
ALGORITHMS = ("registration", "odometry", "mapping")
SEEDS = (1, 2, 3)
#: limits of the position error in m and, where there is one, of the drift in percent
WORLDS: dict[str, tuple[float, float | None]] = {
    "city": (0.20, 0.45),
    "indoor": (0.08, None),
    "handheld": (0.06, None),
    "tunnel_weak": (1.0, None),
}
#: start of a recording begun while moving: at 7 m/s, within a revolution
IN_MOTION_AFTER_S = 20.04
#: limit on the real drive against each reference, m
KITTI_ATE_M = 0.10


def checks(setting: Setting) -> list[Check]:
    """Scans of the reference generator, worlds of the simulator, the real drive."""
    return [
        *(c for scene in SYNTH_ATE_M for c in _scene(setting, scene)),
        *(_world(setting, world, seed) for world in WORLDS for seed in SEEDS),
        *(_begun_in_motion(setting, seed) for seed in SEEDS),
        *_drive(setting),
    ]


def _scans(s: Setting, scene: str) -> Demo:
    return s.demo(f"synth-{scene}", "--scans", s.synth_folder(scene))


def _scene_ate(s: Setting, scene: str) -> Measured:
    error = _scans(s, scene).pose_errors("gt_dense.tum")["ate_rmse_m"]
    return Measured(f"{error:.4f} m", error <= SYNTH_ATE_M[scene])


def _scene_cpu(s: Setting, scene: str) -> Measured:
    spent = _scans(s, scene).report["cpu_ms_per_sweep"]
    ours = sum(spent[stage] for stage in ALGORITHMS)
    kiss = float(s.kiss(s.synth_folder(scene))["cpu_ms_per_sweep"])
    figure = f"{ours:.1f} ms, KISS-ICP {kiss:.1f} ms: {ours / kiss:.2f} ×"
    return Measured(figure, ours <= CPU_BESIDE_KISS * kiss)


def _scene(s: Setting, scene: str) -> list[Check]:
    command = f"make demo SCANS=~/.cache/zenoh-loam/synth/{scene}-{SYNTH_SEED}"
    return [
        Check(
            f"synth-ate-{scene}",
            f"synthetic {scene} (seed {SYNTH_SEED}): ATE of the fused pose",
            f"≤ {SYNTH_ATE_M[scene]} m",
            command,
            functools.partial(_scene_ate, s, scene),
        ),
        Check(
            f"synth-cpu-{scene}",
            f"synthetic {scene}: CPU per sweep of the three algorithms against KISS-ICP",
            f"≤ {CPU_BESIDE_KISS} ×",
            f"make accept ONLY=synth-cpu-{scene}",
            functools.partial(_scene_cpu, s, scene),
        ),
    ]


def _world_errors(s: Setting, world: str, seed: int) -> Measured:
    errors = s.world(world, seed).pose_errors()
    ate_limit, drift_limit = WORLDS[world]
    ate, drift = errors["ate_rmse_m"], errors["drift_percent"]
    held = ate <= ate_limit and (drift_limit is None or drift <= drift_limit)
    return Measured(f"ATE {ate:.4f} m, drift {drift:.3f} %", held)


def _world(s: Setting, world: str, seed: int) -> Check:
    ate, drift = WORLDS[world]
    limit = f"ATE ≤ {ate} m" + ("" if drift is None else f", drift ≤ {drift} %")
    return Check(
        f"world-{world}-{seed}",
        f"simulated {world}, seed {seed}: fused pose",
        limit,
        f"make accept ONLY=world-{world}-{seed}",
        functools.partial(_world_errors, s, world, seed),
    )


def _in_motion_error(s: Setting, seed: int) -> Measured:
    whole, truth = s.simulated("city", seed)
    capture = whole.with_stem(f"{whole.stem}-in_motion")
    if not is_newer(capture, whole):
        write_later_part(whole, capture, IN_MOTION_AFTER_S)
    demo = s.demo(capture.stem, "--pcap", capture, "--truth", truth)
    error = demo.pose_errors()["ate_rmse_m"]
    limit, _ = WORLDS["city"]
    return Measured(f"ATE {error:.4f} m", error <= limit)


def _begun_in_motion(s: Setting, seed: int) -> Check:
    name = f"in-motion-city-{seed}"
    return Check(
        name,
        f"simulated city, seed {seed}, without its first {IN_MOTION_AFTER_S} s: fused pose",
        f"ATE ≤ {WORLDS['city'][0]} m",
        f"make accept ONLY={name}",
        functools.partial(_in_motion_error, s, seed),
    )


def _drive_ate(s: Setting, reference: str) -> Measured:
    error = s.kitti().pose_errors(reference)["ate_rmse_m"]
    return Measured(f"{error:.4f} m", error <= KITTI_ATE_M)


def _drive(s: Setting) -> list[Check]:
    return [
        Check(
            f"drive-ate-{name}",
            f"real HDL-64E drive: ATE against {name}'s poses, as the method's own line asks",
            f"≤ {KITTI_ATE_M} m",
            "make demo KITTI=../shared/data/hdl64e_drive",
            functools.partial(_drive_ate, s, f"reference_{name}.kitti.txt"),
        )
        for name in ("kiss", "small_gicp")
    ]
