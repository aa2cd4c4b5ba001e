"""Finds the robots that can be reached: on this machine without an address, or at endpoints.

On this machine the candidates are the default ports (integration's, and the containers' router's)
and every port on which a zloam program listens. Each candidate is asked over a session of its own:
one session linked to two robots would introduce their stages to each other.
"""

from __future__ import annotations

import re
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zloam_monitor.failures import Explained, Misuse
from zloam_monitor.keys import Keys, name_error
from zloam_monitor.link import Link, LinkError, open_client, open_session
from zloam_monitor.stages import STAGES, standby_of

HOST = "127.0.0.1"
#: Port of integration, and of the router in docker-compose.yml.
DEFAULT_PORTS = (7464, 7447)
#: A program on this machine answers within milliseconds; over a network, perhaps a busy one, a
#: connection takes some hundred milliseconds.
CONNECT_SECONDS = 2.0
ANSWER_SECONDS = 2.0
#: Limit for a named endpoint: over a link with 200 ms of delay, opening a session takes a second,
#: and several seconds if other views use the link to capacity.
FAR_SECONDS = 15.0
#: After the first stage has answered, the others of its robot are heard within this time.
SIBLING_SECONDS = 0.6
OWN_NAME = "give each a name of its own (robot in its file)"
_ENDPOINT = re.compile(
    r"^(?P<protocol>[a-z][a-z0-9_-]*)/(?P<address>.+):(?P<port>\d+)(?P<rest>[?#].*)?$"
)
_PLAIN = re.compile(r"^(?P<host>\[[0-9a-fA-F:]+\]|[^\s/:]+)(:(?P<port>\d+))?$")
_ALIVE_KEY = re.compile(r"^loam/(?P<robot>[^/]+)/service/(?P<stage>[^/]+)/(?P<instance>[^/]+)/")


class NothingAnswers(Explained):
    """No robot, or not the requested one, answers; the text says what to check."""


class NoEndpoint(NothingAnswers, Misuse):
    """The text is no endpoint."""


@dataclass(frozen=True)
class Found:
    """A robot, the endpoint at which it answers, and the stages that were heard."""

    robot: str
    endpoint: str
    instances: tuple[tuple[str, str], ...]
    #: The endpoint is a router's, not a stage's.
    router: bool = False

    @property
    def stages(self) -> list[str]:
        heard = {stage for stage, _ in self.instances}
        known = [stage for stage in STAGES if stage in heard]
        return known + sorted(heard - set(known))

    @property
    def own(self) -> set[tuple[str, str, str]]:
        """(robot, stage, instance) of what no other robot has; standbys may have one name in all
        that was given by hand (--instance)."""
        named = [each for each in self.instances if each[1] != standby_of(each[0])]
        return {(self.robot, stage, instance) for stage, instance in named or self.instances}

    def __str__(self) -> str:
        return f"robot '{self.robot}' at {self.endpoint} ({', '.join(self.stages)})"


def endpoint_of(text: str) -> str:
    """PROTOCOL/HOST:PORT from a user's text, which is that itself, HOST:PORT, or HOST."""
    if match := _ENDPOINT.match(text):
        _checked_port(text, match["port"])
        return text
    if match := _PLAIN.match(text):
        port = match["port"] or str(DEFAULT_PORTS[0])
        _checked_port(text, port)
        return f"tcp/{match['host']}:{port}"
    raise NoEndpoint(
        f"'{text}' is no endpoint: PROTOCOL/HOST:PORT is expected, e.g. "
        f"tcp/{HOST}:{DEFAULT_PORTS[0]}"
    )


def _checked_port(text: str, port: str) -> None:
    if not 0 < int(port) < 65536:
        raise NoEndpoint(f"'{text}' is no endpoint: port {port} is not in 1 to 65535")


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
    """Inodes of the sockets of a process; none if the process belongs to another user."""
    try:
        for descriptor in (process / "fd").iterdir():
            target = str(descriptor.readlink())
            if target.startswith("socket:["):
                yield int(target[8:-1])
    except OSError:
        return


def listeners() -> dict[int, tuple[int, str]]:
    """Port -> (pid, name) of each zloam program that listens on this machine."""
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
    """Endpoints on this machine where a robot may answer: the default ports, then integration's,
    so that a robot on other ports is found by its integration first."""
    own = sorted(listeners().items(), key=lambda each: not each[1][1].startswith("zloam-integ"))
    ports = dict.fromkeys([*DEFAULT_PORTS, *(port for port, _ in own)])
    return [f"tcp/{HOST}:{port}" for port in ports]


def refusal(endpoint: str) -> str | None:
    """Why no TCP connection can be made; None: one can, or the endpoint uses another protocol."""
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
        except UnicodeError as error:  # Of a name like a..b.
            outcome.append(str(error))

    # Name resolution has no time limit, so it runs in a thread that can be left behind.
    attempt = threading.Thread(target=connect, daemon=True)
    attempt.start()
    attempt.join(2 * CONNECT_SECONDS)
    return outcome[0] if outcome else "timed out"


def _answers(session: Any, seconds: float) -> set[tuple[str, str, str]]:
    """(robot, stage, instance) by liveliness tokens: a router keeps statuses of ended stages."""
    found = set()
    for reply in session.liveliness().get("loam/*/service/*/*/alive", timeout=seconds):
        match = _ALIVE_KEY.match(str(reply.ok.key_expr)) if reply.ok is not None else None
        # No stage accepts such a name, so the token is a stranger's.
        if match is not None and name_error(match["robot"]) is None:
            found.add((match["robot"], match["stage"], match["instance"]))
    return found


def _heard(session: Any, seconds: float) -> set[tuple[str, str, str]]:
    """All instances that answer. The first may take a while; the others follow shortly after."""
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
    """The robots that answer at an endpoint within `seconds` after a connection was made."""
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
    """A session at the endpoint, and whether a router answers there. Behind a router the session
    is a client: a peer would need links of its own to the stages, which another network may not
    allow."""
    session = open_client([endpoint])
    if list(session.info.routers_zid()):
        return session, True
    session.close()
    return open_session([endpoint]), False


def robots(endpoints: Sequence[str] = ()) -> list[Found]:
    """All robots that are found, each once; without endpoints: on this machine."""
    found: list[Found] = []
    known: set[tuple[str, str, str]] = set()
    seconds = FAR_SECONDS if endpoints else ANSWER_SECONDS
    for endpoint in [endpoint_of(each) for each in endpoints] or candidates():
        for each in ask(endpoint, seconds) if not _is_known(endpoint, known) else []:
            if not known & each.own:
                found.append(each)
            known |= each.own
    return found


def namesakes(found: Iterable[Found]) -> list[str]:
    """Texts about robots of one name: in networks of their own, or in one."""
    found = list(found)
    texts = [
        f"{number} robots are named {name}: {OWN_NAME}"
        for name, number in Counter(each.robot for each in found).items()
        if number > 1
    ]
    for each in found:
        drivers = [instance for stage, instance in each.instances if stage == "driver"]
        if len(drivers) > 1:
            texts.append(
                f"robot {each.robot} has {len(drivers)} drivers ({', '.join(drivers)}): stop one; "
                f"if they are of two robots, {OWN_NAME}"
            )
    return texts


def _is_known(endpoint: str, instances: set[tuple[str, str, str]]) -> bool:
    """True if the program at this port answered before: its instance name ends with its pid."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    if host not in (HOST, "localhost", "[::1]") or not port.isdecimal():
        return False
    pid, _ = listeners().get(int(port), (0, ""))
    return any(instance.endswith(f"-{pid}") for _, _, instance in instances)


def _nobody(endpoints: Sequence[str]) -> str:
    reasons = {endpoint: refusal(endpoint) for endpoint in endpoints}
    taken = [endpoint for endpoint, reason in reasons.items() if reason is None]
    if any(endpoint.startswith("tls/") for endpoint in taken):
        return (
            f"nothing of a robot answers at {', '.join(taken)}: check that its router listens "
            "there and accepts the certificates that the endpoint names (deploy/README.md)"
        )
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
    """The one robot that matches; raises NothingAnswers if there is none or more than one."""
    found = present(endpoints)
    meant = [each for each in found if robot in (None, each.robot)]
    if len(meant) == 1:
        return meant[0]
    listed = "\n".join(f"  {each}" for each in found)
    if not meant:
        raise NothingAnswers(f"robot {robot} does not answer; these do:\n{listed}")
    # A name that several have does not say which.
    ways = "--robot or --connect" if robot is None and not namesakes(meant) else "--connect"
    said = "".join(f"{text}\n" for text in namesakes(meant))
    raise NothingAnswers(f"{said}several robots answer; say which by {ways}:\n{listed}")


def present(endpoints: Sequence[str] = ()) -> list[Found]:
    """All robots that are found; raises NothingAnswers if there are none."""
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
    """A link to the one robot that matches, which is printed. The link keeps the `newest` poses,
    by default all."""
    found = choose(robot, endpoints)
    print(f"connected to {found}", *namesakes([found]), sep="\n", file=sys.stderr, flush=True)
    with linked_to(found, newest, thin) as link:
        yield link


@contextmanager
def linked_to(found: Found, newest: int | None = None, thin: bool = False) -> Iterator[Link]:
    """A link to a robot that discovery found."""
    session = (open_client if found.router else open_session)([found.endpoint])
    link = Link(session, Keys(found.robot), newest, thin)
    try:
        yield link
    finally:
        link.close()
        session.close()
