"""Records the replies of a Hokuyo scanner as a session for `zloam calibrate`. No driver may be
connected to the scanner meanwhile. The angles of its motor belong beside it: drive.csv of
drive.logr, with the head t_ns,angle_rad and the lines that publish_angles.py reads.
python record_session.py DEVICE SECONDS drive.logr, with DEVICE as in driver.path"""

import contextlib
import io
import os
import select
import socket
import struct
import sys
import termios
import time
import tty
from pathlib import Path
from typing import BinaryIO

#: A scanner answers within some milliseconds.
ANSWER_S = 2.0
#: Statuses of a measurement that starts, and that goes on after the scanner checked itself.
STARTED = (b"00", b"98")
#: Status line of each scan of a measurement.
SCAN = b"\n99b\n"


def make_plain(fd: int) -> None:
    """8 bits, no parity, one stop bit, no flow control, no modem lines: setraw() keeps the rest of
    what an earlier program has set."""
    tty.setraw(fd)
    settings = termios.tcgetattr(fd)
    settings[0] &= ~(termios.INPCK | termios.IGNPAR | termios.IXON | termios.IXOFF | termios.IXANY)
    settings[2] &= ~(termios.PARENB | termios.PARODD | termios.CSTOPB | termios.CRTSCTS)
    settings[2] |= termios.CLOCAL | termios.CREAD
    # USB devices ignore the rate.
    settings[4] = settings[5] = termios.B115200
    termios.tcsetattr(fd, termios.TCSANOW, settings)


def opened(device: str) -> int:
    """The descriptor of tcp://host:port or of a serial device."""
    if not device.startswith("tcp://"):
        # Without O_NONBLOCK, open() would wait for the modem line of an earlier program's setting.
        fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        make_plain(fd)
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
            if lines[0] == command.encode() and len(lines) > 1 and lines[1][:2] != b"99":
                return lines
    sys.exit(
        f"no answer to {command}: is it a Hokuyo scanner (SCIP 2), and its serial line, if it has "
        "one, at 115200 bit/s?"
    )


def steps(fd: int, log: BinaryIO) -> str:
    """First and last step of the scanner, as its commands take them."""
    lines = answer(fd, "PP", log)
    told = {line[:5]: line[5:].split(b";")[0] for line in lines[2:]}
    try:
        return f"{int(told[b'AMIN:']):04d}{int(told[b'AMAX:']):04d}"
    except (KeyError, ValueError):
        status = lines[1][:2].decode(errors="replace")
        sys.exit(f"the scanner does not tell its steps: PP was answered with status {status}")


def start(fd: int, log: BinaryIO) -> None:
    """Starts the measurement; of a scanner without intensities, of the distances alone."""
    answer(fd, "QT", None)
    # A scanner in its adjust mode answers neither PP nor ME; one that is in none refuses TM2.
    answer(fd, "TM2", None)
    asked, refused = steps(fd, log), []
    for command in ("ME", "MD"):
        status = answer(fd, f"{command}{asked}01000", log)[1][:2]
        if status in STARTED:
            return
        refused.append(f"{command} was answered with status {status.decode(errors='replace')}")
    sys.exit(f"the scanner does not measure: {', '.join(refused)}")


def record(fd: int, seconds: float, path: Path) -> None:
    """There is no file before the first scan. Ctrl-C ends the recording early."""
    began = io.BytesIO()
    start(fd, began)
    ends = time.monotonic() + seconds
    while SCAN not in began.getvalue():
        if time.monotonic() >= ends:
            sys.exit(f"no scan came within {seconds:g} s: nothing is recorded")
        received(fd, began)
    with path.open("wb") as log, contextlib.suppress(KeyboardInterrupt):
        log.write(began.getvalue())
        while time.monotonic() < ends:
            received(fd, log)


def main() -> None:
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    device, duration, path = sys.argv[1:]
    scanner = None
    try:
        seconds = float(duration)
        if not seconds > 0.0:  # NaN, too
            sys.exit(f"{duration} is no number of seconds above 0")
        scanner = opened(device)
        os.set_blocking(scanner, True)
        record(scanner, seconds, Path(path))
    except (OSError, ValueError, termios.error) as error:
        sys.exit(f"{device}, {path}: {error}")
    except KeyboardInterrupt:
        sys.exit("ended before the first scan: nothing is recorded")
    finally:
        if scanner is not None:
            with contextlib.suppress(OSError):
                os.write(scanner, b"QT\n")


main()
