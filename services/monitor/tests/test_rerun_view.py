"""The end of what takes Rerun's recording: a closed window, a server that died, a full disk."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from zloam_monitor import rerun_view
from zloam_monitor.extras import ViewerError
from zloam_monitor.mcap_file import RecordingError
from zloam_monitor.rerun_view import Options, _Sink


def failing() -> Any:
    def flush() -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    return SimpleNamespace(flush=flush)


def program(*, ended: bool) -> Any:
    return SimpleNamespace(has_ended=lambda: ended)


def test_a_file_that_takes_nothing_more_ends_the_view(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rerun_view, "FLUSH_SECONDS", 0.0)
    sink = _Sink(failing(), Options(save=Path("a.rrd")), None)
    for ask in (sink.is_open, sink.flush):
        with pytest.raises(RecordingError, match=r"^a\.rrd can't be written: File-writer"):
            ask()


def test_a_window_that_was_closed_ends_the_view() -> None:
    assert _Sink(failing(), Options(), program(ended=False)).is_open()
    closed = _Sink(failing(), Options(), program(ended=True))
    assert not closed.is_open()
    closed.flush()


def test_a_server_that_died_is_told() -> None:
    with pytest.raises(ViewerError, match="has ended"):
        _Sink(failing(), Options(web=True), program(ended=True)).is_open()
