"""A simulated scanner: over TCP or a pseudo-terminal it answers as a real one and sends the scans
of a session at their pace, with faults on request."""

from __future__ import annotations

import os
import pty
import select
import socket
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

from tests.hokuyo import peer

#: start value of the simulator's counter, ms; delay from then to the receipt of the first line, s
COUNTER_MS, FIRST_LINE_S = 1_000_000, 0.0176
#: A scan that could not be sent for this long, since nobody was connected, is dropped.
LATE_S = 0.5
#: only limits the time of a test that fails
PATIENCE_S = 60.0


def encoded(value: int, characters: int) -> bytes:
    return bytes((value >> 6 * i & 0x3F) + 0x30 for i in reversed(range(characters)))


def summed(text: bytes) -> bytes:
    return text + bytes([peer.checksum(text)])


def answer(echo: bytes, status: bytes, lines: list[bytes] | None = None) -> bytes:
    return b"\n".join([echo, summed(status), *(lines or [])]) + b"\n\n"


def moved(scan: bytes, milliseconds: int) -> bytes:
    """The scan with a later value of the counter."""
    lines = scan.split(b"\n")
    counter_ms = int(peer.numbers(lines[2][:-1], 4)[0])
    lines[2] = summed(encoded((counter_ms + milliseconds) & 0xFFFFFF, 4))
    return b"\n".join(lines)


class Device:
    """Serves one connection after the other until it is closed. Like a real scanner, it measures
    from its first command on: until begin() is called it sends the session's first scan."""

    def __init__(self, session: Path, seconds: float) -> None:
        #: value of driver.path for this device
        self.name = ""
        self.parameters = b""
        #: (seconds after the first line, bytes) of each scan
        self.scans: list[tuple[float, bytes]] = []
        #: receipt of the session's first line, s since the Unix epoch
        self.first_s = 0.0
        for stamp, data in peer.records(session):
            if data.startswith(b"PP"):
                self.parameters = data
            elif b"\n99b\n" in data:
                self.first_s = self.first_s or stamp
                if stamp - self.first_s > seconds:
                    break
                self.scans.append((stamp - self.first_s, data))
        self._line_ms = round(1e3 * self.scans[-1][0] / (len(self.scans) - 1))
        self.commands: list[bytes] = []
        #: number of the session's scans sent so far
        self.sent = 0
        #: called with the number of each scan before it is sent; true cuts the connection
        self.cut: Callable[[int], bool] = lambda number: False
        #: changes the bytes of a scan before they are sent
        self.spoil: Callable[[int, bytes], bytes] = lambda number, data: data
        #: monotonic time at which the counter had its start value
        self._on: float | None = None
        #: number of scans sent before the session
        self._before = 0
        self._begin = threading.Event()
        self._began: float | None = None
        self._measuring = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def begin(self) -> None:
        """Makes the session's first scan the next one."""
        self._begin.set()

    @property
    def began(self) -> float:
        """Monotonic time at which the session's first line is sent."""
        assert self._began is not None
        return self._began

    def until_begun(self) -> None:
        """After begin(): waits until the driver measures, and so `began` is known."""
        ends = time.monotonic() + PATIENCE_S
        while self._began is None:
            assert time.monotonic() < ends, f"nobody measures; asked: {self.commands}"
            time.sleep(0.005)

    def _since_on(self) -> float:
        if self._on is None:
            self._on = time.monotonic()
        return time.monotonic() - self._on

    @property
    def finished(self) -> bool:
        return self.sent == len(self.scans)

    def _answer(self, command: bytes) -> bytes:
        self.commands.append(command)
        counter_ms = int(COUNTER_MS + 1e3 * self._since_on())
        if command == b"QT":
            self._measuring = False
        elif command == b"PP":
            return self.parameters
        elif command == b"VV":
            return answer(
                command, b"00", [b"VEND:Hokuyo;" + bytes([peer.checksum(b"VEND:Hokuyo")])]
            )
        elif command == b"II":
            return answer(command, b"00", [b"STAT:well;" + bytes([peer.checksum(b"STAT:well")])])
        elif command == b"TM1":
            return answer(command, b"00", [summed(encoded(counter_ms & 0xFFFFFF, 4))])
        elif command.startswith(b"ME"):
            self._measuring = True
            if self._began is None:
                self._before = int(1e3 * self._since_on() / self._line_ms)
        elif command not in (b"TM0", b"TM2"):
            return answer(command, b"0E")
        return answer(command, b"00")

    def _serve(self, read: Callable[[], bytes | None], write: Callable[[bytes], None]) -> None:
        """Answers commands and sends scans. `read` returns what came within some ms, or None if the
        other side has closed."""
        waiting = b""
        while not self._stop.is_set():
            data = read()
            if data is None:
                return
            waiting += data
            while b"\n" in waiting:
                command, waiting = waiting.split(b"\n", 1)
                write(self._answer(command))
            if not self._measuring or self.finished:
                continue
            scan = self._due()
            if scan is None:
                continue
            if self.cut(self.sent - 1):
                return
            write(scan)

    def _due(self) -> bytes | None:
        """The scan that is to be sent now, if any."""
        before_s = 1e-3 * self._line_ms * self._before
        at = (self._on or 0.0) + FIRST_LINE_S + before_s
        if self._began is None and self._begin.is_set():
            self._began = at
        number = self.sent
        if self._began is not None:
            at = self._began + self.scans[number][0]
        late = time.monotonic() - at
        if late < 0:
            return None
        if self._began is None:
            self._before += 1
        else:
            self.sent += 1
        if late > LATE_S:
            return None
        scan = moved(self.scans[number][1], round(1e3 * before_s))
        return self.spoil(number, scan) if self._began is not None else scan

    def _run(self) -> None:
        raise NotImplementedError

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


class TcpDevice(Device):
    """A device at a TCP port of this machine."""

    def __init__(self, session: Path, seconds: float) -> None:
        super().__init__(session, seconds)
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.1)
        self.name = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        self._thread.start()

    def _run(self) -> None:
        with self._server:
            while not self._stop.is_set():
                try:
                    link, _ = self._server.accept()
                except TimeoutError:
                    continue
                with link:
                    link.settimeout(0.002)
                    self._serve(lambda link=link: _received(link), link.sendall)  # type: ignore[misc]
                self._measuring = False


def _received(link: socket.socket) -> bytes | None:
    try:
        return link.recv(4096) or None
    except TimeoutError:
        return b""
    except OSError:
        return None


class SerialDevice(Device):
    """A device at a pseudo-terminal."""

    def __init__(self, session: Path, seconds: float) -> None:
        super().__init__(session, seconds)
        self._fd, slave = pty.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        self._slave = slave
        self._thread.start()

    def _read(self) -> bytes:
        ready, _, _ = select.select([self._fd], [], [], 0.002)
        return os.read(self._fd, 4096) if ready else b""

    def _write(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._fd, data[:1024]) :]

    def _run(self) -> None:
        self._serve(self._read, self._write)
        os.close(self._fd)
        os.close(self._slave)
