"""Ports of a run's stages: those of the configuration, if they are free."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass

from zloam_monitor import discovery
from zloam_monitor.processes import free_base_port, is_free
from zloam_monitor.robot_file import RobotNames
from zloam_monitor.stages import PORT_ORDER

ANY_HOST = "0.0.0.0"
#: Environment variable for tests: each of several runs on a machine takes any free ports.
FREE_PORTS_VARIABLE = "ZLOAM_FREE_PORTS"
LOOPBACK = "127."


class PortTaken(RuntimeError):
    """A stage cannot listen; the text says where, and which program does."""


@dataclass(frozen=True)
class Ports:
    """The ports of the stages, which are consecutive."""

    base: int
    host: str = discovery.HOST

    def settings(self) -> tuple[str, str]:
        """The stages' options --set."""
        return f"zenoh.base_port={self.base}", f"zenoh.host={self.host}"

    @property
    def endpoint(self) -> str:
        """Integration's endpoint, in the form that other programs connect to."""
        host = socket.gethostname() if self.host == ANY_HOST else self.host
        return f"tcp/{host}:{self.base + PORT_ORDER.index('integration')}"

    def announcement(self, robot: str) -> str:
        """Text that says where the robot listens, and what that permits if it is not loopback."""
        text = f"robot {robot} listens on {self.endpoint}"
        if self.host.startswith(LOOPBACK):
            return text
        last = self.base + PORT_ORDER.index("integration")
        return (
            f"{text}\nopen to the network: whoever reaches ports {self.base} to {last} reads poses "
            "and map and may give commands; for a door with TLS and rules see deploy/README.md"
        )


def is_default(robot: RobotNames) -> bool:
    """True if the ports are the default ones."""
    return robot.base_port == RobotNames().base_port


def configured(robot: RobotNames, listen: str | None = None) -> Ports:
    """Ports of the robot's file, if all are free; `listen`: another address. Raises PortTaken."""
    host = listen or robot.host
    if not robot.base_port or (FREE_PORTS_VARIABLE in os.environ and is_default(robot)):
        return Ports(free_base_port(), host)
    ports = Ports(robot.base_port, host)
    for port, stage in enumerate(PORT_ORDER[: PORT_ORDER.index("integration") + 1], ports.base):
        if not is_free(port, host):
            raise PortTaken(_taken(host, port, stage))
    return ports


def _taken(host: str, port: int, stage: str) -> str:
    if holder := discovery.listeners().get(port):
        why = f"{holder[1]} (process {holder[0]}) listens there: end that run"
    elif host.startswith(LOOPBACK) or host == ANY_HOST:
        why = "another program listens there: end it"
    else:
        why = "another program listens there, or the address is none of this machine: change it"
    return (
        f"{stage} can't listen on {host}:{port}; {why}, or choose other ports: "
        "SET=zenoh.base_port=7560 (--set zenoh.base_port=7560)"
    )
