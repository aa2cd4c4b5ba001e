"""The driver alone, which receives packets over UDP at the rate of four sensors."""

from __future__ import annotations

import os
import re
import signal
import socket
import struct
import subprocess
import time
from pathlib import Path

from tests.acceptance.framework import Check, Measured
from tests.acceptance.live import free_udp_port
from tests.acceptance.runs import Setting
from zloam_monitor.chain import binary

PACKETS_PER_S, SECONDS, CPU_LIMIT = 3016.0, 60.0, 0.25
PERIOD_US = 1327.104
#: The driver logs its counters every 5 s.
LAST_WORDS_S = 7.0
CHUNK_S = 0.002


def _packet(number: int) -> bytes:
    """A packet of a VLP-16 at 600 rpm in a round room. The stamps advance at the pace of one
    sensor, four times slower than the packets are sent: it only matters that all arrive and are
    decoded."""
    azimuth = number * 12 * 40
    blocks = b"".join(
        struct.pack("<HH", 0xEEFF, (azimuth + 40 * k) % 36000) + struct.pack("<HB", 5000, 50) * 32
        for k in range(12)
    )
    return blocks + struct.pack("<IBB", round(number * PERIOD_US) % 3_600_000_000, 0x37, 0x22)


def _send(port: int, seconds: float) -> int:
    """Sends packets for `seconds`; returns their number."""
    turn = [_packet(n) for n in range(75)]  # 75 packets are a revolution of 36000
    sent, began = 0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while (elapsed := time.monotonic() - began) < seconds:
            while sent < int(elapsed * PACKETS_PER_S):
                body = turn[sent % len(turn)]
                toh = struct.pack("<I", round(sent * PERIOD_US) % 3_600_000_000)
                sender.sendto(body[:1200] + toh + body[1204:], ("127.0.0.1", port))
                sent += 1
            time.sleep(CHUNK_S)
    return sent


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _wait_for(log: Path, words: str, limit_s: float) -> None:
    until = time.monotonic() + limit_s
    while words not in log.read_text():
        if time.monotonic() > until:
            raise RuntimeError(f'the driver did not say "{words}": {log.read_text()[-200:]}')
        time.sleep(0.1)


def measure(setting: Setting, seconds: float = SECONDS) -> Measured:
    """CPU time of the driver's process while it receives, and its last counters."""
    folder = setting.out / "accept" / "udp-rate"
    folder.mkdir(parents=True, exist_ok=True)
    log, port = folder / "driver.log", free_udp_port()
    settings = {
        "driver.source": "udp",
        "driver.bind_address": "127.0.0.1",
        "driver.port": port,
        "driver.position_port": 0,
        "driver.quiet_s": 0.5,
        "zenoh.base_port": 0,
    }
    command = [str(binary(setting.build, "driver"))]
    for key, value in settings.items():
        command += ["--set", f"{key}={value}"]
    with log.open("w") as said:
        driver = subprocess.Popen(command, stdout=said, stderr=said)
    try:
        # The driver complains about missing packets, so it listens.
        _wait_for(log, "no packets on", 60.0)
        before, began = _cpu_s(driver.pid), time.monotonic()
        sent = _send(port, seconds)
        share = (_cpu_s(driver.pid) - before) / (time.monotonic() - began)
        time.sleep(LAST_WORDS_S)
    finally:
        driver.send_signal(signal.SIGTERM)
        driver.wait(30)
    found = re.findall(r"packets=(\d+) lost=(\d+) kernel_drops=(\d+)", log.read_text())
    if not found:
        raise RuntimeError(f"no counters in {log}")
    received, lost, drops = (int(value) for value in found[-1])
    return Measured(
        f"{received} of {sent} packets, {lost} lost, {drops} dropped by the kernel; "
        f"{100 * share:.1f} % of one core",
        received == sent and lost == 0 and drops == 0 and share <= CPU_LIMIT,
    )


def checks(setting: Setting) -> list[Check]:
    return [
        Check(
            "driver-udp-rate",
            f"live UDP at {PACKETS_PER_S:.0f} packets/s for {SECONDS:.0f} s",
            f"nothing lost, CPU ≤ {100 * CPU_LIMIT:.0f} % of one core",
            "make accept ONLY=driver-udp-rate",
            lambda: measure(setting),
        )
    ]
