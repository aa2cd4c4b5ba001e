"""A result with nothing in it holds no row of the benchmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.bench import graph, kidnap
from tests.bench.graph import Seen
from tests.bench.kidnap import KIDNAPS, Kidnaps, World
from tests.bench.setting import BenchSetting
from zloam_monitor.trajectory import Trajectory, write_tum

HEAD = "kidnap,outside,heading_rad,since,instant_ns,health,x,y,z,qx,qy,qz,qw\n"


@pytest.fixture
def setting(tmp_path: Path) -> BenchSetting:
    return BenchSetting(tmp_path, tmp_path, tmp_path)


def write_kidnaps(out: Path, count: int, x: str) -> Path:
    """A robot that stands at the origin, is put down `count` times, and says Ok at x."""
    still = Trajectory(np.tile(np.eye(4), (50, 1, 1)), np.arange(50) * 10**8, np.arange(50))
    for name in ("mapped.tum", "driven.tum"):
        write_tum(out / name, still)
    rows = [f"{n},{int(n % 10 == 9)},0,0,100000000,0,{x},0,0,0,0,0,1\n" for n in range(count)]
    (out / "kidnaps.csv").write_text(HEAD + "".join(rows))
    return out / "kidnaps.csv"


@pytest.mark.parametrize("count", [0, 3, KIDNAPS - 1])
def test_kidnappings_that_were_not_made_are_no_result(tmp_path: Path, count: int) -> None:
    with pytest.raises(RuntimeError, match=f"{count} of {KIDNAPS} kidnappings"):
        kidnap._judged(write_kidnaps(tmp_path, count, "0"), tmp_path)


@pytest.mark.parametrize(("x", "false"), [("0.4", 0), ("0.6", 90), ("nan", 90)])
def test_a_pose_that_is_no_number_is_false(tmp_path: Path, x: str, false: int) -> None:
    found = kidnap._judged(write_kidnaps(tmp_path, KIDNAPS, x), tmp_path)
    assert (found.false, found.mapped, found.outside) == (false, 90, 10)


def test_kidnappings_to_no_other_world_hold_nothing(
    setting: BenchSetting, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World("city", (), (), (), None)
    for outside in (10, 0):
        seen = Kidnaps(mapped=90, found=90, outside=outside)
        monkeypatch.setattr(kidnap, "_measured", lambda *_, seen=seen: seen)
        assert kidnap._world(setting, world, 1).held == (outside > 0)


@pytest.mark.parametrize("revisits", [40, 0])
def test_a_drive_without_a_revisit_shows_nothing_of_loops(
    setting: BenchSetting, monkeypatch: pytest.MonkeyPatch, revisits: int
) -> None:
    seen = Seen(0.4, 0.1, revisits, found=revisits, loops=revisits, false=0, cpu_ms=5.0)
    monkeypatch.setattr(graph, "_drive", lambda *_: seen)
    assert graph._town(setting, 1, poor=True).held == (revisits > 0)
    assert graph._aliased(setting, "equal_houses").held == (revisits > 0)


@pytest.mark.parametrize("at", [None, 0, 1])
def test_an_error_that_is_no_number_holds_nothing(
    setting: BenchSetting, monkeypatch: pytest.MonkeyPatch, at: int | None
) -> None:
    drives = [
        Seen(0.4, float("nan") if i == at else 0.1, 40, found=40, loops=40, false=0, cpu_ms=5.0)
        for i in range(len(graph.ALIASED_SEEDS))
    ]
    left = iter(drives)
    monkeypatch.setattr(graph, "_drive", lambda *_: next(left))
    assert graph._aliased(setting, "equal_houses").held == (at is None)
