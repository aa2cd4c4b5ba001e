"""Sweeps without rings against a VLP-16's on the same drives (tests/bench/search), seeds 1 to 3."""

from __future__ import annotations

import functools

from tests.acceptance.framework import Check, Measured
from tests.acceptance.hard import ran
from tests.acceptance.runs import Setting

SEEDS = (1, 2, 3)
#: lidar, text, limit of its error as a multiple of the reference lidar's, reference lidar
LINES = (
    ("no-rings", "VLP-16 with its rings withheld", 1.2, "vlp16"),
    ("mid360", "pattern of a Livox Mid-360", 2.0, "vlp16"),
    ("hap", "pattern of a Livox HAP", 2.0, "vlp16"),
)


def _measured(setting: Setting, lidar: str, world: str, limit: float, beside: str) -> Measured:
    ratios, texts = [], []
    for seed in SEEDS:
        one, other = (
            ran(setting.build, setting.out, setting.shared, f"{name}-{world}-{seed}").verdict
            for name in (lidar, beside)
        )
        ratios.append(one.fused_m / other.fused_m)
        texts.append(f"{one.fused_m:.4f} m ({ratios[-1]:.2f})")
    return Measured(", ".join(texts), all(ratio <= limit for ratio in ratios))


def checks(setting: Setting) -> list[Check]:
    return [
        Check(
            f"ringless-{lidar}-{world}",
            f"{text}, {world}: fused error, and beside a VLP-16's",
            f"≤ {limit} ×",
            f"make accept ONLY=ringless-{lidar}-{world}",
            functools.partial(_measured, setting, lidar, world, limit, beside),
        )
        for lidar, text, limit, beside in LINES
        for world in ("indoor", "city")
    ]
