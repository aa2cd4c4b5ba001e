"""A subscriber that stands for another host: a container on the deployment's network, whose link
can be made bad. The kernel limits loss and rate; a relay in another container adds the delay."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass

from tests.system.compose import ROOT, Deployment, inspect

#: a bad link: bits per second, and additional seconds in each direction
RATE_BIT_PER_S, DELAY_S = 1_000_000, 0.2
#: subscribes to all keys of the robot; prints its counts and the age of the last pose every second
LISTENER = """
import json, sys, time
from zloam_monitor import records
from zloam_monitor.keys import Keys
from zloam_monitor.link import open_client
robot = Keys("robot")
heard = {"all": 0, "pose": 0, "pose_age_s": 0.0}
def hear(sample):
    heard["all"] += 1
    if str(sample.key_expr) == robot.pose:
        heard["pose"] += 1
        pose = records.map_pose(sample.payload.to_bytes())
        heard["pose_age_s"] = 1e-9 * (time.time_ns() - pose.last_packet_ns)
session = open_client(sys.argv[1:])
subscriber = session.declare_subscriber("loam/**", hear)
while True:
    time.sleep(1.0)
    print(json.dumps(heard), flush=True)
"""

RELAY = (ROOT / "tests/relay.py").read_text()


@dataclass(frozen=True)
class Outside:
    """The container of the subscriber."""

    name: str

    def heard(self) -> dict[str, float]:
        """The counts, at most a second old."""
        said = _run("docker", "logs", "--tail", "1", self.name)
        found: dict[str, float] = json.loads(said or "{}")
        return found

    def _in_network(self, *command: str) -> None:
        process = str(inspect(self.name).pid)
        _run("nsenter", "--target", process, "--net", *command)

    @contextlib.contextmanager
    def losing(self, share: float) -> Iterator[None]:
        """Drops this share of the packets in each direction."""
        chance = ("-m", "statistic", "--mode", "random", "--probability", str(share))
        rules = [(chain, *chance, "-j", "DROP") for chain in ("INPUT", "OUTPUT")]
        for rule in rules:
            self._in_network("iptables", "-A", *rule)
        try:
            yield
        finally:
            for rule in rules:
                self._in_network("iptables", "-D", *rule)

    @contextlib.contextmanager
    def cut(self) -> Iterator[None]:
        """Drops all packets."""
        with self.losing(1.0):
            yield


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (command, done.stderr)
    return done.stdout


def _host_end(container: str) -> str:
    """The host's end of a container's only network interface."""
    number = _run("docker", "exec", container, "cat", "/sys/class/net/eth0/iflink").strip()
    lines = _run("ip", "-o", "link").splitlines()
    line = next(each for each in lines if each.startswith(f"{number}:"))
    return line.split(":")[1].strip().split("@")[0]


@contextlib.contextmanager
def slow(container: str) -> Iterator[None]:
    """Limits the traffic to a container to the rate of a bad link."""
    card = _host_end(container)
    _run("tc", "qdisc", "add", "dev", card, "root", "tbf", "rate", f"{RATE_BIT_PER_S}bit",
         "burst", "32kbit", "latency", "400ms")  # fmt: skip
    try:
        yield
    finally:
        _run("tc", "qdisc", "del", "dev", card, "root")


@contextlib.contextmanager
def relay(deployment: Deployment) -> Iterator[str]:
    """The container of a relay to the router, at the router's port, with a bad link's delay in both
    directions."""
    words = ("0.0.0.0:7447", "router:7447", str(DELAY_S))
    with _python(deployment, "relay", RELAY, *words) as name:
        yield name


@contextlib.contextmanager
def outside(deployment: Deployment, endpoint: str = "tcp/router:7447") -> Iterator[Outside]:
    """Starts the subscriber, connected to the router or to a relay in front of it."""
    with _python(deployment, "outside", LISTENER, endpoint) as name:
        yield Outside(name)


def _python(
    deployment: Deployment, name: str, program: str, *arguments: str
) -> contextlib.AbstractContextManager[str]:
    image = ("--entrypoint", "python3", "zenoh-loam-monitor")
    return elsewhere(deployment, name, *image, "-c", program, *arguments)


@contextlib.contextmanager
def elsewhere(deployment: Deployment, name: str, *words: str) -> Iterator[str]:
    """Yields the name of a container that stands for another machine; `words` are the last
    arguments of `docker run`. It gets only CPU time that the robot leaves over."""
    container = f"{deployment.project}-{name}"
    _run("docker", "run", "--detach", "--name", container, "--cpu-shares", "2", "--network",
         f"{deployment.project}_default", *words)  # fmt: skip
    try:
        yield container
    finally:
        subprocess.run(["docker", "rm", "--force", container], capture_output=True, check=False)
