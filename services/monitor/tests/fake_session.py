"""A stand-in for a Zenoh session with one robot, whose answers a test writes down."""

from __future__ import annotations

import json
import random
from types import SimpleNamespace
from typing import Any

import flatbuffers
import pytest
import zenoh

from zloam_monitor import compose, messages
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link
from zloam_monitor.records import SERVICE_HEALTH

#: Longer than what a recording's file collects before it writes.
LONG_BYTES = 5 << 20


def reply(key: str, payload: bytes) -> Any:
    text = payload.decode(errors="replace")
    content = SimpleNamespace(to_bytes=lambda: payload, to_string=lambda: text)
    return SimpleNamespace(ok=SimpleNamespace(key_expr=key, payload=content))


class FakeSession:
    """Answers queries from `rounds`: key -> answers to the first query, to the second and so on;
    the last ones are repeated."""

    def __init__(self, alive: tuple[str, ...] = ()) -> None:
        self.keys = Keys("robot")
        #: Stages with a liveliness token.
        self.alive = alive
        self.rounds: dict[str, list[list[bytes]]] = {}
        #: Key of a tile -> answers to a query for heads, which nothing else answers.
        self.heads: dict[str, list[bytes]] = {}
        #: Selectors of all queries, in order.
        self.selectors: list[str] = []
        self.subscribers: dict[str, Any] = {}

    def config_key(self, stage: str) -> str:
        return self.keys.below(f"service/{stage}/{stage}-1/config")

    def get(self, selector: str, handler: Any = None, **_: Any) -> list[Any]:
        self.selectors.append(selector)
        expression, _mark, parameters = selector.partition("?")
        asked = zenoh.KeyExpr(expression)
        if parameters == "heads":
            there = [key for key in self.heads if asked.intersects(zenoh.KeyExpr(key))]
            return [reply(key, each) for key in there for each in self.heads[key]]
        replies = []
        for key, rounds in self.rounds.items():
            if asked.intersects(zenoh.KeyExpr(key)):
                answers = rounds.pop(0) if len(rounds) > 1 else rounds[0]
                replies += [reply(key, each) for each in answers]
        if handler is not None:
            for each in replies:
                handler(each)
        return replies

    def liveliness(self) -> Any:
        keys = [self.keys.below(f"service/{stage}/{stage}-1/alive") for stage in self.alive]
        return SimpleNamespace(get=lambda _, **__: [reply(key, b"") for key in keys])

    def declare_subscriber(self, key: str, read: Any) -> Any:
        self.subscribers[key] = read
        return SimpleNamespace(undeclare=lambda: None)

    def close(self) -> None: ...

    def publish(self, key: str, payload: bytes) -> None:
        for expression, read in self.subscribers.items():
            if zenoh.KeyExpr(expression).intersects(zenoh.KeyExpr(key)):
                read(reply(key, payload).ok)

    def publish_long_pose(self, number: int) -> bytes:
        """Publishes random bytes as a pose; returns them."""
        data = random.Random(number).randbytes(LONG_BYTES)
        self.publish(self.keys.pose, data)
        return data

    def publish_status(self, stage: str, at_ns: int = 1, health: str = "ready") -> None:
        key = self.config_key(stage).replace("/config", "/status")
        number = SERVICE_HEALTH.index(health)
        self.publish(key, compose.status(stage, at_ns, 1, None, [], {}, health=number))


def revision(stage: str, rev: int, values: dict[str, Any]) -> bytes:
    """A ConfigRevision message."""
    b = flatbuffers.Builder(0)
    texts = {"Stage": stage, "ValuesJson": json.dumps(values), "By": f"{stage}-1"}
    made = {name: b.CreateString(text) for name, text in texts.items()}
    code = messages.module("ConfigRevision")
    code.Start(b)
    for name, offset in made.items():
        getattr(code, f"Add{name}")(b, offset)
    code.AddRev(b, rev)
    b.Finish(code.End(b), messages.KINDS["ConfigRevision"].identifier)
    return bytes(b.Output())


def needs_schemas() -> None:
    """Skips a test of a tree that was not built."""
    try:
        messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))


def one_misses_a_query() -> FakeSession:
    """Two living stages, of which mapping answers only the second query for its configuration."""
    made = FakeSession(alive=("odometry", "mapping"))
    made.rounds[made.config_key("odometry")] = [[compose.config("odometry", {"a.b": 1})]]
    made.rounds[made.config_key("mapping")] = [[], [compose.config("mapping", {"c.d": 2})]]
    return made


def linked(session: Any) -> Link:
    return Link(session, Keys("robot"), newest=0)
