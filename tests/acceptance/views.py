"""Checks of what views and saves cost a robot (issue 41)."""

from __future__ import annotations

import functools
import json
import shutil
from pathlib import Path

import pytest

from tests.acceptance.framework import Check, Measured, Skip
from tests.acceptance.runs import ROOT, Setting
from tests.integration import far_views, map_saves
from tests.integration.hosts import far_host
from tests.integration.observed import Phase

THIN_LINK, MAP_SAVE = "views-thin-link", "map-save-live"
SECONDS = {THIN_LINK: 600.0, MAP_SAVE: 60.0}
ROBOT_FILE = ROOT / "deploy/robots/vlp16-outdoor.yaml"
#: limit of the latency with views: a factor on that without, plus ms for jitter on a busy machine
RATIO, FLOOR_MS = 1.1, 2.0
#: limit of the growth of a stage's memory during the phase
FLAT_MIB = 4.0


def _out(setting: Setting, name: str) -> Path:
    out = setting.out / "accept" / name
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    return out


def _costs(alone: Phase, beside: Phase) -> tuple[list[str], bool]:
    """Latency and losses in words, and whether the robot ran as well as alone."""
    lost = beside.missing() + sum(beside.dropped.values())
    latencies = [(alone.latency_ms(p), beside.latency_ms(p)) for p in (50, 99)]
    held = not lost and all(b <= RATIO * a + FLOOR_MS for a, b in latencies)
    figures = ", ".join(f"{b:.1f} ms ({a:.1f} alone)" for a, b in latencies)
    return [f"p50, p99: {figures}", f"{lost} sweeps lost ({alone.missing()} alone)"], held


def _thin_link(setting: Setting) -> Measured:
    out = _out(setting, THIN_LINK)
    try:
        with far_host() as far:
            found = far_views.measure(setting.build, ROBOT_FILE, out, far, SECONDS[THIN_LINK])
    except pytest.skip.Exception as skipped:
        raise Skip(str(skipped)) from skipped
    (out / "found.json").write_text(json.dumps(found.summary(), indent=1) + "\n")
    said, held = _costs(found.alone, found.watched)
    grown = {stage: mib for stage, mib in found.watched.growth_mib().items() if mib > FLAT_MIB}
    silent = [view for view, more in found.shown.items() if more <= 0]
    said += [f"{stage} + {mib:.1f} MiB" for stage, mib in grown.items()]
    said += [f"{view} showed nothing" for view in silent]
    return Measured("; ".join(said), held and not grown and not silent)


def _map_save(setting: Setting) -> Measured:
    out = _out(setting, MAP_SAVE)
    found = map_saves.measure(setting.build, ROBOT_FILE, out, SECONDS[MAP_SAVE])
    said, held = _costs(found.alone, found.saving)
    what = f"{found.saves} saves of {found.points} points at the end"
    return Measured("; ".join([what, *said]), held and found.saves > 0)


def checks(setting: Setting) -> list[Check]:
    latency = f"latency ≤ {RATIO} ×, nothing lost"
    return [
        Check(
            THIN_LINK,
            "every view open over 1 Mbit/s with 200 ms: ten minutes with them, ten without",
            f"{latency}, memory + ≤ {FLAT_MIB:.0f} MiB",
            f"make accept ONLY={THIN_LINK}",
            functools.partial(_thin_link, setting),
        ),
        Check(
            MAP_SAVE,
            "`zloam map save` again and again during a live run",
            latency,
            f"make accept ONLY={MAP_SAVE}",
            functools.partial(_map_save, setting),
        ),
    ]
