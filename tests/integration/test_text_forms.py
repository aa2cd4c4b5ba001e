"""Commands of README.md and deploy/README.md that are not run, and those of the other documents'
listings: their programs have the subcommands and options, and the files that they name exist.
Excluded commands have a reason."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.integration import text_commands as texts
from tests.integration.conftest import ROOT, needs_compose
from tests.integration.text_commands import Excluded, Form

FORMS = [command for command, kind in texts.COMMANDS.items() if isinstance(kind, Form)]
#: environment variables without which a Compose layer is refused
LAYER_VARIABLES = {"ZLOAM_PCAP": "/drive.pcap", "ZLOAM_IMU": "/imu.csv"}
#: options that take a value
VALUED = (
    "-f",
    "-n",
    "-k",
    "--scale",
    "--voxel",
    "--x",
    "--y",
    "--yaw",
    "--from",
    "--connect",
    "--config",
    "--out",
)
#: commands with subcommands
GROUPS = ("loop", "map", "config")


def run(*command: str | Path, env: dict[str, str] | None = None) -> str:
    """Output of a command that must succeed."""
    # Without the variables of the `make test` that may run this test.
    kept = {n: v for n, v in os.environ.items() if not n.startswith("MAKE")}
    done = subprocess.run(
        command,
        cwd=ROOT,
        env={**kept, **(env or {})},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{command}: {done.stdout}"
    return done.stdout


def assert_known(options: list[str], help_text: str) -> None:
    names = [option.split("=")[0] for option in options]
    assert [n for n in names if not re.search(rf"(?<![\w-]){n}(?![\w-])", help_text)] == []


def split(words: list[str]) -> tuple[list[str], list[str]]:
    """(words that are no options, options); the values of the options in VALUED are in neither."""
    plain, options, value = [], [], False
    for word in words:
        if value:
            value = False
        elif word.startswith("-"):
            options.append(word)
            value = word in VALUED
        else:
            plain.append(word)
    return plain, options


def zloam(words: list[str]) -> None:
    plain, options = split(words[1:])
    verb = plain[: 2 if plain[0] in GROUPS else 1]
    help_text = run(ROOT / "bin/zloam", *verb, "--help", env={"COLUMNS": "200"})
    assert_known(options, help_text)
    for argument in plain[len(verb) :]:
        assert argument.lower() in help_text.lower(), f"{argument} in {help_text}"


def program(words: list[str]) -> None:
    """Checks a command line of one of the stages."""
    build = Path(os.environ.get("ZLOAM_BUILD", ROOT / "build/release"))
    path = build / "bin" / words[0]
    if not path.is_file():
        pytest.skip(f"not built: {path}")
    assert_known(words[1:], run(path, "--help"))


def make(words: list[str]) -> None:
    run("make", "--dry-run", "-o", "build", "-o", "build-all", *words[1:])


def script(words: list[str]) -> None:
    assert os.access(ROOT / words[0], os.X_OK)
    run("bash", "-n", ROOT / words[0])


def pytest_files(words: list[str]) -> None:
    assert all((ROOT / word).is_file() for word in words[1:])


def docker(words: list[str]) -> None:
    if shutil.which("docker") is None:
        pytest.skip("no docker: its words are not checked")
    if words[1] == "compose":
        compose(words[2:])
        return
    plain, options = split(words[1:])
    help_text = run("docker", plain[0], "--help")
    # `docker` prints its general help for unknown words.
    assert re.search(rf"Usage:\s+docker {plain[0]}\b", help_text), help_text
    own = options[: 1 if words[1] == "run" else None]  # others: the container's program
    assert_known(own, help_text)


def values(words: list[str], option: str) -> list[str]:
    return [value for name, value in itertools.pairwise(words) if name == option]


def compose(words: list[str]) -> None:
    files = values(words, "-f") or ["docker-compose.yml"]
    assert [f for f in files if not (ROOT / f).is_file()] == []
    needs_compose()
    layers = [word for file in files for word in ("-f", file)]
    listed = ["docker", "compose", *layers, "config", "--services"]
    shown = run(*listed, env=LAYER_VARIABLES).splitlines()
    plain, options = split(words)
    named = {"up": plain[1:], "logs": plain[1:], "exec": plain[1:2], "run": plain[1:2]}
    services = named.get(plain[0], [])
    if plain[0] in ("exec", "run"):  # later options belong to the container's program
        options = split(words[: words.index(services[0])])[1]
    known = run("docker", "compose", plain[0], "--help")
    assert_known([o for o in options if o != "-f"], known)
    scaled = [value.split("=")[0] for value in values(words, "--scale")]
    assert [s for s in (*services, *scaled) if s not in shown] == []


def resources(folder: Path) -> list[dict[str, Any]]:
    """The resources of a kustomization and of those that it builds on."""
    found: list[dict[str, Any]] = []
    for name in yaml.safe_load((folder / "kustomization.yaml").read_text()).get("resources", []):
        path = folder / name
        if path.is_dir():
            found += resources(path)
        else:
            found += [r for r in yaml.safe_load_all(path.read_text()) if r]
    return found


def kubectl(words: list[str]) -> None:
    for folder in values(words, "-k"):
        assert resources(ROOT / folder)
    overlays = [resources(ROOT / "deploy/kubernetes" / each) for each in ("live", "simulated")]
    names = {(r["kind"], r["metadata"]["name"]) for each in overlays for r in each}
    for space in values(words, "-n"):
        assert ("Namespace", space) in names
    plain, _ = split(words[1:])
    if plain[0] == "scale":
        assert ("Deployment", plain[2]) in names
    if plain[0] == "delete":
        assert (plain[1].capitalize(), plain[2]) in names
    if plain[0] == "rollout":
        assert plain[1] in ("restart", "status")
        assert plain[2].capitalize() in {kind for kind, _ in names}
    if plain[0] == "label":
        label, _, value = plain[3].partition("=")
        text = "".join(p.read_text() for p in (ROOT / "deploy/kubernetes/live").glob("*.yaml"))
        assert re.search(rf"{re.escape(label)}: [\"']?{value}\b", text)


def python(words: list[str]) -> None:
    """Checks a script that is run by the packages of `make build`."""
    assert words[0] == ".venv/bin/python", "the system's Python lacks the packages"
    assert (ROOT / words[1]).is_file()


CHECKS: dict[str, Callable[[list[str]], None]] = {
    "make": make,
    "docker": docker,
    "kubectl": kubectl,
    "pytest": pytest_files,
    **dict.fromkeys(("python", "python3", ".venv/bin/python"), python),
    "zloam": zloam,
    "bin/zloam": zloam,
}


def check_of(first: str) -> Callable[[list[str]], None]:
    if first in CHECKS:
        return CHECKS[first]
    return script if first.startswith("deploy/") else program


def listed() -> list[str]:
    """The commands of the other documents' listings, as far as they can be checked."""
    documents = sorted([*ROOT.glob("docs/*.md"), *ROOT.glob("services/*/README.md")])
    found = [
        command
        for document in documents
        for language, lines in texts.listings(document.read_text())
        if language in ("sh", "bash")
        for command in texts.commands_of_listing(lines)
    ]
    known = (*CHECKS, "zloam-")
    return [each for each in dict.fromkeys(found) if texts.words(each)[0].startswith(known)]


@pytest.mark.parametrize("command", listed())
def test_the_words_of_a_listing_are_known(command: str) -> None:
    words = texts.words(command)
    check_of(words[0])(words)


@pytest.mark.parametrize("command", FORMS)
def test_its_words_are_known(command: str) -> None:
    words = texts.words(command)
    check_of(words[0])(words)


@pytest.mark.parametrize(
    "command",
    [
        "make tea",
        "docker compose up --strong",
        "docker compose up driver9",
        "docker compose run --rm monitor9 watch",
        "docker compose run --strong monitor watch",
        "docker compose -f deploy/compose/none.yml up",
        "docker brew",
        "zloam brew",
        "zloam demo --strong",
        "zloam-mapping --strong",
        "deploy/build/none.sh",
        "pytest tests/none.py",
        "python services/monitor/examples/publish_sweeps.py tcp/127.0.0.1:7461",
        ".venv/bin/python services/monitor/examples/none.py",
        "kubectl apply -k deploy/kubernetes/none",
        "kubectl -n zenoh-loam scale deployment none --replicas=3",
        "kubectl -n zenoh-loam delete job none",
        "kubectl -n zenoh-loam rollout restart none",
        "kubectl label node NODE zenoh-loam/sensor=none",
    ],
)
def test_a_wrong_word_is_noticed(command: str) -> None:
    words = texts.words(command)
    with pytest.raises((AssertionError, OSError)):
        check_of(words[0])(words)


def test_exclusions_have_a_reason() -> None:
    excluded = [k for k in texts.COMMANDS.values() if isinstance(k, Excluded)]
    assert excluded
    assert all(len(k.reason) > 10 for k in excluded)


def test_who_tries_the_others_is_there() -> None:
    named = 0
    for command, kind in texts.COMMANDS.items():
        if isinstance(kind, Form):
            for path in re.findall(r"[\w/]*tests/\S+?\.py", kind.tried_by):
                assert (ROOT / path).is_file(), command
                named += 1
    assert named, "no path was recognised"


def test_each_folder_of_services_is_described() -> None:
    folders = {path.name for path in (ROOT / "services").iterdir() if (path / "README.md").exists()}
    text = (ROOT / "services/README.md").read_text()
    described = set(re.findall(r"^\| `(\w+)/` \|", text, re.MULTILINE))
    assert described - {"common"} == folders - {"common"}
