"""A subscriber on another host, for tests: a container of its own on the deployment's network,
whose link is made as bad as wished. Loss and rate are the kernel's doing, delay that of a relay in
a container of its own."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass

from tests.system.compose import ROOT, Deployment, inspect

#: a bad link: bits a second, and seconds that both ways take longer
RATE_BIT_PER_S, DELAY_S = 1_000_000, 0.2
#: hears every key of the robot and counts; says so every second, with the age of the last pose
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
    """The subscriber's container."""

    name: str

    def heard(self) -> dict[str, float]:
        """What it had counted a second ago at the latest."""
        said = _run("docker", "logs", "--tail", "1", self.name)
        found: dict[str, float] = json.loads(said or "{}")
        return found

    def _in_network(self, *command: str) -> None:
        process = str(inspect(self.name).pid)
        _run("nsenter", "--target", process, "--net", *command)

    @contextlib.contextmanager
    def losing(self, share: float) -> Iterator[None]:
        """Of the packets in each direction."""
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
        """Nothing passes."""
        with self.losing(1.0):
            yield


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (command, done.stderr)
    return done.stdout


def _host_end(container: str) -> str:
    """The host's end of a container's only network card."""
    number = _run("docker", "exec", container, "cat", "/sys/class/net/eth0/iflink").strip()
    lines = _run("ip", "-o", "link").splitlines()
    line = next(each for each in lines if each.startswith(f"{number}:"))
    return line.split(":")[1].strip().split("@")[0]


@contextlib.contextmanager
def slow(container: str) -> Iterator[None]:
    """What comes to a container, at the rate of a bad link."""
    card = _host_end(container)
    _run("tc", "qdisc", "add", "dev", card, "root", "tbf", "rate", f"{RATE_BIT_PER_S}bit",
         "burst", "32kbit", "latency", "400ms")  # fmt: skip
    try:
        yield
    finally:
        _run("tc", "qdisc", "del", "dev", card, "root")


@contextlib.contextmanager
def relay(deployment: Deployment) -> Iterator[str]:
    """The container of a relay to the router, at its port: both ways as late as on a bad link."""
    words = ("0.0.0.0:7447", "router:7447", str(DELAY_S))
    with _python(deployment, "relay", RELAY, *words) as name:
        yield name


@contextlib.contextmanager
def outside(deployment: Deployment, endpoint: str = "tcp/router:7447") -> Iterator[Outside]:
    """It runs, and connects to the router or to a relay before it."""
    with _python(deployment, "outside", LISTENER, endpoint) as name:
        yield Outside(name)


def _python(
    deployment: Deployment, name: str, program: str, *arguments: str
) -> contextlib.AbstractContextManager[str]:
    image = ("--entrypoint", "python3", "zenoh-loam-monitor")
    return elsewhere(deployment, name, *image, "-c", program, *arguments)


@contextlib.contextmanager
def elsewhere(deployment: Deployment, name: str, *words: str) -> Iterator[str]:
    """A container that stands for another machine, by the last words of `docker run`; gives its
    name. It gets the time that the robot leaves over."""
    container = f"{deployment.project}-{name}"
    _run("docker", "run", "--detach", "--name", container, "--cpu-shares", "2", "--network",
         f"{deployment.project}_default", *words)  # fmt: skip
    try:
        yield container
    finally:
        subprocess.run(["docker", "rm", "--force", container], capture_output=True, check=False)
