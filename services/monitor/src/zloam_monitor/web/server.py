"""`web`: serves the page and its contents to browsers."""

from __future__ import annotations

import gzip
import re
import socket
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, NamedTuple
from urllib.parse import unquote

from zloam_monitor import answers, discovery, ending
from zloam_monitor.discovery import Found
from zloam_monitor.link import LinkError
from zloam_monitor.ports import in_url, not_listening
from zloam_monitor.version import version
from zloam_monitor.web.robot_view import RobotView

#: Interval at which further robots are searched.
SEARCH_SECONDS = 10.0
#: Number of newest poses that are kept of each robot.
NEWEST_POSES = 3000
FILES = {
    "/": ("page.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
}
_ROBOT = re.compile(r"^/robots/([^/]+)/(state|map)\.json$")


class _Shown(NamedTuple):
    """A robot's view, and what is open for it."""

    view: RobotView
    endpoint: str
    opened: ExitStack


class Robots:
    """All robots that were found; raises NothingAnswers if there are none."""

    def __init__(self, endpoints: Sequence[str], thin: bool = False) -> None:
        self._endpoints, self._thin = endpoints, thin
        self._shown: dict[str, _Shown] = {}
        found = discovery.present(endpoints)
        #: Texts about robots of one name, of which the page shows one.
        self.namesakes = discovery.namesakes(found)
        for each in found:
            self._add(each)

    def search(self) -> None:
        """Searches again, and adds new robots, and those that were started again elsewhere."""
        found = discovery.robots([discovery.endpoint_of(each) for each in self._endpoints])
        self.namesakes = discovery.namesakes(found)
        for each in found:
            # A robot may have vanished since the search; the others are still shown.
            with suppress(LinkError):
                self._add(each)

    def _add(self, found: Found) -> None:
        before = self._shown.get(found.robot)
        if before is not None and (before.endpoint == found.endpoint or not before.view.is_gone()):
            return
        with ExitStack() as opened:
            linked = discovery.linked_to(found, NEWEST_POSES, self._thin)
            view = RobotView(opened.enter_context(linked))
            opened.callback(view.close)
            self._shown[found.robot] = _Shown(view, found.endpoint, opened.pop_all())
        if before is not None:
            before.opened.close()

    def silences(self) -> list[str]:
        """Advice for thin views that get no preview."""
        views = [each.view for each in self._shown.values()]
        return [said for view in views if (said := view.silence()) is not None]

    def names(self) -> list[str]:
        return sorted(self._shown)

    def view(self, name: str) -> RobotView | None:
        shown = self._shown.get(name)
        return None if shown is None else shown.view

    def close(self) -> None:
        for each in self._shown.values():
            each.opened.close()


class _Handler(BaseHTTPRequestHandler):
    server_version = f"zloam/{version()}"
    robots: Robots

    def do_GET(self) -> None:
        # A browser no longer waits for what it has aborted.
        with suppress(ConnectionError):
            self._serve()

    def _serve(self) -> None:
        path = self.path.partition("?")[0]
        if path in FILES:
            name, kind = FILES[path]
            data = (resources.files("zloam_monitor.web") / name).read_bytes()
            self._answer(HTTPStatus.OK, kind, data)
        elif path == "/robots.json":
            self._json({"robots": self.robots.names(), "version": version()})
        elif match := _ROBOT.match(path):
            # A name may have other characters than an address, which encodes them.
            self._robot(unquote(match[1]), match[2])
        else:
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"nothing is here\n")

    def _robot(self, name: str, what: str) -> None:
        view = self.robots.view(name)
        if view is None:
            self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"no such robot\n")
        else:
            self._json(view.state() if what == "state" else view.map_view())

    def _json(self, value: Any) -> None:
        # Browsers refuse what Python's JSON has beyond JSON, such as NaN.
        self._answer(HTTPStatus.OK, "application/json", answers.text(value).encode())

    def _answer(self, status: HTTPStatus, kind: str, data: bytes) -> None:
        packed = "gzip" in self.headers.get("Accept-Encoding", "") and len(data) > 500
        if packed:
            data = gzip.compress(data, compresslevel=5)
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        # The page may load only its own files, and no other page may embed it.
        self.send_header(
            "Content-Security-Policy", "default-src 'self'; img-src data:; frame-ancestors 'none'"
        )
        self.send_header("X-Content-Type-Options", "nosniff")
        if packed:
            self.send_header("Content-Encoding", "gzip")
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Does nothing: there would be a line every second."""


class _Server(ThreadingHTTPServer):
    """Listens on an address of IPv4 or IPv6."""

    def __init__(self, address: str, port: int, handler: type[_Handler]) -> None:
        found = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM)
        # A name may have both, as localhost has: then IPv4, whatever the resolver prefers.
        self.address_family = min(family for family, *_ in found)
        super().__init__((address, port), handler)


def serve(
    endpoints: Sequence[str], address: str, port: int, seconds: float | None, thin: bool = False
) -> int:
    """Serves until `seconds` have passed, or Ctrl-C."""
    robots = Robots(endpoints, thin)
    handler = type("Handler", (_Handler,), {"robots": robots})
    try:
        server = _Server(address, port, handler)
    except (OSError, UnicodeError) as error:  # UnicodeError: of a name like a..b.
        robots.close()
        raise not_listening(address, port, error) from error
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    searched = time.monotonic()
    said: list[str] = []
    namesakes: list[str] = []
    try:
        with ending.until_told(seconds) as goes_on:
            where, whom = f"{in_url(address)}:{server.server_port}", ", ".join(robots.names())
            print(f"http://{where}/ shows {whom}; Ctrl-C ends", flush=True)
            while goes_on():
                time.sleep(0.1)
                if (silences := robots.silences()) != said:
                    said = silences
                    print("\n".join(said) or "the preview comes", file=sys.stderr, flush=True)
                if robots.namesakes != namesakes:
                    namesakes = robots.namesakes
                    for text in namesakes:
                        print(f"the page shows one of them: {text}", file=sys.stderr, flush=True)
                if time.monotonic() - searched > SEARCH_SECONDS:
                    robots.search()
                    searched = time.monotonic()
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
        robots.close()
    return 0
