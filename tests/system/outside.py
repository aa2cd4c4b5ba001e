"""A subscriber on another host, for tests: a container of its own on the deployment's network,
whose link is made as bad as wished. Loss and rate are the kernel's doing, delay that of a relay."""

from __future__ import annotations

import asyncio
import contextlib
import json
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass

from tests.system.compose import Deployment, inspect

#: hears every key of the robot and counts; says so at the end
LISTENER = """
import json, signal, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:]))
config.insert_json5("connect/timeout_ms", "-1")
config.insert_json5("connect/exit_on_failure", "false")
config.insert_json5("scouting/multicast/enabled", "false")
heard = {"all": 0, "pose": 0, "newest": 0.0}
def hear(sample):
    heard["all"] += 1
    if str(sample.key_expr) == "loam/robot/pose":
        heard["pose"] += 1
        heard["newest"] = time.time()
session = zenoh.open(config)
subscriber = session.declare_subscriber("loam/**", hear)
while True:
    time.sleep(1.0)
    print(json.dumps(heard), flush=True)
"""


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
        rules = [
            (
                chain,
                "-m",
                "statistic",
                "--mode",
                "random",
                "--probability",
                str(share),
                "-j",
                "DROP",
            )
            for chain in ("INPUT", "OUTPUT")
        ]
        for rule in rules:
            self._in_network("iptables", "-A", *rule)
        yield
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
def slow(container: str, bits_per_s: int) -> Iterator[None]:
    """What comes to a container, at so many bits a second."""
    card = _host_end(container)
    _run("tc", "qdisc", "add", "dev", card, "root", "tbf", "rate", f"{bits_per_s}bit",
         "burst", "32kbit", "latency", "400ms")  # fmt: skip
    try:
        yield
    finally:
        _run("tc", "qdisc", "del", "dev", card, "root")


async def _late(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, delay_s: float) -> None:
    """Hands on what comes, in order, so much later; the other end may go on sending meanwhile."""
    clock = asyncio.get_running_loop()
    waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def hand_on() -> None:
        while True:
            due, chunk = await waiting.get()
            await asyncio.sleep(max(0.0, due - clock.time()))
            if not chunk:
                writer.close()
                return
            writer.write(chunk)
            await writer.drain()

    sender = asyncio.create_task(hand_on())
    with contextlib.suppress(ConnectionError):
        while chunk := await reader.read(65536):
            waiting.put_nowait((clock.time() + delay_s, chunk))
    waiting.put_nowait((clock.time() + delay_s, b""))
    with contextlib.suppress(ConnectionError):
        await sender


@contextlib.contextmanager
def relay(address: str, port: int, delay_s: float) -> Iterator[str]:
    """The endpoint of a relay to the router's port on this host: both ways so much later."""
    loop = asyncio.new_event_loop()

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError, asyncio.CancelledError):
            there = await asyncio.open_connection("127.0.0.1", port)
            await asyncio.gather(_late(reader, there[1], delay_s), _late(there[0], writer, delay_s))

    server = loop.run_until_complete(asyncio.start_server(accept, address, 0))
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield f"tcp/{address}:{server.sockets[0].getsockname()[1]}"
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        for task in asyncio.all_tasks(loop):
            task.cancel()
        loop.run_until_complete(asyncio.sleep(0.1))
        loop.close()


def gateway(deployment: Deployment) -> str:
    """The host's own address on the deployment's network."""
    (found,) = json.loads(_run("docker", "network", "inspect", f"{deployment.project}_default"))
    return str(found["IPAM"]["Config"][0]["Gateway"])


@contextlib.contextmanager
def outside(deployment: Deployment, endpoint: str = "tcp/router:7447") -> Iterator[Outside]:
    """It runs, and connects to the router or to a relay before it."""
    name = f"{deployment.project}-outside"
    _run("docker", "run", "--detach", "--rm", "--name", name, "--network",
         f"{deployment.project}_default", "--entrypoint", "python3", "zenoh-loam-monitor", "-c",
         LISTENER, endpoint)  # fmt: skip
    try:
        yield Outside(name)
    finally:
        subprocess.run(["docker", "kill", name], capture_output=True, check=False)
