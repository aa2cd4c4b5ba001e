"""The Compose files as `docker compose` itself reads them, with layers and settings of users. No
container is started."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from tests.integration.conftest import needs_compose
from zloam_monitor.robot_file import names
from zloam_monitor.settings import several

ROOT = Path(__file__).resolve().parents[2]
LAYERS = sorted(path.stem for path in (ROOT / "deploy/compose").glob("*.yml"))
#: Compose's own, and what a shell sets
VARIABLE = re.compile(r"(?<!\$)\$\{(\w+)")
#: in .env; a comment shows one that has no default
LISTED = re.compile(r"^#?(\w+)=", re.MULTILINE)
#: Stands for docker in images.sh.
DOCKER = """#!/bin/bash
[ "$1" != compose ] || [ "${{@: -1}}" != build ] || exec {real} "${{@:1:$#-1}}" config --format json
"""
Services = dict[str, dict[str, Any]]


def compose(*words: str, **settings: str) -> str:
    return compose_in(ROOT, *words, **settings)


def compose_in(folder: Path, /, *words: str, **settings: str) -> str:
    """Output of `docker compose`, without the settings of whoever runs the tests."""
    kept = {n: v for n, v in os.environ.items() if not n.startswith(("ZLOAM_", "COMPOSE_", "ROS_"))}
    needs_compose()
    done = subprocess.run(
        ["docker", "compose", *words],
        cwd=folder,
        env={**kept, "ZLOAM_PCAP": str(ROOT / ".env"), **settings},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def services(*layers: str, profile: str = "", **settings: str) -> Services:
    files = ["docker-compose.yml", *(f"deploy/compose/{layer}.yml" for layer in layers)]
    words = [word for file in files for word in ("-f", file)]
    profiles = ["--profile", profile] if profile else []
    found: Services = json.loads(
        compose(*words, *profiles, "config", "--format", "json", **settings)
    )["services"]
    return found


def stages(found: Services) -> Services:
    return {n: s for n, s in found.items() if "ZLOAM_CONFIG" in s.get("environment", {})}


def mounts(service: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {each["target"]: each for each in service["volumes"]}


def test_env_lists_every_setting_of_the_compose_files_once() -> None:
    """Of two lines the second counts: who sets the first would set nothing."""
    listed = LISTED.findall((ROOT / ".env").read_text())
    files = [ROOT / "docker-compose.yml", *(ROOT / "deploy/compose").glob("*.yml")]
    used = {name for file in files for name in VARIABLE.findall(file.read_text())}
    assert len(used) > 30
    assert used - set(listed) == set()
    assert [name for name, times in Counter(listed).items() if times > 1] == []


def test_the_deployment_is_what_compose_file_names() -> None:
    """It may stand in .env, so that a later command means the live deployment, too."""
    plain = compose("config", "--services").split()
    live = compose(
        "config", "--services", COMPOSE_FILE="docker-compose.yml:deploy/compose/live.yml"
    ).split()
    assert set(plain) - set(live) == {"simulate", "monitor", "result"}


def test_without_a_layer_compose_looks_for_its_files_as_always(tmp_path: Path) -> None:
    """From a folder below, and with a user's own override: .env names no files by itself."""
    for name in (".env", "docker-compose.yml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "docker-compose.override.yml").write_text("services: { mine: { image: mine } }\n")
    (tmp_path / "below").mkdir()
    assert "mine" in compose_in(tmp_path / "below", "config", "--services").split()


@pytest.mark.parametrize("layers", [*((layer,) for layer in LAYERS), ("live", "aloam", "views")])
def test_images_sh_builds_every_image_of_the_deployment(
    layers: tuple[str, ...], tmp_path: Path
) -> None:
    """The script itself, with a `docker` that prints what would be built."""
    compose("version")
    (tmp_path / "docker").write_text(DOCKER.format(real=shutil.which("docker")))
    (tmp_path / "docker").chmod(0o755)
    files = ["docker-compose.yml", *(f"deploy/compose/{layer}.yml" for layer in layers)]
    kept = {n: v for n, v in os.environ.items() if not n.startswith("ZLOAM_")}
    path = f"{tmp_path}:{os.environ['PATH']}"
    done = subprocess.run(
        [ROOT / "deploy/docker/images.sh"],
        env={**kept, "PATH": path, "COMPOSE_FILE": ":".join(files)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["services"].values()
    built = {s["image"] for s in found if "build" in s}
    assert built >= {"zenoh-loam", "zenoh-loam-router", "zenoh-loam-monitor"}
    assert {s["image"] for s in found} == built


def image_script(name: str, tmp_path: Path, docker: str | None, *words: str) -> tuple[int, str]:
    """A script of deploy/docker in a copy of what it reads; `docker`: the script in its place."""
    for file in (
        ".env",
        f"deploy/docker/{name}.sh",
        "deploy/docker/base.sh",
        "deploy/docker/base-image.sh",
    ):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        if not (tmp_path / file).exists():
            shutil.copy(ROOT / file, tmp_path / file)
    tools = tmp_path / "tools"
    tools.mkdir()
    for tool in ("bash", "sh", "dirname", "sed", "grep", "tail", "mktemp", "rm"):
        (tools / tool).symlink_to(str(shutil.which(tool)))
    if docker is not None:
        (tools / "docker").write_text(f"#!/bin/bash\n{docker}\n")
        (tools / "docker").chmod(0o755)
    done = subprocess.run(
        [tmp_path / f"deploy/docker/{name}.sh", *words],
        env={"PATH": str(tools), "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("docker", "words"),
    [
        (None, "Docker is not installed: apt install docker.io"),
        ("echo permission denied >&2; exit 1", "does not answer: permission denied"),
        ('[ "$1" = info ]', "docker-compose docker-buildx debian:trixie-slim can't be made"),
        ('[ "$1" != buildx ]', "base-image: docker-buildx can't be made without mmdebstrap"),
    ],
)
def test_what_building_images_lacks_is_named(
    docker: str | None, words: str, tmp_path: Path
) -> None:
    """A machine without Docker was told to install mmdebstrap, by a command that does it only where
    Docker answers."""
    code, said = image_script("images", tmp_path, docker)
    assert (code, words in said) == (3, True), said


def test_images_sh_refuses_words_that_it_does_not_know(tmp_path: Path) -> None:
    code, said = image_script("images", tmp_path, "echo built", "--prebuild")
    assert (code, "--prebuilt" in said, "built\n" in said) == (2, True, False), said


def test_images_for_arm64_take_the_build_settings_of_env(tmp_path: Path) -> None:
    (tmp_path / ".env").write_text('ZLOAM_BASE="debian:bookworm-slim"\nZLOAM_BUILD_NETWORK=host\n')
    code, said = image_script("arm64", tmp_path, 'echo "$@"')
    assert code == 0, said
    assert "--network host --build-arg BASE=debian:bookworm-slim --build-arg JOBS=2" in said


@pytest.mark.parametrize("layer", ["", *LAYERS])
def test_the_robots_files_are_those_of_the_checkout(layer: str, tmp_path: Path) -> None:
    """An image's own would be the files of the time when it was built."""
    for settings, folder in (
        ({}, ROOT / "deploy/robots"),
        ({"ZLOAM_ROBOTS": "mine"}, ROOT / "mine"),
    ):
        layers = ["replay", layer] if layer == "imu" else [layer] if layer else []
        found = stages(services(*layers, ZLOAM_IMU=str(tmp_path), **settings))
        assert len(found) >= 6
        for name, service in found.items():
            mounted = mounts(service)["/etc/zloam"]
            assert (mounted["type"], mounted["source"]) == ("bind", str(folder)), name
            assert mounted["read_only"], name


@pytest.mark.parametrize("layer", ["preview", "ros"])
def test_layers_with_a_stage_are_among_them(layer: str) -> None:
    assert layer in stages(services(layer))


def test_the_source_of_a_live_driver_is_that_of_the_robot_file() -> None:
    assert "driver." not in services("live")["driver"]["environment"]["ZLOAM_SET"]


@pytest.mark.parametrize(
    ("layers", "wanted"),
    [
        (("standby",), dict.fromkeys(("registration", "odometry", "mapping", "integration"), 2)),
        (("replicas",), {"registration": 3}),
    ],
)
def test_several_containers_of_a_stage_share_no_port(
    layers: tuple[str, ...], wanted: dict[str, int]
) -> None:
    """Docker gives a port of the host to one container only: the second would not start."""
    for found in (services(*layers), services("live", *layers)):
        numbers = {name: s.get("deploy", {}).get("replicas", 1) for name, s in found.items()}
        assert {name: n for name, n in numbers.items() if n > 1} == wanted
        assert [name for name in wanted if found[name].get("ports")] == []


@pytest.mark.parametrize("folder", ["results", "capture", "tiles", "./out"])
def test_the_folder_of_results_is_no_volume(folder: str) -> None:
    found = services("two-robots", ZLOAM_OUT=folder)
    wanted = {"": ROOT / folder, "2": ROOT / folder / "robot2"}
    for number, path in wanted.items():
        for stage in ("mapping", "integration"):
            mounted = mounts(found[stage + number])["/out"]
            assert (mounted["type"], mounted["source"]) == ("bind", str(path)), stage


def test_the_second_robot_s_results_get_the_owner_of_the_first_s() -> None:
    """Whoever runs as root makes the folder as root, where no stage could write."""
    prepare = services("two-robots")["prepare"]
    assert mounts(prepare)["/out2"]["source"] == str(ROOT / "out/robot2")
    assert mounts(prepare)["/out"]["source"] == str(ROOT / "out")
    assert 'chown "$$OWNER" /out* ' in prepare["command"][0]


def test_two_robots_have_two_names_whatever_is_set() -> None:
    found = stages(services("two-robots", ZLOAM_SET="robot=alpha mapping.mode=map"))
    assert {n for n in found if n.endswith("2")} > {"driver2", "mapping2"}
    for name, service in found.items():
        settings = several(service["environment"]["ZLOAM_SET"])
        robot = names(ROOT / "deploy/robots/vlp16-outdoor.yaml", settings).robot
        assert robot == ("robot2" if name.endswith("2") else "alpha"), name


def test_the_monitor_follows_the_robot_of_the_stages(tmp_path: Path) -> None:
    found = services(ZLOAM_SET="robot=alpha sensor.name=top", ZLOAM_CONFIG="mine")
    (tmp_path / "python3").write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    (tmp_path / "python3").chmod(0o755)
    environment = {**found["monitor"]["environment"], "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    script = [ROOT / "deploy/docker/zloam-monitor", *found["monitor"]["command"]]
    done = subprocess.run(script, env=environment, capture_output=True, text=True, check=True)
    words = done.stdout.splitlines()
    assert words[words.index("--config") + 1] == "/etc/zloam/mine.yaml"
    assert "--settings=robot=alpha sensor.name=top" in words
    assert words[-2:] == ["--ended-file", "/dev/shm/zloam-run-ended"]
    assert "/etc/zloam" in mounts(found["monitor"])


@pytest.mark.parametrize("layers", [("live",), ("live", "standby"), ("live", "replicas")])
def test_with_tls_the_driver_finds_the_plain_port_where_it_is(layers: tuple[str, ...]) -> None:
    """Where stages publish no port it is the driver's only way to them."""
    found = services(*layers, "secured", ZLOAM_ROUTER_PORT="127.0.0.1:7450")
    ports = {p["target"]: (p.get("host_ip"), p["published"]) for p in found["router"]["ports"]}
    assert ports == {7447: ("127.0.0.1", "7450"), 7448: (None, "7448")}
    assert found["driver"]["environment"]["ZLOAM_CONNECT"] == "tcp/127.0.0.1:7450"


@pytest.mark.parametrize(
    ("port", "starts"),
    [("127.0.0.1:7450", True), ("0.0.0.0:7447", False), ("7447", False), ("10.0.0.2:7447", False)],
)
def test_with_tls_an_open_plain_port_is_refused(port: str, starts: bool, tmp_path: Path) -> None:
    router = services("secured", ZLOAM_ROUTER_PORT=port)["router"]
    (tmp_path / "with-run").write_text('#!/bin/sh\necho "$@"\n')
    (tmp_path / "with-run").chmod(0o755)
    # `config` prints a dollar sign of the container as two.
    command = [word.replace("$$", "$") for word in (*router["entrypoint"], *router["command"])]
    path = f"{tmp_path}:{os.environ['PATH']}"
    environment = {**router["environment"], "PATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if starts:
        assert done.stdout == "zloam-router --config /etc/zloam/secured.json5\n"
    else:
        assert done.returncode == 2
        assert f"ZLOAM_ROUTER_PORT is {port}," in done.stderr
