"""`docker compose up --scale registration=3` gives the same results as a single instance."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from tests.system.conftest import Drive, Replayed, replay

pytestmark = pytest.mark.system
REPLICAS = 3
FILES = ("trajectory.tum", "trajectory.kitti", "odometry.tum", "map.pcd")


@pytest.fixture(scope="module")
def shared(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    return replay(drive, tmp_path_factory.mktemp("shared"), "--scale", f"registration={REPLICAS}")


def digests(folder: Path) -> dict[str, str]:
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES}


def test_the_bytes_are_those_of_one(shared: Replayed, undisturbed: Replayed) -> None:
    assert digests(shared.out) == digests(undisturbed.out)


def test_each_sweep_has_one_pose(shared: Replayed) -> None:
    identities = shared.report["identities"]
    assert identities["inputs_balanced"], identities
    assert identities["poses"] == identities["sweeps"] > 0
    lines = (shared.out / "trajectory.tum").read_text().splitlines()
    stamps = [line.split()[0] for line in lines]
    assert len(set(stamps)) == len(stamps) == identities["sweeps"]


def test_each_replica_did_its_share(shared: Replayed) -> None:
    """The replicas know of each other: the sweeps that one leaves out are processed by others."""
    found = {i: s.inputs[0] for (stage, i), s in shared.statuses.items() if stage == "registration"}
    assert len(found) == REPLICAS
    sweeps = shared.report["identities"]["sweeps"]
    for account in found.values():
        assert account.processed > 0
        assert account.not_mine > 0
    assert sum(a.processed for a in found.values()) >= sweeps
