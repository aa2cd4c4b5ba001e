"""A-LOAM's stages (services/aloam) against A-LOAM's own results on the same scans: they serve as a
reference only while they are faithful to it."""

from __future__ import annotations

import functools

from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import Demo, Setting
from zloam_monitor.methods import programs

#: position error (m) of A-LOAM's mapped poses: its own code, run once, every sweep mapped, seed 7
ATE_M = {"city": 0.327, "indoor": 0.249, "fastrot": 0.129, "tunnel": 14.2}
WITHIN = 0.25
ALGORITHMS = ("registration", "odometry", "mapping")
#: without a delay of the correction, the fused pose equals the mapped one
MAPPED = ("--method", "aloam", "--set", "integration.correction_delay=0")


def checks(setting: Setting) -> list[Check]:
    """The four scenes, and a drive in our own simulator."""
    return [*(_scene(setting, scene) for scene in ATE_M), _demo(setting)]


def run(s: Setting, name: str, *arguments: object) -> Demo:
    """A demo with A-LOAM's programs."""
    for program in programs("aloam").values():
        if not (s.build / "bin" / f"zloam-{program}").exists():
            raise Skip(f"zloam-{program} is not built (PCL)")
    return s.demo(f"aloam-{name}", *arguments, *MAPPED)


def cpu_ms(demo: Demo) -> float:
    """CPU time per sweep of the three algorithms together."""
    spent = demo.report["cpu_ms_per_sweep"]
    return float(sum(spent[stage] for stage in ALGORITHMS))


def _ate(s: Setting, scene: str) -> Measured:
    demo = run(s, scene, "--scans", s.synth_folder(scene))
    error = demo.pose_errors("gt_dense.tum")["ate_rmse_m"]
    off = error / ATE_M[scene] - 1.0
    return Measured(f"{error:.3f} m ({off:+.0%}), {cpu_ms(demo):.0f} ms", abs(off) <= WITHIN)


def _scene(s: Setting, scene: str) -> Check:
    return Check(
        f"aloam-{scene}",
        f"A-LOAM's stages, synthetic {scene} (seed 7): ATE of the mapped pose",
        f"{ATE_M[scene]} m ± {WITHIN:.0%}",
        f"make demo METHOD=aloam SCANS=~/.cache/zenoh-loam/synth/{scene}-7",
        functools.partial(_ate, s, scene),
    )


def _demo_ends(s: Setting) -> Measured:
    demo = run(s, "demo")
    return Measured(f"exit code {demo.code}", demo.code == 0)


def _demo(s: Setting) -> Check:
    return Check(
        "aloam-demo",
        "A-LOAM's stages on the simulated city loop: all is accounted for",
        "exit code 0",
        "make demo METHOD=aloam",
        functools.partial(_demo_ends, s),
    )
