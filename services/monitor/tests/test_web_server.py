"""What the server of `zloam web` answers to a browser."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator
from http.server import ThreadingHTTPServer
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote
from urllib.request import urlopen

import pytest

from zloam_monitor.keys import name_error
from zloam_monitor.web.server import _Handler

#: Names as page.js encodes them (encodeURIComponent).
NAMES = ("robot", "robot+1", "käthe", "50%25", "a@b:c,d", "a%2Fb")


@pytest.fixture
def url() -> Iterator[str]:
    views = {
        name: SimpleNamespace(
            state=lambda name=name: {"robot": name}, map_view=lambda: {"cell_m": math.nan}
        )
        for name in NAMES
    }
    robots: Any = SimpleNamespace(names=lambda: list(NAMES), view=views.get)
    handler = type("Handler", (_Handler,), {"robots": robots})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_of_any_name_is_shown(url: str, name: str) -> None:
    assert name_error(name) is None
    with urlopen(f"{url}/robots/{quote(name, safe='')}/state.json") as answer:
        assert json.load(answer) == {"robot": name}


def test_what_is_no_number_is_null(url: str) -> None:
    """JSON has no NaN: a browser could read nothing of the answer."""
    with urlopen(f"{url}/robots/robot/map.json") as answer:
        assert answer.read() == b'{"cell_m": null}'
