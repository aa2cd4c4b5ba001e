"""A headless Chromium, controlled by the Chrome DevTools protocol."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest
from websockets.sync.client import connect

from zloam_monitor.processes import free_port

#: Options that keep Chromium from contacting any other machine
ALONE = (
    "--disable-background-networking",
    "--disable-component-update",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)


class Browser:
    """One page, in a window of the given size."""

    def __init__(self, url: str, profile: Path, width: int, height: int) -> None:
        program = shutil.which("chromium")
        if program is None:
            pytest.skip("no chromium: apt install chromium")
        self._port = free_port()
        self._process = subprocess.Popen(
            [
                *(program, "--headless=new", "--no-sandbox", "--disable-gpu", *ALONE),
                f"--remote-debugging-port={self._port}",
                f"--user-data-dir={profile}",
                url,
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._count = 0
        #: errors that the page reported
        self.errors: list[str] = []
        try:
            self._socket = connect(self._page(url), max_size=None, legacy=True)
        except BaseException:
            self._process.kill()
            self._process.wait()
            raise
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )

    def _page(self, url: str) -> str:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            try:
                listed = urllib.request.urlopen(f"http://127.0.0.1:{self._port}/json")
                for each in json.load(listed):
                    if each["type"] == "page" and each["url"].startswith(url):
                        return str(each["webSocketDebuggerUrl"])
            except OSError:
                pass
            time.sleep(0.1)
        raise TimeoutError(url)

    def call(self, method: str, **parameters: Any) -> Any:
        self._count += 1
        request = {"id": self._count, "method": method, "params": parameters}
        self._socket.send(json.dumps(request))
        while True:
            said = json.loads(self._socket.recv(timeout=60))
            if said.get("method") == "Log.entryAdded":
                self.errors.append(said["params"]["entry"]["text"])
            if said.get("method") == "Runtime.exceptionThrown":
                self.errors.append(str(said["params"]["exceptionDetails"]))
            if said.get("id") == self._count:
                return said.get("result", said)

    def value(self, expression: str) -> Any:
        """The value of a JavaScript expression, evaluated in the page."""
        return self.call("Runtime.evaluate", expression=expression)["result"].get("value")

    def wait_for(self, expression: str, seconds: float = 60.0) -> None:
        deadline = time.monotonic() + seconds
        while not self.value(expression):
            assert time.monotonic() < deadline, (expression, self.value("document.body.innerText"))
            time.sleep(0.1)

    def press(self, key: str) -> None:
        for kind in ("rawKeyDown", "keyUp"):
            text = {"text": key} if len(key) == 1 else {}
            code = {"Tab": 9, "Enter": 13}.get(key, 0)
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **text
            )

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait()
