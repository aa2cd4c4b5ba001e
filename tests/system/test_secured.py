"""Access from outside: what each role may do, and what is refused. One container runs: the
router."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tests.system.compose import ROOT, free_port

pytestmark = pytest.mark.system
COMMAND = "loam/robot/command/mapping/save"
POSE = "loam/robot/pose"


@dataclass(frozen=True)
class Door:
    """A secured router, and a stage inside that answers queries and publishes."""

    inside: Any
    tls_port: int
    folder: Path
    commands: list[str]


def certificates(folder: Path, *more: str) -> None:
    subprocess.run([ROOT / "deploy/zenoh/certificates.sh", folder, "robot", *more], check=True)


def client(endpoint: str, **tls: object) -> Any:
    """A client that gives up connecting after 3 s."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("connect/timeout_ms", "3000")
    config.insert_json5("scouting/multicast/enabled", "false")
    if tls:
        config.insert_json5("transport/link/tls", json.dumps(tls))
    return zenoh.open(config)


def as_role(door: Door, role: str, folder: Path | None = None) -> Any:
    """A client outside with the certificate of a role."""
    certified = folder or door.folder
    return client(
        f"tls/localhost:{door.tls_port}",
        root_ca_certificate=str(door.folder / "authority.crt"),
        enable_mtls=True,
        connect_certificate=str(certified / f"{role}.crt"),
        connect_private_key=str(certified / f"{role}.key"),
    )


def answers(session: Any, key: str) -> list[bytes]:
    replies = session.get(key, target=zenoh.QueryTarget.ALL, timeout=2.0)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def wait_for_port(port: int, seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while True:
        try:
            with socket.create_connection(("127.0.0.1", port), timeout=1.0):
                return
        except OSError:
            assert time.monotonic() < deadline, f"nobody listens on {port}"
            time.sleep(0.2)


@pytest.fixture(scope="module")
def door(images: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Door]:
    folder = tmp_path_factory.mktemp("tls")
    certificates(folder)
    tcp, tls, name = free_port(), free_port(), f"zloam-door-{os.getpid()}"
    subprocess.run(
        ["docker", "run", "--detach", "--rm", "--name", name, "--user", f"{os.getuid()}",
         "--publish", f"127.0.0.1:{tcp}:7447", "--publish", f"127.0.0.1:{tls}:7448",
         "--volume", f"{folder}:/etc/zloam/tls:ro",
         "--volume", f"{ROOT}/deploy/zenoh/secured.json5:/etc/zloam/secured.json5:ro",
         "zenoh-loam-router", "--config", "/etc/zloam/secured.json5"],
        check=True, capture_output=True,
    )  # fmt: skip
    try:
        # The engine's proxy for published ports accepts connections before the router does, so the
        # router itself is asked.
        for _ in range(50):
            asked = ["docker", "exec", name, "zloam-router", "--health"]
            if subprocess.run(asked, capture_output=True, check=False).returncode == 0:
                break
            time.sleep(0.2)
        wait_for_port(tls)
        inside = client(f"tcp/127.0.0.1:{tcp}")
        commands: list[str] = []

        def command(query: Any) -> None:
            commands.append(str(query.key_expr))
            query.reply(COMMAND, b"done")

        kept = [
            inside.declare_queryable(COMMAND, command),
            inside.declare_queryable("loam/robot/path/map", lambda q: q.reply(q.key_expr, b"path")),
        ]
        yield Door(inside, tls, folder, commands)
        for each in kept:
            each.undeclare()
        inside.close()
    finally:
        subprocess.run(["docker", "kill", name], capture_output=True, check=False)


def test_a_monitor_sees_poses_and_asks_paths(door: Door) -> None:
    session = as_role(door, "monitor")
    poses = session.declare_subscriber(POSE)
    publisher = door.inside.declare_publisher(POSE)
    deadline = time.monotonic() + 10.0
    while (sample := poses.try_recv()) is None:
        assert time.monotonic() < deadline, "no pose came out"
        publisher.put(b"pose")
        time.sleep(0.05)
    assert sample.payload.to_bytes() == b"pose"
    assert answers(session, "loam/robot/path/map") == [b"path"]
    session.close()


def test_a_monitor_calls_no_command(door: Door) -> None:
    session = as_role(door, "monitor")
    before = len(door.commands)
    for key in (COMMAND, "loam/robot/command/**", "loam/robot/**", "**"):
        assert b"done" not in answers(session, key), key
    assert len(door.commands) == before, "it never came in"
    session.close()


def test_a_monitor_puts_nothing(door: Door) -> None:
    heard = door.inside.declare_subscriber("loam/robot/**")
    session = as_role(door, "monitor")
    session.put(POSE, b"forged")
    session.put("loam/robot/lidar/lidar/packets", b"forged")
    # An answer on the same links, requested afterwards, proves that the forged message had time to
    # arrive.
    operator = as_role(door, "operator")
    assert answers(operator, COMMAND) == [b"done"]
    assert heard.try_recv() is None
    for each in (session, operator):
        each.close()
    heard.undeclare()


def test_an_operator_calls_commands(door: Door) -> None:
    session = as_role(door, "operator")
    assert answers(session, COMMAND) == [b"done"]
    session.close()


def test_a_sensor_feeds_packets_and_nothing_else(door: Door) -> None:
    heard = door.inside.declare_subscriber("loam/robot/**")
    session = as_role(door, "sensor")
    deadline = time.monotonic() + 10.0
    while (sample := heard.try_recv()) is None:
        assert time.monotonic() < deadline, "no packets came in"
        session.put(POSE, b"forged")
        session.put("loam/robot/lidar/lidar/packets", b"packets")
        time.sleep(0.05)
    assert str(sample.key_expr) == "loam/robot/lidar/lidar/packets"
    assert answers(session, COMMAND) == []
    session.close()
    heard.undeclare()


def assert_still_open(door: Door) -> None:
    """A router that has ended, or refuses everybody, refuses the right ones, too."""
    as_role(door, "operator").close()


def test_no_certificate_no_link(door: Door) -> None:
    with pytest.raises(zenoh.ZError):
        client(
            f"tls/localhost:{door.tls_port}",
            root_ca_certificate=str(door.folder / "authority.crt"),
        )
    assert_still_open(door)


def test_a_certificate_of_another_authority_is_refused(door: Door, tmp_path: Path) -> None:
    certificates(tmp_path)
    with pytest.raises(zenoh.ZError):
        as_role(door, "operator", tmp_path)
    assert_still_open(door)


def test_an_expired_certificate_is_refused(door: Door) -> None:
    certificates(door.folder, "--role", "late", "0")
    time.sleep(1.1)  # the certificate was valid only for the second in which it was made
    with pytest.raises(zenoh.ZError):
        as_role(door, "late")
    assert_still_open(door)


def test_a_stranger_to_the_rules_may_do_nothing(door: Door) -> None:
    """A valid certificate with a name that no rule mentions."""
    certificates(door.folder, "--role", "visitor")
    session = as_role(door, "visitor")
    assert answers(session, "loam/robot/path/map") == []
    assert answers(session, COMMAND) == []
    session.close()


def test_rest_is_closed(door: Door) -> None:
    inside = [
        "docker",
        "exec",
        f"zloam-door-{os.getpid()}",
        "cat",
        "/proc/net/tcp",
        "/proc/net/tcp6",
    ]
    table = subprocess.run(inside, capture_output=True, text=True, check=True).stdout
    listening = {
        int(line.split()[1].split(":")[1], 16)
        for line in table.splitlines()
        if len(line.split()) > 3 and line.split()[3] == "0A"
    }
    assert listening == {7447, 7448}
