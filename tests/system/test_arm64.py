"""The images for arm64 are made on this machine; what is in them starts on an emulated one."""

from __future__ import annotations

import json
import subprocess

import pytest

from tests.system.compose import ROOT

pytestmark = [pytest.mark.system, pytest.mark.arm64]
IMAGES = ("zenoh-loam", "zenoh-loam-router", "zenoh-loam-monitor")


@pytest.fixture(scope="module")
def built(images: None) -> str:
    """What the script said: it runs the decoder's tests and every program's --help emulated."""
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
