"""A view whose port or file can't be used says which one."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fake_session import FakeSession
from zloam_monitor import cli, foxglove_server, metrics, rerun_view
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link
from zloam_monitor.mcap_file import RecordingError
from zloam_monitor.ports import PortTaken
from zloam_monitor.processes import listen_error
from zloam_monitor.web import server


@pytest.mark.parametrize("command", ["web", "view", "foxglove", "metrics"])
@pytest.mark.parametrize("port", ["70000", "65536", "-1"])
def test_a_port_that_can_not_be_is_a_wrong_command_line(
    command: str, port: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([command, "--port", port, "--connect", "tcp/127.0.0.1:1"]) == 2
    assert "--port" in capsys.readouterr().err


def test_the_page_of_a_view_needs_two_ports(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["view", "--port", "65535", "--connect", "tcp/127.0.0.1:1"]) == 2
    # Code 2 is that of any wrong command line.
    assert "--port" in capsys.readouterr().err


#: Saves a view where a file may have 4 kB, as on a disk that is full after that.
FULL = """
import resource, sys
from pathlib import Path
from test_view_places import linked
from zloam_monitor import mcap_file, rerun_view
most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, most))
try:
    rerun_view.view(linked(), rerun_view.Options(save=Path(sys.argv[1])), 0.0)
except mcap_file.RecordingError as error:
    print(error)
"""


def linked() -> Link:
    session: Any = FakeSession()
    return Link(session, Keys("robot"), newest=0)


@pytest.mark.parametrize("address", ["127.0.0.1", "no.such.host.invalid"])
def test_a_server_that_can_not_listen_is_told(address: str) -> None:
    pytest.importorskip("foxglove")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PortTaken, match=f"can't listen on {address}:{port}: ") as told:
            foxglove_server.serve(linked(), address, port, 0.0)
    assert told.value.exit_code == 3


def test_metrics_name_an_address_that_is_none() -> None:
    registry = pytest.importorskip("prometheus_client").CollectorRegistry()
    with pytest.raises(PortTaken, match=r"can't listen on a\.\.b:0: .*label empty"):
        metrics._started(0, "a..b", registry)


class Nobody:
    """Stands for the robots of a page: there is none."""

    def __init__(self, *_: Any) -> None:
        self.namesakes: list[str] = []

    def names(self) -> list[str]:
        return []

    silences = names

    def close(self) -> None: ...


@pytest.mark.parametrize(("address", "shown"), [("127.0.0.1", "127.0.0.1"), ("::1", r"\[::1\]")])
def test_a_page_is_served_to_both_kinds_of_addresses(
    address: str, shown: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if listen_error(0, address) is not None:
        pytest.skip(f"this machine has no {address}")
    monkeypatch.setattr(server, "Robots", Nobody)
    assert server.serve([], address, 0, 0.0) == 0
    assert re.match(rf"http://{shown}:\d+/ shows", capsys.readouterr().out)


def test_a_name_of_both_kinds_is_served_by_ipv4(monkeypatch: pytest.MonkeyPatch) -> None:
    """Resolvers differ in which of localhost's addresses comes first."""
    kinds = (socket.AF_INET6, "::1"), (socket.AF_INET, "127.0.0.1")
    found = [(kind, socket.SOCK_STREAM, 6, "", (at, 0)) for kind, at in kinds]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    with server._Server("127.0.0.1", 0, server._Handler) as page:
        assert page.address_family == socket.AF_INET


def test_a_page_that_can_not_be_served_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "Robots", Nobody)
    with pytest.raises(PortTaken, match=r"can't listen on \[2001:db8::7\]:0: "):
        server.serve([], "2001:db8::7", 0, 0.0)


@pytest.mark.parametrize(
    ("address", "page"),
    [
        ("127.0.0.1", "127.0.0.1:9090/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9091%2Fproxy"),
        ("::1", "[::1]:9090/?url=rerun%2Bhttp%3A%2F%2F%5B%3A%3A1%5D%3A9091%2Fproxy"),
        ("::", "[::1]:9090/?url=rerun%2Bhttp%3A%2F%2F%5B%3A%3A1%5D%3A9091%2Fproxy (elsewhere"),
    ],
)
def test_rerun_names_the_page_and_its_data(address: str, page: str) -> None:
    assert rerun_view.Options(web=True, address=address).page.startswith(f"http://{page}")


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("", "is there already: choose another name"),
        ("old.rrd", "is there already: choose another name"),
        ("file/new.rrd", "can't be created: "),
        ("/proc/none/new.rrd", "can't be created: "),
    ],
)
def test_a_file_that_can_not_be_written_is_told(tmp_path: Path, name: str, why: str) -> None:
    pytest.importorskip("rerun")
    (tmp_path / "old.rrd").write_text("precious")
    (tmp_path / "file").touch()
    path = tmp_path / name
    with pytest.raises(RecordingError, match=f"^{path} {why}") as told:
        rerun_view.view(linked(), rerun_view.Options(save=path), 0.0)
    assert told.value.exit_code == 3
    assert (tmp_path / "old.rrd").read_text() == "precious"


def test_a_file_that_another_program_has_just_created_stays(tmp_path: Path) -> None:
    path = tmp_path / "new.rrd"
    path.write_text("precious")
    with pytest.raises(FileExistsError):
        rerun_view._try_room(path)
    assert path.read_text() == "precious"


def test_a_new_file_is_written(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    path = tmp_path / "folder" / "new.rrd"
    assert rerun_view.view(linked(), rerun_view.Options(save=path), 0.0) == 0
    assert path.read_bytes().startswith(b"RRF2")


def test_a_disk_without_room_for_the_layout_is_told(tmp_path: Path) -> None:
    """In a process of its own, as Rerun waits for ever where the test fails."""
    pytest.importorskip("rerun")
    path = tmp_path / "new.rrd"
    here = Path(__file__).parent
    command = [sys.executable, "-c", FULL, str(path)]
    done = subprocess.run(
        command,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(here.parent / "src"), str(here)))},
        capture_output=True,
        text=True,
        check=False,
        timeout=60.0,
    )
    assert (done.returncode, done.stdout) == (0, f"{path} can't be created: File too large\n")
    assert not path.exists()
