"""A replay without progress is given up only if nothing explains that it waits."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from zloam_monitor import demo, sources
from zloam_monitor.chain import ChainError
from zloam_monitor.kept_poses import KeptPoses
from zloam_monitor.remarks import Logs, Remarks
from zloam_monitor.terminal import ProgressLine
from zloam_monitor.traffic import Rate

LOOKS = 4


def a_chain_that_stands() -> Any:
    """A chain without progress that ends after some looks at it."""
    looks = count()
    return SimpleNamespace(
        finished=lambda: next(looks) >= LOOKS,
        progress=lambda: (7, 7),
        check=lambda: None,
        link=SimpleNamespace(poll=lambda: None, poses=KeptPoses(), posed=Rate(), statuses={}),
    )


def follow(configs: dict[str, dict[str, Any]], folder: Path) -> float:
    source = sources.from_pcap(Path("drive.pcap"))
    return demo._follow(
        a_chain_that_stands(),
        source,
        ProgressLine(),
        Remarks(),
        Logs(folder),
        demo._patience_s(configs),
    )


@pytest.mark.parametrize("rate", ["realtime", "0.5"])
def test_a_paced_replay_waits_through_a_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rate: str
) -> None:
    monkeypatch.setattr(demo, "STALL_SECONDS", 0.0)
    monkeypatch.setattr(demo, "LOOK_SECONDS", 0.001)
    follow({"driver": {"driver.rate": rate}}, tmp_path)


@pytest.mark.parametrize("configs", [{"driver": {"driver.rate": "max"}}, {}])
def test_a_replay_at_full_pace_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, configs: dict[str, dict[str, Any]]
) -> None:
    monkeypatch.setattr(demo, "STALL_SECONDS", 0.0)
    monkeypatch.setattr(demo, "LOOK_SECONDS", 0.001)
    with pytest.raises(ChainError, match="nothing moved"):
        follow(configs, tmp_path)
