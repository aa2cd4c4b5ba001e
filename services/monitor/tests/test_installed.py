"""The command `zloam` as it is installed: from the Debian package's files, and in any folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from zloam_monitor import clouds, messages
from zloam_monitor.messages import MAP_POINT
from zloam_monitor.stages import NAME, STAGES

ROOT = Path(__file__).resolve().parents[3]
#: Modules that the command itself imports.
SHADOWS = ("yaml", "typer", "queue")


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """The command in the Debian package's folders (cmake/packages.cmake); its programs write their
    arguments and fail: integration, as of a wrong configuration, before the others."""
    try:
        schemas = messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))
    command, package = tmp_path / "bin/zloam", tmp_path / "lib/zenoh-loam/zloam_monitor"
    command.parent.mkdir()
    shutil.copy(ROOT / "deploy/debian/zloam", command)
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "services/monitor/src/zloam_monitor", package, ignore=ignored)
    shutil.copy(ROOT / "services" / NAME, package)
    shutil.copytree(schemas / "zloam", package / "bundled/python/zloam", ignore=ignored)
    shutil.copytree(ROOT / "deploy/robots", package / "bundled/robots")
    (package / "bundled/bin").mkdir()
    for stage in STAGES:
        program = package / f"bundled/bin/zloam-{stage}"
        # What fails first ends the others, which then may have written nothing yet.
        end = "exit 2" if stage == "integration" else "exec sleep 60"
        program.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > "$0.arguments"\n{end}\n')
        program.chmod(0o755)
    return command


def zloam(command: Path, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    kept = {n: v for n, v in os.environ.items() if not n.startswith(("ZLOAM_", "PYTHON"))}
    # Not by the first line's Python, which lacks the packages.
    return subprocess.run(
        [sys.executable, command, *words],
        cwd=folder,
        env={**kept, "ZLOAM_FREE_PORTS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_command_that_reads_recordings_can_be_started(installed: Path, tmp_path: Path) -> None:
    points = np.zeros(100, MAP_POINT)
    points["x"] = np.linspace(1, 9, 100)
    (tmp_path / "clouds").mkdir()
    for name in ("1.0.pcd", "1.1.pcd"):
        clouds.write_pcd(tmp_path / "clouds" / name, points, np.ones(100, np.uint8))
    words = ("demo", "--bag", "clouds", "--set", "driver.time_model=deskewed")
    done = zloam(installed, *words, folder=tmp_path)
    assert done.returncode == 2, done.stderr  # As its programs end.
    programs = tmp_path / "lib/zenoh-loam/zloam_monitor/bundled/bin"
    given = (programs / "zloam-integration.arguments").read_text().splitlines()
    (reader,) = (a.partition("=")[2] for a in given if a.startswith("driver.reader="))
    assert Path(reader) == installed
    assert os.access(reader, os.X_OK)


def test_advice_names_no_target_of_a_checkout(installed: Path, tmp_path: Path) -> None:
    for option in (("--graph",), ("--method", "aloam")):
        done = zloam(installed, "run", *option, folder=tmp_path)
        assert "this package does not contain it" in done.stderr
        assert "make " not in done.stderr


def test_modules_of_the_current_folder_are_not_imported(installed: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in SHADOWS:
        (folder / f"{name}.py").write_text(f"raise SystemExit('{name}.py of this folder')\n")
    words = ("run", "--config", "none.yaml")
    assert "none.yaml: No such file" in zloam(installed, *words, folder=folder).stderr
    if not (ROOT / ".venv/bin/python").exists():
        pytest.skip("no .venv in the checkout: it is made by make build")
    for empty_entry in ("", ":", ":/elsewhere", "/elsewhere:", "/elsewhere::/other"):
        done = subprocess.run(
            [ROOT / "bin/zloam", *words],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": empty_entry},
            capture_output=True,
            text=True,
            check=False,
        )
        assert "none.yaml: No such file" in done.stderr, empty_entry
