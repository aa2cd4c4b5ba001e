"""One deployment by Docker Compose, with its own project name and ports."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


#: attempts at listing the containers, which fails if one disappears meanwhile
LISTINGS = 5


class NotInTime(AssertionError):
    """A condition did not become true within its limit."""


class CommandFailed(AssertionError):
    """A Compose command failed; the text has its whole output."""


def free_port() -> int:
    """A TCP port of the loopback interface that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass(frozen=True)
class Container:
    """A container as reported by the engine; `pid` is its main process on this host, 0 if it does
    not run."""

    name: str
    pid: int
    restarts: int
    health: str
    address: str
    hostname: str


def inspect(name: str) -> Container:
    asked = ["docker", "inspect", name]
    (found,) = json.loads(subprocess.run(asked, check=True, capture_output=True).stdout)
    state = found["State"]
    networks = found["NetworkSettings"]["Networks"].values()
    return Container(
        name,
        int(state["Pid"]),
        int(found["RestartCount"]),
        state.get("Health", {}).get("Status", ""),
        next((n["IPAddress"] for n in networks), ""),
        str(found["Config"]["Hostname"]),
    )


@dataclass
class Deployment:
    """`docker compose` with fixed files and environment."""

    project: str
    out: Path
    layers: list[str] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)
    router_port: int = field(default_factory=free_port)

    def command(self, *arguments: str) -> list[str]:
        files = [a for layer in ("docker-compose.yml", *self.layers) for a in ("-f", layer)]
        return ["docker", "compose", "-p", self.project, *files, *arguments]

    def variables(self) -> dict[str, str]:
        """The environment of every call: the variables of .env that this deployment sets."""
        return {
            **os.environ,
            "ZLOAM_OUT": str(self.out),
            "ZLOAM_UID": str(os.getuid() or 1000),
            "ZLOAM_GID": str(os.getgid() or 1000),
            "ZLOAM_ROUTER_PORT": f"127.0.0.1:{self.router_port}",
            # Most tests query the containers after the run.
            "ZLOAM_AFTER": "stay",
            **self.environment,
        }

    def run(self, *arguments: str, check: bool = True) -> str:
        """Standard output; with `check` a failure raises CommandFailed with the whole output."""
        done = subprocess.run(
            self.command(*arguments),
            cwd=ROOT,
            env=self.variables(),
            capture_output=True,
            text=True,
            check=False,
        )
        if check and done.returncode != 0:
            said = done.stdout + done.stderr
            raise CommandFailed(f"{' '.join(arguments)} ended with {done.returncode}:\n{said}")
        return done.stdout

    def listed(self, *services: str) -> list[dict[str, Any]]:
        """What `docker compose ps` reports of each container. It lists containers first and
        inspects them afterwards, so it fails if one disappears in between (a name reused while `up`
        creates containers); then it is repeated."""
        for _ in range(LISTINGS):
            try:
                lines = self.run("ps", "--all", "--format", "json", *services).splitlines()
            except CommandFailed as error:
                if "No such container" not in str(error):
                    raise
            else:
                return [json.loads(line) for line in lines if line.startswith("{")]
        raise CommandFailed(f"the containers of {self.project} change faster than they are listed")

    def containers(self) -> dict[str, dict[str, Any]]:
        """Service -> what `docker compose ps` reports of its container."""
        return {str(each["Service"]): each for each in self.listed()}

    def wait(self, what: str, seconds: float, condition: Any) -> float:
        """Waits until condition(containers) holds; returns the seconds that it took."""
        began = time.monotonic()
        while True:
            containers = self.containers()
            if condition(containers):
                return time.monotonic() - began
            if time.monotonic() - began > seconds:
                states = {n: (c["State"], c.get("Health")) for n, c in containers.items()}
                logs = self.run("logs", "--no-color", "--tail", "15", check=False)
                raise NotInTime(f"not {what} within {seconds:.0f} s: {states}\n{logs}")
            time.sleep(0.5)

    def replicas(self, service: str) -> list[Container]:
        """All containers of a service, ordered by their names."""
        return [inspect(name) for name in sorted(str(c["Name"]) for c in self.listed(service))]

    def kill(self, service: str, replica: int = 0) -> Container:
        """Sends SIGKILL from the host to the main process of a container, and returns the
        container's previous state. After `docker kill` the engine would not restart it."""
        killed = self.replicas(service)[replica]
        assert killed.pid > 0, f"{service} does not run"
        os.kill(killed.pid, signal.SIGKILL)
        return killed

    def wait_back(self, service: str, killed: Container, seconds: float) -> Container:
        """Waits until the container is healthy with a new process."""
        found: list[Container] = []

        def back(_: object) -> bool:
            found[:] = [inspect(killed.name)]
            return found[0].pid not in (0, killed.pid) and found[0].health == "healthy"

        self.wait(f"{service} back", seconds, back)
        return found[0]

    def shared_bytes(self) -> int:
        """Used bytes of the /dev/shm that the containers share."""
        said = self.run("exec", "-T", "store", "stat", "-f", "-c", "%b %f %S", "/dev/shm")
        blocks, free, size = map(int, said.split())
        return (blocks - free) * size

    def leftovers(self) -> dict[str, list[str]]:
        """What is left of this project. Of volumes only mounted ones count, since data volumes
        remain on purpose."""
        label = f"label=com.docker.compose.project={self.project}"

        def names(*command: str) -> list[str]:
            listed = subprocess.run(
                ["docker", *command, "--quiet", "--filter", label],
                capture_output=True,
                text=True,
                check=True,
            )
            return listed.stdout.split()

        mounts = Path("/proc/mounts").read_text().splitlines()
        return {
            "containers": names("ps", "--all"),
            "networks": names("network", "ls"),
            "mounts": [line for line in mounts if f"/{self.project}_" in line],
        }
