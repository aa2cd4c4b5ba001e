"""The images for arm64 are built on this machine; their programs start in emulation."""

from __future__ import annotations

import json
import subprocess

import pytest

from tests.system.compose import ROOT

pytestmark = [pytest.mark.system, pytest.mark.arm64]
IMAGES = ("zenoh-loam", "zenoh-loam-router", "zenoh-loam-monitor")


@pytest.fixture(scope="module")
def built(images: None) -> str:
    """Output of the script, which runs the decoder's tests and every program's --help in
    emulation."""
    done = subprocess.run(
        [ROOT / "deploy/docker/arm64.sh"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-6000:]
    return done.stdout + done.stderr


@pytest.mark.parametrize("image", IMAGES)
def test_the_image_is_for_arm64(built: str, image: str) -> None:
    asked = ["docker", "image", "inspect", f"{image}:arm64"]
    (found,) = json.loads(subprocess.run(asked, check=True, capture_output=True).stdout)
    assert found["Architecture"] == "arm64"
    assert found["Config"]["User"] == "zloam"
