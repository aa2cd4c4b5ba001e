"""What the views of a robot show, read as by the users' programs."""

from __future__ import annotations

import importlib
import json
import struct
import time
import urllib.request
from collections.abc import Callable
from typing import Any

import numpy as np
from websockets.sync.client import connect

from zloam_monitor.foxglove_scene import TOPICS

FRAMES = {(b"map", b"odom"), (b"odom", b"base_link"), (b"base_link", b"lidar")}
#: topics that Foxglove is shown of a driving robot
SHOWN = {"/tf", "/points", "/pose", "/map", "/path", "/log"}


def until(holds: Callable[[], Any], seconds: float = 60.0) -> Any:
    deadline = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < deadline
        time.sleep(0.2)
    return found


def fetched(url: str) -> Any:
    return json.load(urllib.request.urlopen(url, timeout=30))


def answers(page: str) -> bool:
    """Whether the page lists a robot yet."""
    try:
        return bool(fetched(f"{page}/robots.json")["robots"])
    except OSError:
        return False


def has_driven(page: str) -> bool:
    """Whether the robot is ten metres ahead, by the page of `zloam web`."""
    path = fetched(f"{page}/robots/robot/state.json").get("path")
    return (path or [[0]])[-1][0] > 10.0


def rerun_lets_in(data: str, origin: str) -> bool:
    """Whether Rerun's server allows a page of this origin to read its data in a browser (CORS)."""
    question = urllib.request.Request(
        f"{data}/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages",
        headers={"Origin": origin, "Access-Control-Request-Method": "POST"},
        method="OPTIONS",
    )
    with urllib.request.urlopen(question, timeout=30) as answer:
        return answer.headers.get("Access-Control-Allow-Origin") == origin


class FoxgloveClient:
    """A client of Foxglove's protocol that subscribes to every topic."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._topics: dict[int, str] = {}
        #: topic -> messages
        self.shown: dict[str, list[bytes]] = {}

    def listen(self, enough: Callable[[], bool], patience_s: float = 30.0) -> None:
        """Receives messages until `enough`; fails if nothing arrives for `patience_s`."""
        protocol: Any = ["foxglove.sdk.v1"]
        with connect(self._url, subprotocols=protocol, max_size=None) as socket:
            while not enough():
                message = socket.recv(timeout=patience_s)
                if isinstance(message, str):
                    self._ask(socket, json.loads(message).get("channels", []))
                else:
                    _, number, _ = struct.unpack_from("<BIQ", message)
                    self.shown.setdefault(self._topics[number], []).append(message[13:])

    def whole(self) -> bool:
        """Whether everything has arrived that is shown of a driving robot."""
        return self.shown.keys() >= SHOWN and transforms(self.shown["/tf"]) >= FRAMES

    def _ask(self, socket: Any, channels: list[dict[str, Any]]) -> None:
        for channel in channels:
            assert channel["schemaName"] == f"foxglove.{TOPICS[channel['topic']]}"
            assert channel["encoding"] == channel["schemaEncoding"] == "flatbuffer"
            number = len(self._topics)
            self._topics[number] = channel["topic"]
            asked = [{"id": number, "channelId": channel["id"]}]
            socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))


def assert_foxglove_shows_the_drive(url: str) -> None:
    """Decodes the messages by the code that Foxglove publishes with its schemas."""
    client = FoxgloveClient(url)
    ends = time.monotonic() + 60.0
    client.listen(lambda: client.whole() or time.monotonic() > ends)
    shown = client.shown
    assert client.whole(), (shown.keys(), transforms(shown.get("/tf", [])))
    cloud = read("/points", shown)
    assert cloud.FrameId() == b"base_link"
    data = np.frombuffer(cloud.DataAsNumpy().tobytes(), "<f4").reshape(-1, 4)
    assert len(data) > 1000
    assert 2.0 < np.linalg.norm(data[:, :3], axis=1).max() < 150.0
    assert transforms(shown["/tf"]) == FRAMES
    # The whole path, though the drive began before this client connected.
    path = read("/path", shown)
    ahead = [path.Poses(i).Position().X() for i in range(path.PosesLength())]
    assert abs(ahead[0]) < 0.5
    assert max(ahead) > 10.0


def transforms(messages: list[bytes]) -> set[tuple[bytes, bytes]]:
    """(parent, child) of all transforms."""
    read_all = [module("FrameTransforms").GetRootAs(each) for each in messages]
    each_of = [of.Transforms(i) for of in read_all for i in range(of.TransformsLength())]
    return {(each.ParentFrameId(), each.ChildFrameId()) for each in each_of}


def module(name: str) -> Any:
    return getattr(importlib.import_module(f"foxglove_schemas_flatbuffer.{name}"), name)


def read(topic: str, shown: dict[str, list[bytes]]) -> Any:
    return module(TOPICS[topic]).GetRootAs(shown[topic][-1])
