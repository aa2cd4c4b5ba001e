"""deploy/zenoh/certificates.sh, run again: what exists is kept, and what is missing is made."""

from __future__ import annotations

import shutil
import stat
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "deploy/zenoh/certificates.sh"
pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")


def certificates(folder: Path, *words: str, robot: str = "robot") -> tuple[int, str]:
    done = subprocess.run(
        [SCRIPT, folder, robot, *words], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("host", ["2001:db8::1", "2001:DB8:0:0::1", "10.0.0.2", "robot.lan"])
def test_a_second_time_it_keeps_the_router_s_and_makes_what_is_missing(
    tmp_path: Path, host: str
) -> None:
    assert certificates(tmp_path, "2001:db8::1", "10.0.0.2", "robot.lan")[0] == 0
    before = (tmp_path / "router.crt").read_bytes()
    (tmp_path / "sensor.crt").unlink()
    code, said = certificates(tmp_path, host)
    assert code == 0, said
    assert (tmp_path / "router.crt").read_bytes() == before
    assert (tmp_path / "sensor.crt").is_file()


@pytest.mark.parametrize("host", ["2001:db8::2", "10.0.0.3", "other.lan"])
def test_a_host_that_the_router_s_is_not_for_is_named(tmp_path: Path, host: str) -> None:
    assert certificates(tmp_path, "2001:db8::1", "10.0.0.2", "robot.lan")[0] == 0
    code, said = certificates(tmp_path, host)
    assert code == 1
    assert f"router.crt exists and is not valid for {host}" in said


def test_a_certificate_of_another_authority_is_named(tmp_path: Path) -> None:
    """A new authority, as the script advises where half of the old one has gone."""
    assert certificates(tmp_path)[0] == 0
    (tmp_path / "authority.key").unlink()
    assert "remove it to make a new authority" in certificates(tmp_path)[1]
    (tmp_path / "authority.crt").unlink()
    code, said = certificates(tmp_path)
    assert code == 1
    assert "router.crt is not of" in said


def test_a_certificate_without_its_key_is_named(tmp_path: Path) -> None:
    assert certificates(tmp_path)[0] == 0
    (tmp_path / "operator.key").unlink()
    code, said = certificates(tmp_path)
    assert code == 0
    assert "has no operator.key" in said
    assert said.count("has no") == 1


def test_another_robot_s_rules_are_called_to_mind(tmp_path: Path) -> None:
    """The router's are for "robot": it would refuse the members of another one without a word."""
    assert "secured.json5" in certificates(tmp_path / "rover", robot="rover")[1]
    assert "secured.json5" not in certificates(tmp_path / "robot")[1]


def test_a_role_s_certificate_can_be_read_and_its_key_can_not(tmp_path: Path) -> None:
    assert certificates(tmp_path, "--role", "camera")[0] == 0
    modes = [stat.S_IMODE((tmp_path / f"camera.{kind}").stat().st_mode) for kind in ("crt", "key")]
    assert modes == [0o644, 0o600]


def test_a_role_without_a_name_gets_the_usage(tmp_path: Path) -> None:
    code, said = certificates(tmp_path / "tls", "--role")
    assert code == 2
    assert "--role NAME [DAYS]" in said
    assert not (tmp_path / "tls").exists()
