"""Ports of a run's stages: those of the configuration, if they are free."""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from zloam_monitor import discovery
from zloam_monitor.failures import FileTrouble
from zloam_monitor.processes import free_base_port, listen_error
from zloam_monitor.robot_file import RobotNames
from zloam_monitor.stages import PORT_ORDER, STAGES

#: Hosts that stand for all addresses of a machine.
ANY_HOSTS = ("0.0.0.0", "[::]")
#: Environment variable for tests: each of several runs on a machine takes any free ports.
FREE_PORTS_VARIABLE = "ZLOAM_FREE_PORTS"


class PortTaken(FileTrouble):
    """A program cannot listen; the text says where, and which other one does if that is known."""


def in_url(address: str) -> str:
    """A host as it stands before a port: an IPv6 address is in brackets there."""
    return f"[{address}]" if ":" in address else address


def not_listening(address: str, port: int, error: Exception) -> PortTaken:
    """For a server of this program that could not listen."""
    why = getattr(error, "strerror", "") or error
    return PortTaken(f"can't listen on {in_url(address)}:{port}: {why}")


@dataclass(frozen=True)
class Ports:
    """The ports of the stages: base, plus the stage's place in PORT_ORDER."""

    base: int
    host: str = discovery.HOST
    #: Stages that are started beside the chain.
    beside: Sequence[str] = ()

    def settings(self) -> tuple[str, str]:
        """The stages' options --set."""
        return f"zenoh.base_port={self.base}", f"zenoh.host={self.host}"

    def of_stages(self) -> dict[str, int]:
        """Stage -> port, of the stages that are started."""
        ports = enumerate(PORT_ORDER, self.base)
        return {stage: port for port, stage in ports if stage in (*STAGES, *self.beside)}

    @property
    def endpoint(self) -> str:
        """Integration's endpoint, in the form that other programs connect to."""
        host = socket.gethostname() if self.host in ANY_HOSTS else self.host
        return f"tcp/{host}:{self.of_stages()['integration']}"

    def announcement(self, robot: str) -> str:
        """Text that says where the robot listens, and what that permits if it is not loopback."""
        text = f"robot '{robot}' listens on {self.endpoint}"
        if is_loopback(self.host):
            return text
        ports = _ranges(self.of_stages().values())
        return (
            f"{text}\nopen to the network: whoever reaches ports {ports} reads poses and map and "
            "may give commands; for a door with TLS and rules see deploy/README.md"
        )


def _ranges(ports: Iterable[int]) -> str:
    """Text for ascending numbers, e.g. `7460 to 7464, 7466`."""
    runs: list[list[int]] = []
    for port in ports:
        if runs and port == runs[-1][-1] + 1:
            runs[-1].append(port)
        else:
            runs.append([port])
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


def is_loopback(host: str) -> bool:
    """True if only programs of this machine reach the host."""
    try:
        found = socket.getaddrinfo(host.strip("[]"), None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    return all(ipaddress.ip_address(str(address[0])).is_loopback for *_, address in found)


def is_default(robot: RobotNames) -> bool:
    """True if the ports are the default ones."""
    return robot.base_port == RobotNames().base_port


def configured(robot: RobotNames, listen: str | None = None, beside: Sequence[str] = ()) -> Ports:
    """Ports of the robot's file, if all are free. Raises PortTaken. `listen`: another address;
    `beside`: stages beside the chain."""
    host = listen or robot.host
    if not robot.base_port or (FREE_PORTS_VARIABLE in os.environ and is_default(robot)):
        return Ports(free_base_port(), host, beside)
    ports = Ports(robot.base_port, host, beside)
    for stage, port in ports.of_stages().items():
        if error := listen_error(port, host):
            raise PortTaken(_refused(host, port, stage, error))
    return ports


def _refused(host: str, port: int, stage: str, error: OSError) -> str:
    others = "choose other ports: SET=zenoh.base_port=7560 (--set zenoh.base_port=7560)"
    if error.errno != errno.EADDRINUSE:
        address = "name an address of this machine by zenoh.host or --listen"
        advice = others if error.errno == errno.EACCES else address
        why = f"{error.strerror or error}: {advice}"
    elif holder := discovery.listeners().get(port):
        why = f"{holder[1]} (process {holder[0]}) listens there: end that run, or {others}"
    else:
        why = f"another program listens there: end it, or {others}"
    return f"{stage} can't listen on {host}:{port}; {why}"
