"""`make clean` removes what can be built again, and nothing else."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tests.integration.conftest import ROOT


def test_what_users_keep_stays(tmp_path: Path) -> None:
    kept = ("out/town/tiles.log", "out/tls/authority.key", "out/demo/trajectory.tum")
    for name in (*kept, "build/release/bin/zloam-driver"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    subprocess.run(
        ["make", "-f", ROOT / "Makefile", "clean"], cwd=tmp_path, check=True, capture_output=True
    )
    left = sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file())
    assert left == sorted(kept)
