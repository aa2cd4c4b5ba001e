"""Finds the robots that can be reached: on this machine without being told where, or at endpoints.

On this machine candidates are the default ports (integration's, and the containers' router's) and
every port on which a zloam program of this machine listens. Each candidate is asked by a session of
its own: one session linked to two robots would introduce their stages to each other.
"""

from __future__ import annotations

import re
import socket
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zloam_monitor.keys import Keys
from zloam_monitor.link import Link, LinkError, open_client, open_session
from zloam_monitor.stages import STAGES

HOST = "127.0.0.1"
#: of integration, and of the router in docker-compose.yml
DEFAULT_PORTS = (7464, 7447)
#: an answer of a program on this machine takes milliseconds; a connection over a network, which
#: others may fill, some hundred
CONNECT_SECONDS = 2.0
ANSWER_SECONDS = 2.0
#: at an endpoint that was named: on a link with 200 ms of delay, to open a session takes a second,
#: and several where other views fill it
FAR_SECONDS = 15.0
#: siblings of the first stage that answers are heard within this
SIBLING_SECONDS = 0.6
_ENDPOINT = re.compile(
    r"^(?P<protocol>[a-z][a-z0-9_-]*)/(?P<address>.+):(?P<port>\d+)(?P<rest>[?#].*)?$"
)
_PLAIN = re.compile(r"^(?P<host>\[[0-9a-fA-F:]+\]|[^\s/:]+)(:(?P<port>\d+))?$")
_ALIVE_KEY = re.compile(r"^loam/(?P<robot>[^/]+)/service/(?P<stage>[^/]+)/(?P<instance>[^/]+)/")


class NothingAnswers(RuntimeError):
    """No robot is there, or not the one that was asked for; the text says what to check."""


@dataclass(frozen=True)
class Found:
    """A robot, where it answers, and which of its stages were heard."""

    robot: str
    endpoint: str
    instances: tuple[tuple[str, str], ...]
    #: that answers for the stages
    router: bool = False

    @property
    def stages(self) -> list[str]:
        heard = {stage for stage, _ in self.instances}
        known = [stage for stage in STAGES if stage in heard]
        return known + sorted(heard - set(known))

    def __str__(self) -> str:
        return f"robot {self.robot} at {self.endpoint} ({', '.join(self.stages)})"


def endpoint_of(text: str) -> str:
    """tcp/HOST:PORT of what a user writes: that itself, HOST:PORT, or HOST."""
    if match := _ENDPOINT.match(text):
        _checked_port(text, match["port"])
        return text
    if match := _PLAIN.match(text):
        port = match["port"] or str(DEFAULT_PORTS[0])
        _checked_port(text, port)
        return f"tcp/{match['host']}:{port}"
    raise NothingAnswers(
        f"'{text}' is no endpoint: PROTOCOL/HOST:PORT is expected, e.g. "
        f"tcp/{HOST}:{DEFAULT_PORTS[0]}"
    )


def _checked_port(text: str, port: str) -> None:
    if not 0 < int(port) < 65536:
        raise NothingAnswers(f"'{text}' is no endpoint: port {port} is not in 1 to 65535")


def _listening() -> dict[int, int]:
    """Inode -> TCP port of every listening socket of this network name space."""
    found = {}
    for table in (Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6")):
        try:
            rows = table.read_text().splitlines()[1:]
        except OSError:
            continue
        for row in rows:
            cells = row.split()
            if cells[3] == "0A":
                found[int(cells[9])] = int(cells[1].rpartition(":")[2], 16)
    return found


def _sockets(process: Path) -> Iterator[int]:
    """Inodes; none where the process belongs to somebody else."""
    try:
        for descriptor in (process / "fd").iterdir():
            target = str(descriptor.readlink())
            if target.startswith("socket:["):
                yield int(target[8:-1])
    except OSError:
        return


def listeners() -> dict[int, tuple[int, str]]:
    """Port -> (pid, name) of each zloam program that listens here."""
    ports = _listening()
    found = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            name = (process / "comm").read_text().strip()
        except OSError:
            continue
        if name.startswith("zloam-"):
            for inode in _sockets(process):
                if inode in ports:
                    found[ports[inode]] = (int(process.name), name)
    return found


def candidates() -> list[str]:
    """Where a robot may answer; one whose ports are others' is found by its integration first."""
    own = sorted(listeners().items(), key=lambda each: not each[1][1].startswith("zloam-integ"))
    ports = dict.fromkeys([*DEFAULT_PORTS, *(port for port, _ in own)])
    return [f"tcp/{HOST}:{port}" for port in ports]


def refusal(endpoint: str) -> str | None:
    """Why nobody takes a TCP connection there; None: somebody does, or the protocol is another."""
    match = _ENDPOINT.match(endpoint)
    if match is None or match["protocol"] != "tcp":
        return None
    address = match["address"].strip("[]"), int(match["port"])
    outcome: list[str | None] = []

    def connect() -> None:
        try:
            socket.create_connection(address, timeout=CONNECT_SECONDS).close()
            outcome.append(None)
        except OSError as error:
            outcome.append(error.strerror or str(error))

    # the resolver of names has no time limit of its own
    attempt = threading.Thread(target=connect, daemon=True)
    attempt.start()
    attempt.join(2 * CONNECT_SECONDS)
    return outcome[0] if outcome else "timed out"


def _answers(session: Any, seconds: float) -> set[tuple[str, str, str]]:
    """(robot, stage, instance) of all that live: a router also keeps statuses of the dead."""
    found = set()
    for reply in session.liveliness().get("loam/*/service/*/*/alive", timeout=seconds):
        if reply.ok is not None and (match := _ALIVE_KEY.match(str(reply.ok.key_expr))):
            found.add((match["robot"], match["stage"], match["instance"]))
    return found


def _heard(session: Any, seconds: float) -> set[tuple[str, str, str]]:
    """All who answer: the first may take a while, the others follow it."""
    ends = time.monotonic() + seconds
    heard: set[tuple[str, str, str]] = set()
    while (now := time.monotonic()) < ends:
        more = _answers(session, ends - now) - heard
        if more and not heard:
            ends = min(ends, now + SIBLING_SECONDS)
        heard |= more
        robots = {robot for robot, _, _ in heard}
        if robots and all(
            {stage for robot, stage, _ in heard if robot == each} >= set(STAGES) for each in robots
        ):
            break
        time.sleep(0.05)
    return heard


def _robots(endpoint: str, heard: Iterable[tuple[str, str, str]], router: bool) -> list[Found]:
    by_robot: dict[str, list[tuple[str, str]]] = {}
    for robot, stage, instance in heard:
        by_robot.setdefault(robot, []).append((stage, instance))
    return [
        Found(robot, endpoint, tuple(sorted(each)), router)
        for robot, each in sorted(by_robot.items())
    ]


def ask(endpoint: str, seconds: float = ANSWER_SECONDS) -> list[Found]:
    """The robots that answer at an endpoint within so long after somebody took the connection."""
    if refusal(endpoint) is not None:
        return []
    try:
        session, router = _opened(endpoint)
    except LinkError:
        return []
    try:
        return _robots(endpoint, _heard(session, seconds), router)
    finally:
        session.close()


def _opened(endpoint: str) -> tuple[Any, bool]:
    """A session with what is there, and whether that is a router. A peer would hear the stages
    behind a router only by links of its own to them, which from another network there are not."""
    session = open_client([endpoint])
    if list(session.info.routers_zid()):
        return session, True
    session.close()
    return open_session([endpoint]), False


def robots(endpoints: Sequence[str] = ()) -> list[Found]:
    """All that are found, each once: without endpoints on this machine."""
    found: list[Found] = []
    known: set[tuple[str, str]] = set()
    seconds = FAR_SECONDS if endpoints else ANSWER_SECONDS
    for endpoint in [endpoint_of(each) for each in endpoints] or candidates():
        for each in ask(endpoint, seconds) if not _is_known(endpoint, known) else []:
            if not known.intersection(each.instances):
                found.append(each)
            known.update(each.instances)
    return found


def _is_known(endpoint: str, instances: set[tuple[str, str]]) -> bool:
    """Whether the program that listens there has answered already: its instance names its pid."""
    pid, _ = listeners().get(int(endpoint.rpartition(":")[2]), (0, ""))
    return any(instance.endswith(f"-{pid}") for _, instance in instances)


def _nobody(endpoints: Sequence[str]) -> str:
    reasons = {endpoint: refusal(endpoint) for endpoint in endpoints}
    taken = [endpoint for endpoint, reason in reasons.items() if reason is None]
    if taken:
        return (
            f"nothing of a robot answers at {', '.join(taken)}, though connections are taken: "
            "check that it is a stage's or the router's port, and that the stages run"
        )
    where = ", ".join(f"{endpoint} ({reason})" for endpoint, reason in reasons.items())
    return (
        f"nothing answers at {where}: check that stages run there (make run, make demo "
        "RATE=realtime, docker compose up); on another machine they must have been started with "
        "--listen 0.0.0.0, and --connect HOST names it"
    )


def choose(robot: str | None, endpoints: Sequence[str] = ()) -> Found:
    """The one robot that is meant; raises NothingAnswers."""
    found = present(endpoints)
    meant = [each for each in found if robot in (None, each.robot)]
    if len(meant) == 1:
        return meant[0]
    listed = "\n".join(f"  {each}" for each in found)
    if not meant:
        raise NothingAnswers(f"robot {robot} does not answer; these do:\n{listed}")
    raise NothingAnswers(f"several robots answer; say which by --robot or --connect:\n{listed}")


def present(endpoints: Sequence[str] = ()) -> list[Found]:
    """All that are found; raises NothingAnswers."""
    wanted = [endpoint_of(each) for each in endpoints]
    found = robots(wanted)
    if not found:
        raise NothingAnswers(_nobody(wanted or candidates()))
    return found


@contextmanager
def linked(
    robot: str | None,
    endpoints: Sequence[str] = (),
    newest: int | None = None,
    thin: bool = False,
) -> Iterator[Link]:
    """A link to the robot that is meant; says which it is. Of its poses it keeps the newest, all
    where no number is given."""
    found = choose(robot, endpoints)
    print(f"connected to {found}", file=sys.stderr, flush=True)
    with linked_to(found, newest, thin) as link:
        yield link


@contextmanager
def linked_to(found: Found, newest: int | None = None, thin: bool = False) -> Iterator[Link]:
    """A link to a robot that was found."""
    session = (open_client if found.router else open_session)([found.endpoint])
    link = Link(session, Keys(found.robot), newest, thin)
    try:
        yield link
    finally:
        link.close()
        session.close()
