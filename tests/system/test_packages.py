"""Packages in bare containers: they are installed, run the demo, and are removed without a
trace."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = Path(os.environ.get("ZLOAM_PACKAGES", ROOT / "out" / "packages"))
#: certificate authorities of this machine, for containers behind its proxy
CA = Path(os.environ.get("PIP_CERT") or os.environ.get("SSL_CERT_FILE") or "/nonexistent")
LENGTH = "--simulate --duration --simulate 10"

pytestmark = [pytest.mark.system]


def packages(pattern: str) -> list[Path]:
    found = sorted(PACKAGES.glob(pattern))
    if not found:
        pytest.skip(
            f"no {pattern} in {PACKAGES}: make packages, or deploy/build/release.sh --dry-run"
        )
    return found


def in_container(image: str, script: str) -> str:
    """Output of a shell in a bare container; the packages are in /packages."""
    if subprocess.run(["docker", "image", "inspect", image], capture_output=True).returncode:
        pytest.skip(f"no image {image}: deploy/docker/base-image.sh makes it")
    authorities = (
        ["--volume", f"{CA}:/ca.crt:ro", "--env", "PIP_CERT=/ca.crt"] if CA.is_file() else []
    )
    network = os.environ.get("ZLOAM_BUILD_NETWORK", "host")
    done = subprocess.run(
        ["docker", "run", "--rm", "--network", network, *authorities, "--volume",
         f"{PACKAGES}:/packages:ro", image, "bash", "-euc", script],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


WHEEL = f"""
apt-get update -qq && apt-get install -y -qq --no-install-recommends python3-venv >/dev/null 2>&1
if command -v gcc; then exit 1; fi
python3 -m venv /venv
/venv/bin/pip freeze --all > /before
/venv/bin/pip install --quiet /packages/WHEEL
cd /tmp
/venv/bin/zloam --version
/venv/bin/zloam demo {LENGTH} --set zenoh.base_port=0
/venv/bin/zloam calibrate --version
if /venv/bin/zloam demo {LENGTH} --graph 2> refused; then exit 1; fi
if grep 'make ' refused; then exit 1; fi
ls out/demo
/venv/bin/zloam config check vlp16-indoor
/venv/bin/pip uninstall --quiet --yes zloam
find /venv -iname '*zloam*'
"""


@pytest.mark.parametrize("suite", ["bookworm", "trixie"])
def test_the_wheel_runs_the_demo_without_a_compiler(suite: str) -> None:
    (wheel,) = packages("zloam-*.whl")
    said = in_container(f"debian:{suite}-slim", WHEEL.replace("WHEEL", wheel.name))
    assert "accounted for: yes" in said
    assert "picture.png" in said
    assert "accepted by all stages" in said
    # nothing is left after the removal
    assert not said.rstrip().splitlines()[-1].startswith("/venv")


DEB = f"""
apt-get update -qq
apt-get install -y -qq --no-install-recommends /packages/DEB >/dev/null 2>&1
if command -v gcc; then exit 1; fi
cd /tmp
zloam --version
zloam demo {LENGTH} --graph --set zenoh.base_port=0 --record drive.mcap
zloam demo --bag drive.mcap --view --out out/again --set zenoh.base_port=0
zloam calibrate --version
ls out/demo out/again
zloam config check vlp16-indoor
unit=$(dpkg -L zenoh-loam | grep 'zenoh-loam.service$')
eval "$(sed -n 's/^#   sudo \\(install .*\\)/\\1/p' "$unit")"
grep robot: /etc/zenoh-loam/robot.yaml
rm -r /etc/zenoh-loam
apt-get purge -y -qq --auto-remove zenoh-loam >/dev/null 2>&1
find / -xdev \\( -iname '*zloam*' -o -iname '*zenoh-loam*' \\) -not -path '/tmp/*'
echo end
"""


def test_the_debian_package_runs_the_demo_without_a_compiler() -> None:
    (package,) = packages("zenoh-loam_*.deb")
    suite = os.environ.get("ZLOAM_SUITE") or suite_of_this_machine()
    said = in_container(f"debian:{suite}-slim", DEB.replace("DEB", package.name))
    assert "picture.png" in said
    assert "trajectory_world.tum" in said
    assert said.count("accounted for: yes") == 2, "the replayed recording, too"
    assert "run.mcap" in said
    # nothing is left after the removal
    left = said.split("accepted by all stages")[1].splitlines()
    assert [line for line in left if line.startswith("/")] == []


def test_the_bill_of_materials_names_what_is_inside() -> None:
    """It lists the libraries that the programs load, the crates compiled into them, and what Python
    needs."""
    (bill,) = packages("zenoh-loam-*.cdx.json")
    urls = {part["purl"].split("?")[0] for part in json.loads(bill.read_text())["components"]}
    for name in ("pkg:cargo/zenoh@", "pkg:pypi/eclipse-zenoh@", "pkg:deb/debian/libyaml-cpp0."):
        assert [url for url in urls if url.startswith(name)], name
    assert [url for url in urls if "ceres" in url], "the graph of loops is in them"
    assert not [url for url in urls if "pcl" in url], "A-LOAM's programs are in no package"


def suite_of_this_machine() -> str:
    """Name of this machine's distribution, for which the package was built."""
    words = dict(
        line.split("=", 1)
        for line in Path("/etc/os-release").read_text().splitlines()
        if "=" in line
    )
    return words.get("VERSION_CODENAME", "").strip('"')
