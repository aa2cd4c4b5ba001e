"""Runs all views of a robot at once, in a process of its own so that it can run on another host:
`python -m tests.integration.all_views ENDPOINT FOLDER`. Until it is ended, it writes how much each
view has shown so far into FOLDER/shown.json."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from tests.integration.conftest import ROOT
from tests.integration.views import FoxgloveClient, fetched, until
from zloam_monitor.processes import Processes, free_port

#: interval at which FOLDER/shown.json is written
EVERY_S = 2.0
START_S = 120.0
#: view -> its command line, after `zloam`
COMMANDS = {
    "watch": ("watch", "--json", "--every", "1"),
    "web": ("web", "--port", "0"),
    "thin": ("web", "--thin", "--port", "0"),
    "foxglove": ("foxglove", "--port", "0"),
    "view": ("view", "--web", "--port", "{port}"),
    "file": ("view", "--save", "{folder}/drive.rrd"),
}


class AllViews:
    """Starts the views and keeps them running; each view has its log in the folder."""

    def __init__(self, endpoint: str, folder: Path) -> None:
        self._folder = folder
        self._processes = Processes()
        environment = {
            "PYTHONPATH": f"{ROOT}/services/monitor/src",
            "PYTHONUNBUFFERED": "1",
            "XDG_CONFIG_HOME": str(folder),
        }
        for name, words in COMMANDS.items():
            told = [word.format(port=free_port(), folder=folder) for word in words]
            command = [sys.executable, "-m", "zloam_monitor", *told, "--connect", endpoint]
            self._processes.start(name, command, folder / f"{name}.log", environment)
        self._client: FoxgloveClient | None = None

    def _said(self, name: str, pattern: str) -> str | None:
        found = re.search(pattern, (self._folder / f"{name}.log").read_text())
        return found[1] if found else None

    def _sweep_of_page(self, name: str) -> int:
        page = self._said(name, r"(http://\S+)/ shows ")
        if page is None:
            return 0
        pose = fetched(f"{page}/robots/robot/state.json").get("pose")
        return int(pose["sweep"]) if pose else 0

    def _sweep_of_watch(self) -> int:
        looks = [line for line in self._lines("watch") if line.startswith("{")]
        pose = json.loads(looks[-1])["pose"] if looks else None
        return int(pose["sweep"]) if pose else 0

    def _lines(self, name: str) -> list[str]:
        return (self._folder / f"{name}.log").read_text().splitlines()

    def _foxglove_messages(self) -> int:
        """Number of messages that a client has received which subscribes to every topic, as
        Foxglove does with all its panels open."""
        url = self._said("foxglove", r"(ws://127\.0\.0\.1:\d+)")
        if url is None:
            return 0
        if self._client is None:
            self._client = client = FoxgloveClient(url)
            threading.Thread(target=client.listen, args=(lambda: False,), daemon=True).start()
        return sum(map(len, self._client.shown.values()))

    def _file_bytes(self) -> int:
        with contextlib.suppress(OSError):
            return (self._folder / "drive.rrd").stat().st_size
        return 0

    def shown(self) -> dict[str, int]:
        """For each view, a number that grows as long as the view shows new data."""
        self._processes.check()
        looks: dict[str, Callable[[], int]] = {
            "watch": self._sweep_of_watch,
            "web": lambda: self._sweep_of_page("web"),
            "thin": lambda: self._sweep_of_page("thin"),
            "foxglove": self._foxglove_messages,
            "file": self._file_bytes,
        }
        return {name: look() for name, look in looks.items()}

    def wait_open(self) -> None:
        until(lambda: self._said("view", r"(http://\S+);"), START_S)
        until(lambda: all(self.shown().values()), START_S)

    def close(self) -> None:
        self._processes.stop()


def main(endpoint: str, folder: Path) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with contextlib.closing(AllViews(endpoint, folder)) as views:
        views.wait_open()
        while True:
            partial = folder / "shown.json.part"
            partial.write_text(json.dumps(views.shown()))
            partial.replace(folder / "shown.json")
            time.sleep(EVERY_S)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
