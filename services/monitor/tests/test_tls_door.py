"""`zloam` reaches a robot behind a router with certificates on both sides."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import zenoh

from zloam_monitor import cli, discovery
from zloam_monitor.processes import free_port

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")


def opened(tls: dict[str, object], where: str) -> zenoh.Session:
    """A router."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/link/tls", json.dumps(tls))
    config.insert_json5("listen/endpoints", json.dumps([where]))
    return zenoh.open(config)


def test_a_robot_behind_tls_is_reached_as_the_text_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = Path(__file__).parents[3]
    text = (root / "deploy/README.md").read_text()
    (told,) = re.findall(r'^zloam watch --connect "(tls/.*)"$', text, re.MULTILINE)
    script = root / "deploy/zenoh/certificates.sh"
    subprocess.run([script, tmp_path, "car"], check=True, capture_output=True)
    monkeypatch.chdir(tmp_path)
    where = f"tls/localhost:{free_port()}"
    endpoint = where + "#" + told.partition("#")[2]
    router = {
        "root_ca_certificate": "authority.crt",
        "listen_certificate": "router.crt",
        "listen_private_key": "router.key",
        "enable_mtls": True,
    }
    with (
        opened(router, where) as behind,
        behind.liveliness().declare_token("loam/car/service/odometry/odometry-1/alive"),
    ):
        (found,) = discovery.present([endpoint])
        assert (found.robot, found.stages, found.router) == ("car", ["odometry"], True)
        assert cli.main(["watch", "--connect", where]) == 1
    assert "accepts the certificates that the endpoint names" in capsys.readouterr().err
