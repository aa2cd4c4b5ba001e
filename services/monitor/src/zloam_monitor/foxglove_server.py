"""`foxglove`: shows a robot live in Foxglove and Lichtblick, over their WebSocket protocol."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from zloam_monitor import ending, foxglove_messages, messages, se3
from zloam_monitor.extras import needed
from zloam_monitor.foxglove_scene import TOPICS, Scene, expressions
from zloam_monitor.intake import MIB, Intake
from zloam_monitor.link import Link
from zloam_monitor.map_copy import show_past
from zloam_monitor.ports import in_url, not_listening
from zloam_monitor.terminal import ProgressLine, unreadable

LAYOUT = Path(__file__).with_name("foxglove_layout.json")
#: Limit on messages waiting to be shown; beyond it the oldest are dropped.
MOST_WAITING_BYTES = 32 * MIB
#: Map and path are sent at most this often, if they grew.
SCENE_SECONDS = 1.0
#: Interval at which map and statuses are repeated for viewers that connect later.
AGAIN_SECONDS = 10.0


class Server:
    """Channels for all topics; logged messages go to all connected viewers."""

    def __init__(self, link: Link, address: str, port: int) -> None:
        sdk = needed("foxglove", "foxglove-sdk")
        self._context = sdk.Context()
        self._channels = {}
        for topic, name in TOPICS.items():
            full_name, data = foxglove_messages.schema(name)
            schema = sdk.Schema(name=full_name, encoding="flatbuffer", data=data)
            self._channels[topic] = sdk.Channel(
                topic, schema=schema, message_encoding="flatbuffer", context=self._context
            )
        robot = link.keys.robot
        try:
            self._server = sdk.start_server(
                name=f"zloam: {robot}", host=address, port=port, context=self._context
            )
        except RuntimeError as error:
            raise not_listening(address, port, error) from error
        self.port: int = self._server.port
        mounting = se3.mounting_shown(link.query_configs())
        self._scene = Scene(link.keys, SCENE_SECONDS, mounting)
        self._intake = Intake(
            link.session, expressions(link.keys), MOST_WAITING_BYTES, leave_out="oldest"
        )
        show_past(link, self._scene)
        self._again = 0.0
        #: Numbers of messages shown, and of those that could not be read.
        self.shown = self.garbage = 0

    def poll(self) -> None:
        """Shows all messages received since the last call."""
        for sample in self._intake.taken():
            try:
                self._show(self._scene.take(sample))
            except messages.DECODE_ERRORS:
                self.garbage += 1
        now = time.monotonic()
        if now > self._again:
            self._again = now + AGAIN_SECONDS
            self._show(self._scene.whole(time.time_ns()))

    def _show(self, items: Any) -> None:
        for each in items:
            self._channels[each.topic].log(each.data, log_time=each.stamp_ns)
            self.shown += 1

    def words(self) -> str:
        """Counts of messages, for the line of progress."""
        dropped = sum(self._intake.dropped.values())
        return f"{self.shown} messages shown, {dropped} left out{unreadable(self.garbage)}"

    def close(self) -> None:
        self._intake.close()
        self._server.stop()


def serve(link: Link, address: str, port: int, seconds: float | None) -> int:
    """Serves until `seconds` have passed, or Ctrl-C."""
    server = Server(link, address, port)
    line = ProgressLine()
    try:
        with ending.until_told(seconds) as goes_on:
            print(
                f"ws://{in_url(address)}:{server.port} for Foxglove or Lichtblick (open "
                f"connection, Foxglove WebSocket; import the layout {LAYOUT}); Ctrl-C ends",
                flush=True,
            )
            while goes_on():
                server.poll()
                line.show(server.words())
                time.sleep(0.02)
    finally:
        line.end()
        server.close()
    return 0
