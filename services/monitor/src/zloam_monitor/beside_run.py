"""Views beside a demo: the page, and a recording for Rerun if rerun-sdk is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from zloam_monitor import extras, places
from zloam_monitor.processes import Processes, describe_code, free_port, is_free

PAGE_PORT = 8080
#: Files in the run's output folder.
MCAP, RERUN = "run.mcap", "run.rrd"


@contextmanager
def shown(endpoint: str, out: Path, wanted: bool) -> Iterator[list[str]]:
    """While the block runs: serves the page at a printed address and records for Rerun. Yields a
    list that has after the block what failed."""
    lacks: list[str] = []
    if not wanted:
        yield lacks
        return
    port = PAGE_PORT if is_free(PAGE_PORT) else free_port()
    command, logs = str(places.command()), out / "logs"
    views = Processes()
    page = f"http://127.0.0.1:{port}/"
    serve = [command, "web", "--connect", endpoint, "--port", str(port)]
    views.start("web", serve, logs / "web.log")
    print(f"watch it: {page}", flush=True)
    made = {"web": page}
    if importlib.util.find_spec("rerun") is not None:
        keep = [command, "view", "--connect", endpoint, "--save", str(out.resolve() / RERUN)]
        views.start("view", keep, logs / "view.log")
        made["view"] = str(out / RERUN)
    else:
        print(f"no {RERUN}: rerun-sdk is not installed ({extras.advice('rerun-sdk')})", flush=True)
    try:
        yield lacks
    finally:
        # One that is still there at the end, perhaps still starting, has not failed.
        failed = {name: code for name, each in views.running.items() if (code := each.code())}
        views.stop()
        for name, code in failed.items():
            log = logs / f"{name}.log"
            lacks.append(f"{made[name]} by {name}: {describe_code(code)}, see {log}")
