"""A store whose disk is full says what it lacks, in its health and by its exit code."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.integration.conftest import Capture, simulate
from tests.integration.live_run import LiveRun

#: the map of some seconds is larger
SIZE = "200k"
IO_CODE = 3


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    return simulate(build, folder, "--world", "city", "--seed", "4", "--duration", "10")


def test_what_does_not_fit_on_the_disk_is_told_until_the_end(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-m", "true"]).returncode:
        pytest.skip("needs the right to mount in a name space of its own")
    run = LiveRun(build, robot_file, drive, tmp_path)
    tiles = tmp_path / "tiles"
    tiles.mkdir()
    mount = f'mount -t tmpfs -o size={SIZE} tmpfs {tiles} && exec "$@"'
    run._store = ["unshare", "-m", "sh", "-c", mount, "sh", *run._store]

    def says_so() -> bool:
        store = run.chain.link.stage("store")
        return store is not None and f"messages of the map are not in {tiles}" in store.reason

    with run:
        run._until(says_so)
        poses = len(run.poses)
        run.until_poses(poses + 5)
        codes = run.chain.stop()
    assert codes.pop("store") == IO_CODE
    assert set(codes.values()) == {0}, codes
    assert f"are not in {tiles}" in (tmp_path / "store.log").read_text()
