"""Views beside a demo: the page, and a recording for Rerun if rerun-sdk is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from zloam_monitor import places
from zloam_monitor.processes import Processes, free_port, is_free

PAGE_PORT = 8080
#: Files in the run's output folder.
MCAP, RERUN = "run.mcap", "run.rrd"


@contextmanager
def shown(endpoint: str, out: Path, wanted: bool) -> Iterator[None]:
    """While the block runs: serves the page at a printed address and records for Rerun."""
    if not wanted:
        yield
        return
    port = PAGE_PORT if is_free(PAGE_PORT) else free_port()
    command, logs = str(places.command()), out / "logs"
    views = Processes()
    page = [command, "web", "--connect", endpoint, "--port", str(port)]
    views.start("web", page, logs / "web.log")
    print(f"watch it: http://127.0.0.1:{port}/", flush=True)
    if importlib.util.find_spec("rerun") is not None:
        keep = [command, "view", "--connect", endpoint, "--save", str(out.resolve() / RERUN)]
        views.start("view", keep, logs / "view.log")
    else:
        print(f"no {RERUN}: rerun-sdk is not installed (make view-tools)", flush=True)
    try:
        yield
    finally:
        views.stop()
