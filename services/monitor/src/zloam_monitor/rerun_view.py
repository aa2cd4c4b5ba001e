"""`view`: shows a robot live in Rerun: in a window, in the browser, or into a file."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from zloam_monitor import ending, se3, thin
from zloam_monitor.extras import ViewerError, needed
from zloam_monitor.intake import MIB, Intake
from zloam_monitor.link import Link
from zloam_monitor.map_copy import show_past
from zloam_monitor.mcap_file import RecordingError
from zloam_monitor.ports import PortTaken, in_url
from zloam_monitor.processes import is_free
from zloam_monitor.rerun_scene import Scene, blueprint, expressions
from zloam_monitor.terminal import ProgressLine, unreadable

#: Limit on messages waiting to be drawn; beyond it the oldest are dropped.
MOST_WAITING_BYTES = 64 * MIB
#: Memory in which the server for browsers keeps data for those who open the page later.
KEPT = "512MiB"
APPLICATION = "zloam"
HERE = "127.0.0.1"
#: All addresses of a machine -> one by which the machine reaches itself.
EVERYWHERE = {"0.0.0.0": HERE, "::": "::1"}
START_SECONDS = 20.0
#: Room that a file needs at its beginning; Rerun writes some 25 kB of layout at once.
BEGINNING_BYTES = MIB
#: Interval at which a file is asked whether it takes what is written.
FLUSH_SECONDS = 0.5


@dataclass(frozen=True)
class Options:
    """Where the robot is shown; without web and save in a window."""

    web: bool = False
    #: Port of the page; the data use the next one.
    port: int = 9090
    #: Address that the servers listen on.
    address: str = HERE
    save: Path | None = None
    #: Also show sweeps, features and rejected points.
    points: bool = True

    @property
    def host(self) -> str:
        """Host by which this machine reaches the servers."""
        return EVERYWHERE.get(self.address, self.address)

    @property
    def data(self) -> str:
        """Address of the server of the data."""
        return f"rerun+http://{in_url(self.host)}:{self.port + 1}/proxy"

    @property
    def page(self) -> str:
        """Address of the page for browsers, with the address of its data."""
        page = f"http://{in_url(self.host)}:{self.port}/?url={quote(self.data, safe='')}"
        if self.address not in EVERYWHERE:
            return page
        return f"{page} (elsewhere with this machine's name for {self.host}, both times)"


class Viewer:
    """Rerun's own program: a window, or a server for browsers. close() ends it."""

    def __init__(self, options: Options) -> None:
        self._settings = tempfile.TemporaryDirectory(prefix="zloam-rerun-")
        self._quiet()
        program = Path(needed("rerun_cli", "rerun-sdk").__file__).with_name("rerun")
        command = [str(program), "--bind", options.address]
        command += ["--port", str(options.port + 1), "--hide-welcome-screen"]
        if options.web:
            command += ["--serve-web", "--web-viewer-port", str(options.port)]
            command += ["--server-memory-limit", KEPT]
        if options.web and options.address != HERE:
            # The page gets its data from another port, where Rerun by default accepts only pages
            # from its own machine; opened from elsewhere, the page would stay empty.
            command += ["--cors-allow-origin", f"http://*:{options.port}"]
        environment = {**os.environ, "XDG_CONFIG_HOME": self._settings.name}
        for port in (options.port, options.port + 1):
            if not is_free(port, options.address):
                raise PortTaken(
                    f"{in_url(options.address)}:{port} is taken: choose others by --port"
                )
        self._words = Path(self._settings.name) / "words"
        with self._words.open("w") as out:
            self._process = subprocess.Popen(command, env=environment, stdout=out, stderr=out)

    def _quiet(self) -> None:
        """Turns off Rerun's analytics."""
        file = Path(self._settings.name) / "rerun" / "analytics.json"
        file.parent.mkdir()
        said = {"analytics_enabled": False, "analytics_id": "", "metadata": {}}
        file.write_text(json.dumps(said))

    def wait_for(self, host: str, port: int) -> None:
        """Waits until Rerun accepts connections; raises ViewerError with its message otherwise."""
        deadline = time.monotonic() + START_SECONDS
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                words = self._words.read_text().strip().splitlines()[-1:]
                raise ViewerError(
                    f"Rerun ended: {' '.join(words)}; --web and --save need no screen"
                )
            with contextlib.suppress(OSError):
                socket.create_connection((host, port), timeout=1.0).close()
                return
            time.sleep(0.1)
        raise ViewerError(f"Rerun does not answer after {START_SECONDS:.0f} s")

    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait()
        self._settings.cleanup()


def _try_room(path: Path) -> None:
    """Raises OSError, and leaves no file, if the disk has no room for the beginning of a recording:
    Rerun then waits for ever for the layout to be written."""
    with path.open("xb") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, BEGINNING_BYTES)
        finally:
            path.unlink(missing_ok=True)


def _saved(recording: Any, path: Path, plan: Any) -> None:
    """Makes the recording write to a new file; raises RecordingError."""
    if os.path.lexists(path):
        raise RecordingError(f"{path} is there already: choose another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _try_room(path)
        recording.save(path, default_blueprint=plan)
    except (OSError, RuntimeError) as error:  # The latter is Rerun's, for any failure.
        why = getattr(error, "strerror", None) or error
        raise RecordingError(f"{path} can't be created: {why}") from error


class _Sink:
    """What takes the recording: a file, or Rerun's program."""

    def __init__(self, recording: Any, options: Options, viewer: Viewer | None) -> None:
        self._recording, self._options, self._viewer = recording, options, viewer
        self._flushed_s = time.monotonic()

    def __str__(self) -> str:
        if self._options.save is not None:
            return f"{self._options.save} (`rerun {self._options.save}` shows it)"
        return self._options.page if self._options.web else "a window of Rerun"

    def is_open(self) -> bool:
        """False: the window was closed. Raises if the file or the server takes nothing more."""
        if self._viewer is not None and self._viewer.has_ended():
            if self._options.web:
                raise ViewerError("Rerun's server has ended: start it again")
            return False
        if self._viewer is None and time.monotonic() - self._flushed_s > FLUSH_SECONDS:
            self.flush()
        return True

    def flush(self) -> None:
        """Rerun has no other error than this one for a file, and none that says why."""
        self._flushed_s = time.monotonic()
        try:
            self._recording.flush()
        except RuntimeError as error:
            if self._options.save is not None:
                raise RecordingError(
                    f"{self._options.save} can't be written: {error}; is the disk full? What was "
                    "written before is in it"
                ) from error
            # Ctrl-C on the terminal ends Rerun, too, which then shows nothing more.


@contextlib.contextmanager
def _shown(recording: Any, options: Options, plan: Any) -> Iterator[_Sink]:
    """Shows the recording during the block."""
    if options.save is not None:
        _saved(recording, options.save, plan)
        yield _Sink(recording, options, None)
        return
    with contextlib.closing(Viewer(options)) as viewer:
        viewer.wait_for(options.host, options.port + 1)
        recording.connect_grpc(options.data, default_blueprint=plan)
        try:
            yield _Sink(recording, options, viewer)
        finally:
            recording.disconnect()


def view(link: Link, options: Options, seconds: float | None) -> int:
    """Shows a robot until `seconds` have passed, or Ctrl-C."""
    rr = needed("rerun", "rerun-sdk")
    recording = rr.RecordingStream(APPLICATION, recording_id=f"{link.keys.robot}-{time.time_ns()}")
    mounting = se3.mounting_shown({} if link.thin else link.query_configs())
    with _shown(recording, options, blueprint(rr)) as sink:
        scene = Scene(link.keys, recording, mounting)
        intake = Intake(
            link.session,
            thin.expressions(link.keys) if link.thin else expressions(link.keys, options.points),
            MOST_WAITING_BYTES,
            leave_out="oldest",
        )
        if not link.thin:
            show_past(link, scene)
        drawn = _draw(link, intake, scene, seconds, sink)
        sink.flush()
    dropped = sum(intake.dropped.values())
    rate = link.taken.kb_s(time.monotonic())
    took = f"; this view took {rate:.1f} kB/s" if rate is not None else ""
    unread = unreadable(scene.garbage)
    print(f"{drawn} messages shown, {dropped} left out{unread}{took}", flush=True)
    return 0


def _draw(link: Link, intake: Intake, scene: Scene, seconds: float | None, sink: _Sink) -> int:
    line = ProgressLine()
    drawn = 0
    said: str | None = None
    # The preview's silence counts from here, as messages are received from now on.
    link.preview_s = time.monotonic()
    with ending.until_told(seconds) as goes_on:
        print(f"{sink}; Ctrl-C ends", flush=True)
        while goes_on() and sink.is_open():
            now = time.monotonic()
            for sample in intake.taken():
                scene.take(sample)
                link.taken.take(len(sample.payload), now)
                if sample.key == link.keys.preview:
                    link.preview_s = now
                drawn += 1
            if link.thin and (silent := thin.silence(link)) != said:
                said = silent
                print(f"\n{said or 'the preview comes'}", file=sys.stderr, flush=True)
            rate = link.taken.kb_s(now)
            takes = f"; this view takes {rate:.1f} kB/s" if rate is not None else ""
            line.show(f"{drawn - scene.garbage} messages shown{unreadable(scene.garbage)}{takes}")
            time.sleep(0.02)
    line.end()
    intake.close()
    return drawn - scene.garbage
