"""Containers end after a replay and never during a live run: the script that ends them, and the
Compose layers. A service of systemd ends as `zloam run` does."""

from __future__ import annotations

import configparser
import os
import re
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.integration.conftest import PATIENCE_S, ROOT

WITH_RUN = ROOT / "deploy/docker/with-run"
LIVE_LAYERS = ("deploy/compose/live.yml", "tests/system/live.yml")


def start(after: str, ended_file: Path, *command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [WITH_RUN, *command],
        env={**os.environ, "ZLOAM_AFTER": after, "ZLOAM_ENDED_FILE": str(ended_file)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_the_command_ends_when_the_file_is_there(tmp_path: Path) -> None:
    with start("end", tmp_path / "ended", "sleep", "60") as process:
        time.sleep(1.5)
        assert process.poll() is None
        (tmp_path / "ended").write_text("0\n")
        assert process.wait(PATIENCE_S) == -signal.SIGTERM


def test_all_end_at_the_time_that_it_tells(tmp_path: Path) -> None:
    at = int(time.time()) + 4
    (tmp_path / "ended").write_text(f"{at}\n")
    with start("end", tmp_path / "ended", "sleep", "60") as process:
        assert process.wait(PATIENCE_S) == -signal.SIGTERM
        assert time.time() >= at


def test_a_file_of_the_beginning_ends_it_too(tmp_path: Path) -> None:
    (tmp_path / "ended").write_text("0\n")
    with start("end", tmp_path / "ended", "sleep", "60") as process:
        assert process.wait(PATIENCE_S) == -signal.SIGTERM


def test_nothing_ends_a_command_that_stays(tmp_path: Path) -> None:
    (tmp_path / "ended").write_text("0\n")
    with start("stay", tmp_path / "ended", "sh", "-c", "sleep 2; exit 7") as process:
        assert process.wait(PATIENCE_S) == 7


def test_the_code_is_the_commands_and_nobody_is_left_to_watch(tmp_path: Path) -> None:
    # The output stays open as long as the watching process lives, so reading it to its end proves
    # that the process has ended.
    with start("end", tmp_path / "ended", "sh", "-c", "exit 7") as process:
        assert process.wait(PATIENCE_S) == 7
        process.communicate(timeout=PATIENCE_S)


def test_another_word_is_refused(tmp_path: Path) -> None:
    with start("ends", tmp_path / "ended", "true") as process:
        said = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 2
    assert said == "with-run: ZLOAM_AFTER is ends; end or stay is expected\n"


class _Compose(yaml.SafeLoader):  # type: ignore[misc]  # yaml has no types
    """Loads Compose's own tags (!override) without their meaning, which does not matter here."""


_Compose.add_multi_constructor("!", lambda loader, _, node: loader.construct_mapping(node))


def services(path: str) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = yaml.load((ROOT / path).read_text(), _Compose)["services"]
    return found


def lasting(base: dict[str, dict[str, Any]]) -> set[str]:
    """Names of the services that run until they are stopped."""
    return {name for name, service in base.items() if "restart" in service}


def test_in_a_replay_each_lasting_service_ends() -> None:
    base = services("docker-compose.yml")
    assert lasting(base) > {"router", "store", "mapping"}
    for name in lasting(base):
        assert base[name]["environment"]["ZLOAM_AFTER"] == "${ZLOAM_AFTER:-end}", name
        # With on-failure, a service that ended with success is not started again.
        assert base[name]["restart"].startswith("on-failure"), name


@pytest.mark.parametrize("layer", LIVE_LAYERS)
def test_in_a_live_run_none_does(layer: str) -> None:
    base, live = services("docker-compose.yml"), services(layer)
    for name in lasting(base):
        assert live[name]["environment"]["ZLOAM_AFTER"] == "stay", name
        assert live[name]["restart"] == "unless-stopped", name
    for name in ("simulate", "monitor", "result"):
        assert live[name]["profiles"] == ["replay"]


@pytest.mark.parametrize("layer", ["preview", "ros", "views", "observability"])
def test_beside_a_live_robot_a_layer_s_services_can_last_as_long(layer: str) -> None:
    """After a restart of the machine Docker starts none with on-failure, which a replay needs."""
    found = services(f"deploy/compose/{layer}.yml")
    for name in lasting(found):
        assert found[name]["restart"] == "${ZLOAM_RESTART:-on-failure}", name
    assert lasting(found)


@pytest.mark.parametrize("layer", ["standby", "replicas", "secured", "aloam"])
def test_on_top_of_a_live_robot_a_layer_leaves_its_restarts(layer: str) -> None:
    assert "restart:" not in (ROOT / f"deploy/compose/{layer}.yml").read_text()


def test_who_names_a_robot_s_layers_reads_how_all_of_them_return() -> None:
    for file in (".env", "deploy/README.md"):
        _, _, after = (ROOT / file).read_text().partition("On a robot")
        assert "ZLOAM_RESTART" in after[:300], file


def test_systemd_leaves_the_stages_to_zloam_run() -> None:
    """By default it would send SIGTERM to the stages, too: then zloam run's own SIGTERM is their
    second, at which a stage ends at once and loses what it has not written."""
    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.read(ROOT / "deploy/debian/zenoh-loam.service")
    assert unit["Service"]["KillMode"] == "mixed"
    # The main process is zloam run itself, not a shell that waits for it.
    assert "exec /usr/bin/zloam run" in unit["Service"]["ExecStart"]


def test_the_service_may_open_a_serial_scanner() -> None:
    """Its user exists only while it runs, so that no administrator can add it to a group."""
    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.read(ROOT / "deploy/debian/zenoh-loam.service")
    assert unit["Service"]["DynamicUser"] == "yes"
    assert unit["Service"]["SupplementaryGroups"] == "dialout"


def test_systemd_tells_a_robot_file_that_is_missing_and_the_comment_puts_it_there(
    tmp_path: Path,
) -> None:
    path = ROOT / "deploy/debian/zenoh-loam.service"
    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.read(path)
    file = unit["Unit"]["AssertPathExists"]
    assert file in unit["Service"]["ExecStart"]
    (command,) = re.findall(rf"^#   sudo (.* {file})$", path.read_text(), re.MULTILINE)
    bundled = "/usr/lib/zenoh-loam/zloam_monitor/bundled/robots"
    here = command.replace(bundled, str(ROOT / "deploy/robots")).replace(file, f"{tmp_path}{file}")
    subprocess.run(here.split(), check=True)
    assert Path(f"{tmp_path}{file}").is_file()
