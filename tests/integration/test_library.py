"""The installed library, used from outside the checkout as docs/library.md describes."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.integration.conftest import ROOT, Capture
from tests.recordings import variants
from zloam_monitor import se3
from zloam_monitor.trajectory import interpolate, read

#: Limit for some seconds in the city, without alignment; rings are unknown and times derive from
#: azimuths.
RMSE_M = 0.05
PERIOD_NS = 100_000_000


@pytest.fixture(scope="module")
def installed(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    prefix = tmp_path_factory.mktemp("installed")
    words = ["cmake", "--install", str(build), "--component", "dev", "--prefix", str(prefix)]
    subprocess.run(words, check=True, capture_output=True)
    return prefix


def listing(language: str) -> str:
    found = re.search(
        rf"^```{language}\n(.*?)^```$", (ROOT / "docs/library.md").read_text(), re.S | re.M
    )
    assert found is not None
    return found[1]


def built(installed: Path, folder: Path) -> Path:
    folder.mkdir()
    shutil.copy(ROOT / "examples/odometry.cpp", folder)
    (folder / "CMakeLists.txt").write_text(listing("cmake"))
    flags = [f"-DCMAKE_PREFIX_PATH={installed}", "-DCMAKE_BUILD_TYPE=Release"]
    for words in (
        ["cmake", "-S", str(folder), "-B", str(folder / "build"), *flags],
        ["cmake", "--build", str(folder / "build")],
    ):
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return folder / "build" / "odometry"


def test_the_example_follows_the_simulator(
    build: Path, capture: Capture, installed: Path, tmp_path: Path
) -> None:
    """KITTI's scans are cut at the sensor's rear, the simulator's in front, so the latter are
    rotated by 180 degrees."""
    scans = tmp_path / "velodyne"
    scans.mkdir()
    whole = variants.decoded(build, capture.pcap, tmp_path)[1:]
    for number, scan in enumerate(whole):
        turned = scan.xyz * np.array([-1, -1, 1], np.float32)
        records = np.column_stack([turned, scan.intensity]).astype("<f4")
        records.tofile(scans / f"{number:010d}.bin")
    out = tmp_path / "poses.tum"
    program = built(installed, tmp_path / "elsewhere")
    done = subprocess.run([program, scans, out], capture_output=True, text=True, check=True)
    assert done.stdout == f"{len(whole)} poses\n"
    found, truth = read(out), read(capture.truth_lidar)
    assert found.stamps_ns is not None
    # The example assumes a scan every 0.1 s; the simulator's motor speed varies a little.
    begins_ns = np.array([scan.stamp_ns for scan in whole])
    after_ns = found.stamps_ns - np.arange(len(whole)) * PERIOD_NS
    wanted, inside = interpolate(truth, begins_ns + after_ns)
    turned_back = np.diag([-1.0, -1.0, 1.0, 1.0])
    estimate = turned_back @ found.transforms[inside] @ turned_back
    moved, seen = (se3.inverse(t[0]) @ t for t in (wanted.transforms, estimate))
    error = np.linalg.norm(seen[:, :3, 3] - moved[:, :3, 3], axis=1)
    assert inside.sum() > 0.9 * len(whole)
    assert np.sqrt(np.mean(error**2)) < RMSE_M


def test_the_headers_are_those_that_the_page_names(installed: Path) -> None:
    page = (ROOT / "docs/library.md").read_text()
    headers = set(re.findall(r"`(\w+/\w+\.hpp)`", page))
    stages = ("registration", "odometry", "mapping", "integration")
    assert headers >= {f"{stage}/{stage}.hpp" for stage in stages}
    for header in headers:
        assert (installed / "include/zenoh-loam" / header).is_file(), header


def test_another_version_is_refused(installed: Path, tmp_path: Path) -> None:
    text = listing("cmake").replace("find_package(zloam ", "find_package(zloam 99 ")
    (tmp_path / "CMakeLists.txt").write_text(text)
    where = ["-S", str(tmp_path), "-B", str(tmp_path / "b")]
    words = ["cmake", *where, f"-DCMAKE_PREFIX_PATH={installed}"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    # CMake breaks lines. Without the package it would say that it found none.
    assert 'requested version "99"' in " ".join(done.stderr.split())
