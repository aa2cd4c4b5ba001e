"""Sends a simulated capture over UDP, at the pace of its stamps, through the live chain."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.acceptance.decoded import udp_payloads
from tests.acceptance.runs import ROOT, Setting, ended_well, own_outputs
from zloam_monitor import report
from zloam_monitor.chain import Chain
from zloam_monitor.report import Run
from zloam_monitor.robot_file import names

#: length of the part of the capture that is sent
SECONDS = 40.0
#: The last sweeps are still being processed after the last packet.
AFTER_SECONDS = 3.0


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


#: (seconds since the first packet, packet) -> what is sent in its place; None: nothing
Change = Callable[[float, bytes], bytes | None]


def as_recorded(_seconds: float, payload: bytes) -> bytes:
    return payload


def send(
    capture: Path,
    port: int,
    seconds: float,
    slower: float = 1.0,
    host: str = "127.0.0.1",
    enough: threading.Event | None = None,
    change: Change = as_recorded,
) -> None:
    """Sends the datagrams of the first `seconds` at their times, or until `enough` is set."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        began, first = time.monotonic(), None
        for stamp, payload in udp_payloads(capture):
            first = stamp if first is None else first
            if stamp - first > seconds or (enough and enough.is_set()):
                return
            wait = began + slower * (stamp - first) - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            # Only data packets are sent; a sensor sends position packets to another port.
            if len(payload) == 1206 and (changed := change(stamp - first, payload)) is not None:
                sender.sendto(changed, (host, port))


def run(setting: Setting, name: str = "live") -> dict[str, Any]:
    """The report of a live run."""
    capture, port = setting.capture(), free_udp_port()
    config = ROOT / "deploy/robots/vlp16-outdoor.yaml"
    robot = names(config, [])
    settings = ["driver.source=udp", f"driver.port={port}", "driver.position_port=0"]
    out = setting.out / "accept" / name
    settings += own_outputs(out)
    chain = Chain(setting.build, config, robot.robot, settings, out / "logs", robot.sensor)
    with chain:
        chain.wait_linked()
        sender = threading.Thread(target=send, args=(capture, port, SECONDS))
        began = time.monotonic()
        sender.start()
        while sender.is_alive():
            chain.link.poll(0.2)
            chain.processes.check()
        ends = time.monotonic() + AFTER_SECONDS
        while time.monotonic() < ends:
            chain.link.poll(0.2)
        chain.link.query_statuses()
        codes = ended_well(chain)
        seen = Run.heard(chain.link, time.monotonic() - began, codes)
    found = report.build(seen)
    report.write(out / "report.json", found)
    return found
