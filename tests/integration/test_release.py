"""An invalid release is refused with the reason before anything is built."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.integration.conftest import ROOT

VERSIONED = (
    ".gitignore",
    "CMakeLists.txt",
    "CHANGELOG.md",
    "deploy/docker/Dockerfile",
    "deploy/build/release.sh",
    "services/router/Cargo.toml",
)


def git(folder: Path, *words: str) -> None:
    who = ("-c", "user.name=test", "-c", "user.email=test@localhost")
    subprocess.run(["git", "-C", folder, *who, *words], check=True, capture_output=True)


def change(path: Path, pattern: str, to: str) -> None:
    text = path.read_text()
    changed = re.sub(pattern, to, text, count=1, flags=re.MULTILINE)
    assert changed != text
    path.write_text(changed)


def configured(checkout: Path, source: str) -> None:
    """Makes the build folder one of the sources there; empty: of none."""
    cache = f"CMAKE_HOME_DIRECTORY:INTERNAL={source}\n" if source else ""
    (checkout / "build/CMakeCache.txt").write_text(cache)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with the files that the script reads, and its build folder. The packing script
    is missing in it: reaching that step would end with 127."""
    for name in VERSIONED:
        place = tmp_path / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes((ROOT / name).read_bytes())
        place.chmod((ROOT / name).stat().st_mode)
    change(tmp_path / "CHANGELOG.md", r"^(## \[\S+\] - ).*$", r"\g<1>2026-01-02")
    for folder in ("schemas", "schemas/.released"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "sweep.fbs").write_text("table Sweep {}\n")
    (tmp_path / "build").mkdir()
    configured(tmp_path, str(tmp_path))
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "--message", "Begin")
    return tmp_path


def released(checkout: Path, *words: str) -> tuple[int, str]:
    tools = checkout / "build/tools"
    tools.mkdir(exist_ok=True)
    (tools / "cmake").write_text('#!/bin/sh\necho "cmake $*"\n')
    (tools / "cmake").chmod(0o755)
    done = subprocess.run(
        [checkout / "deploy/build/release.sh", *words, "build", "out"],
        env={**os.environ, "PATH": f"{tools}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def uncommitted(checkout: Path) -> None:
    (checkout / "more").touch()


def other_image(checkout: Path) -> None:
    change(checkout / "deploy/docker/Dockerfile", r"^ARG VERSION=.*$", "ARG VERSION=9.9.9")


def other_router(checkout: Path) -> None:
    change(checkout / "services/router/Cargo.toml", r"^version = .*$", 'version = "9.9.9"')


def other_schema(checkout: Path) -> None:
    (checkout / "schemas/sweep.fbs").write_text("table Sweep { a: int (id: 0); }\n")


def no_heading(checkout: Path) -> None:
    change(checkout / "CHANGELOG.md", r"^## \[\S+\]", "## [9.9.9]")


def no_date(checkout: Path) -> None:
    change(checkout / "CHANGELOG.md", r"^(## \[\S+\] - ).*$", r"\g<1>not yet released")


def tagged(checkout: Path) -> None:
    version = re.search(r"VERSION (\S+) LANG", (checkout / "CMakeLists.txt").read_text())
    assert version is not None
    git(checkout, "tag", f"v{version[1]}")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (uncommitted, "uncommitted changes"),
        (other_image, "Dockerfile has ARG VERSION=9.9.9"),
        (other_router, "services/router/Cargo.toml has version 9.9.9"),
        (other_schema, "schemas/.released has not this sweep.fbs"),
        (no_heading, "CHANGELOG.md has no heading"),
        (no_date, "has no date"),
        (tagged, "is there already"),
    ],
)
def test_what_is_not_ready_is_refused(
    checkout: Path, spoil: Callable[[Path], None], words: str
) -> None:
    spoil(checkout)
    if spoil is not uncommitted:
        git(checkout, "commit", "--all", "--quiet", "--allow-empty", "--message", "Spoil")
    code, said = released(checkout)
    assert (code, words in said) == (1, True), said


def test_what_is_ready_goes_on_to_the_packages(checkout: Path) -> None:
    code, said = released(checkout)
    assert (code, "packages.sh" in said) == (127, True), said


def packing(checkout: Path, what: str) -> None:
    """Adds stand-ins for what packs; the packing script does `what`."""
    pip, python = "build/packaging/bin/pip", "build/packaging/bin/python"
    made = "mkdir -p out && touch out/a.whl out/a.deb out/a.cdx.json"
    for name, does in (("deploy/build/packages.sh", f"{made}; {what}"), (pip, ""), (python, "")):
        (checkout / name).parent.mkdir(parents=True, exist_ok=True)
        (checkout / name).write_text(f"#!/bin/sh\necho {name}\n{does}\n")
        (checkout / name).chmod(0o755)
    git(checkout, "add", ".")
    git(checkout, "commit", "--quiet", "--message", "Pack")


def tags(checkout: Path) -> list[str]:
    done = subprocess.run(
        ["git", "-C", checkout, "tag", "--points-at", "HEAD"],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_what_is_tagged_is_built_before_it_is_packed(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Packages of an earlier build would bear the new version."""
    for who in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{who}_NAME", "test")
        monkeypatch.setenv(f"GIT_{who}_EMAIL", "test@localhost")
    packing(checkout, "")
    code, said = released(checkout)
    assert code == 0, said
    steps = [line for line in said.splitlines() if line.startswith(("cmake --build", "deploy/"))]
    assert [step.split()[0] for step in steps] == ["cmake", "deploy/build/packages.sh"]
    assert " --target programs zloam-graph zloam-sessions zloam-calibrate" in steps[0]
    assert len(tags(checkout)) == 1


@pytest.mark.parametrize("meanwhile", ["touch more", "git checkout -q --detach HEAD~1"])
def test_a_checkout_that_changes_while_it_is_built_is_not_tagged(
    checkout: Path, meanwhile: str
) -> None:
    packing(checkout, meanwhile)
    code, said = released(checkout)
    assert (code, "has changed since its build began" in said) == (1, True), said
    assert tags(checkout) == []


@pytest.mark.parametrize("source", ["/elsewhere", ""])
def test_a_build_of_another_checkout_is_refused(checkout: Path, source: str) -> None:
    configured(checkout, source)
    code, said = released(checkout)
    words = f"build is a build of {source or 'nothing'}, not of this checkout"
    assert (code, words in said, "packages.sh" in said) == (1, True, False), said


def test_nothing_of_an_earlier_release_is_left_among_the_packages(checkout: Path) -> None:
    """The script is run until it makes the wheel, whose script is missing here."""
    script = checkout / "deploy/build/packages.sh"
    script.write_bytes((ROOT / "deploy/build/packages.sh").read_bytes())
    script.chmod(0o755)
    for tool in ("build/packaging/bin/auditwheel", "tools/strip", "tools/dpkg-shlibdeps"):
        place = checkout / tool
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text("#!/bin/sh\n")
        place.chmod(0o755)
    out = checkout / "out"
    out.mkdir()
    for name in ("zloam-0.1.0.whl", "a_0.1.0.deb", "zenoh-loam-0.1.0.cdx.json", "notes.txt"):
        (out / name).touch()
    path = f"{checkout}/tools:{os.environ['PATH']}"
    done = subprocess.run(
        [script, "build", "out"],
        cwd=checkout,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "wheel.py" in done.stderr
    assert [path.name for path in out.iterdir()] == ["notes.txt"]


def test_make_packages_installs_what_it_needs() -> None:
    """Nothing else that is installed brings dpkg-shlibdeps."""
    done = subprocess.run(
        ["make", "-n", "packages"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    steps = [line for line in done.stdout.splitlines() if "deploy/build/" in line]
    assert steps[-2].endswith("deploy/build/deps.sh --packages")
    assert "deploy/build/packages.sh" in steps[-1]
    chosen = re.search(
        r"--packages\) packages\+=\((.*)\)", (ROOT / "deploy/build/deps.sh").read_text()
    )
    assert chosen is not None
    assert {"binutils", "dpkg-dev"} <= set(chosen[1].split())
