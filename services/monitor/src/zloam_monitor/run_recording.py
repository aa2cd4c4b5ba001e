"""The recording of a run in the same process (`demo` and `run` with `--record`)."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from zloam_monitor.link import TILES_SECONDS, Link
from zloam_monitor.mcap_file import RecordingError
from zloam_monitor.recorder import Options, Recorder

#: What a thread that records may raise; a run beside it goes on, and reports it at its end.
FAILURES = (RecordingError, OSError, ValueError)


class RunRecording:
    """A recorder with a thread of its own, for a run in the same process."""

    def __init__(self, link: Link, path: Path) -> None:
        self._recorder = Recorder(link, Options(path))
        self._ends = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run)

    def begin(self) -> None:
        """Queries the configuration and starts writing; messages received before are buffered."""
        self._recorder.settle()
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._ends.is_set():
                self._recorder.poll(0.2)
        except FAILURES as error:
            self._error = error
            self._recorder.give_up()

    def catch_up(self) -> None:
        """Waits until all that has come is written: while messages wait here, further ones of a
        replay wait at their publishers, and would be lost with them. Waits for the map from before
        the run, too, as mapping ends next, but not for ever: mapping may hang."""
        ends_s = time.monotonic() + TILES_SECONDS
        while self._thread.is_alive():
            has_map = not self._recorder.asks() or time.monotonic() > ends_s
            if has_map and self._recorder.has_all(0.2):
                return
            time.sleep(0.05)

    def end(self) -> list[str]:
        """Ends the recording; returns texts about what is missing, none if it is complete."""
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join()
        try:
            self._recorder.close()
        except FAILURES as error:
            self._error = self._error or error
        return [*self._failed(), *self._recorder.lacks()]

    def _failed(self) -> list[str]:
        if self._error is None or isinstance(self._error, RecordingError):
            return [str(self._error)] if self._error else []
        return [f"{self._recorder.parts[-1]}: the recording ended early: {self._error}"]


@contextlib.contextmanager
def beside(link: Link, path: Path | None) -> Iterator[RunRecording | None]:
    """Yields a recorder, which ends if the block raises; otherwise the block calls its end()."""
    if path is None:
        yield None
        return
    recording = RunRecording(link, path)
    try:
        yield recording
    except BaseException:
        recording.end()
        raise
