"""Robots are found without an address; if none answers, the message says what to check."""

from __future__ import annotations

import errno
import json
import os
import socket
from collections.abc import Iterator

import pytest
import zenoh

from zloam_monitor import cli, discovery, ports
from zloam_monitor.discovery import NothingAnswers, endpoint_of
from zloam_monitor.processes import endpoints, free_base_port, free_port, listen_error
from zloam_monitor.robot_file import RobotNames


@pytest.mark.parametrize(
    ("text", "endpoint"),
    [
        ("tcp/10.0.0.5:7464", "tcp/10.0.0.5:7464"),
        ("tls/robot:7448", "tls/robot:7448"),
        ("tcp/[::1]:7464", "tcp/[::1]:7464"),
        ("robot", "tcp/robot:7464"),
        ("10.0.0.5:7500", "tcp/10.0.0.5:7500"),
        ("[::1]", "tcp/[::1]:7464"),
    ],
)
def test_endpoints_as_people_write_them(text: str, endpoint: str) -> None:
    assert endpoint_of(text) == endpoint


@pytest.mark.parametrize(
    "text", ["", "tcp/", "tcp/host", "tcp://host:7464", "host:0", "tcp/h:99999", "::1:7464"]
)
def test_what_is_no_endpoint_is_said_without_a_trace(
    text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (["watch"], ["status"], ["set", "odometry", "a=1"], ["save"], ["robots"]):
        assert cli.main([*command, "--connect", text]) == 2
        assert f"'{text}' is no endpoint" in capsys.readouterr().err


@pytest.fixture
def deaf() -> Iterator[int]:
    """A port that accepts connections, but never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


@pytest.mark.parametrize("command", [["watch"], ["status"], ["get"], ["robots"], ["reset"]])
def test_nobody_there_is_one_helpful_line(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*command, "--connect", f"127.0.0.1:{free_port()}"]) == 1
    said = capsys.readouterr().err
    assert "(Connection refused): check that stages run there" in said


def test_who_takes_connections_and_says_nothing_is_no_robot(
    deaf: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["watch", "--connect", f"127.0.0.1:{deaf}"]) == 1
    said = capsys.readouterr().err
    assert f"nothing of a robot answers at tcp/127.0.0.1:{deaf}" in said


def opened(mode: str, **endpoints_of: list[str]) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for which, named in endpoints_of.items():
        config.insert_json5(f"{which}/endpoints", json.dumps(named))
    return zenoh.open(config)


def test_a_router_answers_for_stages_that_only_it_reaches() -> None:
    where = f"tcp/127.0.0.1:{free_port()}"
    with (
        opened("router", listen=[where]),
        opened("peer", listen=[], connect=[where]) as stage,
        stage.liveliness().declare_token("loam/car/service/odometry/odometry-1/alive"),
    ):
        (found,) = discovery.present([where])
        assert (found.robot, found.stages, found.router) == ("car", ["odometry"], True)
        with discovery.linked_to(found, newest=0) as link:
            assert list(link.session.info.routers_zid())
            assert link.living() == {"odometry"}


def test_a_taken_port_is_refused_with_its_number() -> None:
    base = free_base_port()
    assert ports.configured(RobotNames(base_port=base)).base == base
    refused = pytest.raises(ports.PortTaken, match=f"mapping can't listen on .*:{base + 3}; ")
    with socket.create_server(("127.0.0.1", base + 3)), refused:
        ports.configured(RobotNames(base_port=base))
    with socket.create_server(("127.0.0.1", base + 6)):
        assert ports.configured(RobotNames(base_port=base)).base == base
        with pytest.raises(ports.PortTaken, match=f"store can't listen on .*:{base + 6}; "):
            ports.configured(RobotNames(base_port=base), beside=("store",))


@pytest.mark.parametrize("host", ["[::1]", "[::]"])
def test_an_address_of_ip_6_is_one_of_this_machine(host: str) -> None:
    if not socket.has_dualstack_ipv6():
        pytest.skip("no IPv6 here")
    base = free_base_port()
    assert ports.configured(RobotNames(base_port=base, host=host)).host == host
    taken = pytest.raises(ports.PortTaken, match="another program listens there: end it")
    with socket.create_server(("::1", base + 4), family=socket.AF_INET6), taken:
        ports.configured(RobotNames(base_port=base, host=host))


@pytest.mark.parametrize(
    ("host", "why"),
    [
        ("192.0.2.1", "Cannot assign requested address: name an address of this machine"),
        ("a..b", r"label empty.*: name an address of this machine by zenoh\.host or --listen"),
        ("no such address", r"name an address of this machine by zenoh\.host or --listen"),
    ],
)
def test_an_address_of_another_machine_is_not_called_taken(host: str, why: str) -> None:
    with pytest.raises(ports.PortTaken, match=why) as refused:
        ports.configured(RobotNames(base_port=free_base_port(), host=host))
    assert "listens there" not in str(refused.value)


def test_without_ip_6_in_the_kernel_a_name_s_other_addresses_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The name may still have one of IPv6 in /etc/hosts."""
    both = [
        (family, socket.SOCK_STREAM, 6, "", (host, 0))
        for family, host in ((socket.AF_INET6, "::1"), (socket.AF_INET, "127.0.0.1"))
    ]
    original = socket.socket

    def made(family: int = socket.AF_INET, *more: int) -> socket.socket:
        if family == socket.AF_INET6:
            raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))
        return original(family, *more)

    base = free_base_port()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: both)
    monkeypatch.setattr(socket, "socket", made)
    assert listen_error(base, "localhost") is None
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: both[:1])
    refused = listen_error(base, "localhost")
    assert refused is not None
    assert refused.errno == errno.EAFNOSUPPORT


def test_what_is_no_name_of_a_host_is_told() -> None:
    assert "label empty" in str(discovery.refusal("tcp/a..b:7464"))
    assert "open to the network" in ports.Ports(7460, "a..b").announcement("car")


def test_what_is_open_to_the_network_says_so() -> None:
    inside = ports.Ports(7460)
    assert inside.announcement("car") == "robot 'car' listens on tcp/127.0.0.1:7464"
    outside = ports.Ports(7460, "0.0.0.0").announcement("car")
    assert "open to the network: whoever reaches ports 7460 to 7464 reads" in outside
    beside = ports.Ports(7460, "0.0.0.0", ("graph", "store")).announcement("car")
    assert "whoever reaches ports 7460 to 7464, 7466, 7468 reads" in beside
    for host in ("localhost", "127.0.0.2", "[::1]"):
        assert "open" not in ports.Ports(7460, host).announcement("car")
    for host in ("[::]", "192.0.2.1"):
        assert "open to the network" in ports.Ports(7460, host).announcement("car")


def test_without_endpoints_this_machine_is_searched() -> None:
    assert discovery.candidates()[:2] == ["tcp/127.0.0.1:7464", "tcp/127.0.0.1:7447"]


def test_another_robot_than_the_one_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = [discovery.Found(name, endpoints(7460)[4], (("odometry", name),)) for name in "ab"]
    monkeypatch.setattr(discovery, "robots", lambda _: heard)
    assert discovery.choose("b") == heard[1]
    with pytest.raises(NothingAnswers, match="robot c does not answer; these do:\n  robot 'a' at"):
        discovery.choose("c")
    with pytest.raises(NothingAnswers, match="say which by --robot"):
        discovery.choose(None)


def test_two_robots_with_standbys_are_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Standbys that were started by hand may have the same names in both."""

    def instances(pid: int) -> tuple[tuple[str, str], ...]:
        return (("mapping", f"host-{pid}"), ("mapping", "mapping-standby"))

    first, second = endpoint_of("a:1"), endpoint_of("b:2")
    answers = {
        first: [discovery.Found("anna", first, instances(1))],
        second: [discovery.Found("bob", second, instances(2))],
    }
    monkeypatch.setattr(discovery, "ask", lambda endpoint, _: answers[endpoint])
    assert [each.robot for each in discovery.robots([first, second])] == ["anna", "bob"]
    # A robot that is reached by a second way is still one.
    assert [each.robot for each in discovery.robots([first, first])] == ["anna"]
    assert discovery.choose("bob", [first, second]).endpoint == second
    with pytest.raises(NothingAnswers, match="several robots answer"):
        discovery.choose(None, [first, second])


def of_car(endpoint: str, *pids: int) -> discovery.Found:
    """A robot with standbys, with one instance of each other kind for each pid."""
    own = [(stage, f"host-{pid}") for pid in pids for stage in ("driver", "mapping")]
    return discovery.Found("car", endpoint, (*own, ("mapping", "mapping-standby")))


def test_two_robots_of_one_name_are_two(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """If the names of their standbys are the same, too, only the first was shown."""
    first, second = endpoint_of("a:1"), endpoint_of("b:2")
    answers = {first: [of_car(first, 1)], second: [of_car(second, 2)]}
    monkeypatch.setattr(discovery, "ask", lambda endpoint, _: answers[endpoint])
    assert len(discovery.robots([first, second])) == 2
    assert len(discovery.robots([first, first])) == 1
    both = ["--connect", first, "--connect", second]
    named = "2 robots are named car: give each a name of its own (robot in its file)"
    assert cli.main(["robots", *both]) == 0
    assert named in capsys.readouterr().err
    for command in (["status"], ["watch"], ["doctor"], ["status", "--robot", "car"]):
        assert cli.main([*command, *both]) == 1
        said = capsys.readouterr().err
        assert named in said
        assert "say which by --connect:" in said
        assert f"robot 'car' at {second}" in said


def test_two_robots_of_one_name_in_one_network_are_told() -> None:
    (text,) = discovery.namesakes([of_car("tcp/a:1", 1, 2)])
    assert text.startswith("robot car has 2 drivers (host-1, host-2): stop one; if they are of two")
    assert discovery.namesakes([of_car("tcp/a:1", 1)]) == []


def test_it_is_told_when_a_command_connects(capsys: pytest.CaptureFixture[str]) -> None:
    where = f"tcp/127.0.0.1:{free_port()}"
    with opened("router", listen=[where]), opened("peer", listen=[], connect=[where]) as stage:
        tokens = [
            stage.liveliness().declare_token(f"loam/car/service/driver/driver-{n}/alive")
            for n in (1, 2)
        ]
        with discovery.linked(None, [where], newest=0):
            said = capsys.readouterr().err
        assert len(tokens) == 2
    assert "connected to robot 'car'" in said
    assert "robot car has 2 drivers (driver-1, driver-2)" in said


@pytest.mark.parametrize(
    "endpoint", ["tcp/10.0.0.5:7464", "tcp/127.0.0.1:7464#iface=lo", "unixsock-stream/tmp/zenoh"]
)
def test_only_a_port_of_this_machine_belongs_to_a_process_of_it(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(discovery, "listeners", lambda: {7464: (77, "zloam-mapping")})
    known = {("car", "mapping", "host-77")}
    assert discovery._is_known("tcp/127.0.0.1:7464", known)
    assert not discovery._is_known(endpoint, known)
