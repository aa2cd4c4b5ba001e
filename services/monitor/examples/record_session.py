"""Records the replies of a Hokuyo scanner as a session for `zloam calibrate`. No driver may be
connected to the scanner meanwhile. The angles of its motor belong beside it: drive.csv of
drive.logr, with the head t_ns,angle_rad and the lines that publish_angles.py reads.
python record_session.py DEVICE SECONDS drive.logr, with DEVICE as in driver.path"""

import os
import select
import socket
import struct
import sys
import time
import tty
from pathlib import Path
from typing import BinaryIO

#: A scanner answers within some milliseconds.
ANSWER_S = 2.0


def opened(device: str) -> int:
    """The descriptor of tcp://host:port or of a serial device."""
    if not device.startswith("tcp://"):
        fd = os.open(device, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(fd)
        return fd
    host, port = device.removeprefix("tcp://").rsplit(":", 1)
    return socket.create_connection((host, int(port)), ANSWER_S).detach()


def received(fd: int, log: BinaryIO | None) -> bytes:
    """What comes within 0.1 s, also written as a record: s, us, length, bytes."""
    if not select.select([fd], [], [], 0.1)[0]:
        return b""
    data = os.read(fd, 1 << 16)
    if not data:
        sys.exit("the scanner closed the connection")
    if log is not None:
        seconds, rest_ns = divmod(time.time_ns(), 1_000_000_000)
        log.write(struct.pack(">III", seconds, rest_ns // 1000, len(data)) + data)
    return data


def answer(fd: int, command: str, log: BinaryIO | None) -> list[bytes]:
    """The lines of the reply; its second one has the status. Earlier replies are passed over."""
    os.write(fd, command.encode() + b"\n")
    data, ends = b"", time.monotonic() + ANSWER_S
    while time.monotonic() < ends:
        data += received(fd, log)
        for reply in data.split(b"\n\n")[:-1]:
            lines = reply.split(b"\n")
            if lines[0] == command.encode() and not lines[1].startswith(b"99"):
                return lines
    sys.exit(f"no answer to {command}: is it a Hokuyo scanner (SCIP 2)?")


device, duration, path = sys.argv[1:4]
scanner = opened(device)
os.set_blocking(scanner, True)
with Path(path).open("wb") as log:
    answer(scanner, "QT", None)
    told = dict(line.split(b";")[0].split(b":", 1) for line in answer(scanner, "PP", log)[2:])
    steps = f"{int(told[b'AMIN']):04d}{int(told[b'AMAX']):04d}01000"
    # Of a scanner without intensities, the distances alone.
    if not answer(scanner, f"ME{steps}", log)[1].startswith(b"00"):
        answer(scanner, f"MD{steps}", log)
    ends = time.monotonic() + float(duration)
    while time.monotonic() < ends:
        received(scanner, log)
    os.write(scanner, b"QT\n")
