"""A second host on this machine, as a network namespace, and routers and relays between it and a
robot."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from tests.integration.conftest import ROOT

ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
while True:
    time.sleep(1.0)
"""


def router(endpoint: str) -> list[str]:
    """Command line of a Zenoh router that listens at the endpoint."""
    return [sys.executable, "-c", ROUTER, endpoint]


def relay(listen: str, target: str, delay_s: float) -> list[str]:
    """Command line of a relay from HOST:PORT to HOST:PORT that delays both directions by `delay_s`.
    (The kernels of containers and of test machines often lack netem, which delays packets.)"""
    return [sys.executable, str(ROOT / "tests/relay.py"), listen, target, str(delay_s)]


@dataclass(frozen=True)
class Far:
    """The second host. The stages of this host have to listen at `near_address`, which it can
    reach."""

    name: str
    near_address: str
    address: str
    #: network interface at this host's end of the link
    card: str

    def link(self, state: str) -> None:
        ip("-n", self.name, "link", "set", "far", state)

    def command(self, command: list[str]) -> list[str]:
        return ["ip", "netns", "exec", self.name, *command]

    def slow_down(self, bit_per_s: int) -> None:
        """Limits each direction of the link to this rate."""
        shape = ("root", "tbf", "rate", f"{bit_per_s}bit", "burst", "32kbit", "latency", "400ms")
        for where, card in (((), self.card), (("-n", self.name), "far")):
            _run("tc", *where, "qdisc", "add", "dev", card, *shape)

    def received_bytes(self) -> int:
        """Bytes received by the second host since it was created."""
        counter = "/sys/class/net/far/statistics/rx_bytes"
        return int(_run(*self.command(["cat", counter])))


def _run(*words: str) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


def ip(*words: str) -> None:
    _run("ip", *words)


@contextlib.contextmanager
def far_host() -> Iterator[Far]:
    """Creates the second host; skips the test where network namespaces are not available."""
    if shutil.which("ip") is None:
        pytest.skip("no ip (Debian package iproute2): no network namespace can be made")
    subnet = f"10.77.{os.getpid() % 250}"
    other = Far(f"zloam-{os.getpid()}", f"{subnet}.1", f"{subnet}.2", f"n{os.getpid()}")
    try:
        _connect(other)
    except (OSError, subprocess.CalledProcessError) as error:
        subprocess.run(["ip", "netns", "delete", other.name], check=False, capture_output=True)
        pytest.skip(f"no two hosts can be made here as network namespaces: {error}")
    try:
        yield other
    finally:
        ip("netns", "delete", other.name)


def _connect(other: Far) -> None:
    ip("netns", "add", other.name)
    ip("link", "add", other.card, "type", "veth", "peer", "name", "far", "netns", other.name)
    ip("address", "add", f"{other.near_address}/24", "dev", other.card)
    ip("link", "set", other.card, "up")
    ip("-n", other.name, "address", "add", f"{other.address}/24", "dev", "far")
    ip("-n", other.name, "link", "set", "lo", "up")
    other.link("up")
