"""Peers that hear of each other through a third one get exactly one link between each pair."""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from zloam_monitor.link import open_session
from zloam_monitor.processes import free_port

PEERS = 6
PATIENCE_S = 60.0
#: A second link would come together with the first.
SETTLED_S = 0.5


def links_of(session: Any) -> Counter[str]:
    """Number of links by the other session's identifier."""
    return Counter(str(link.zid) for link in session.info.links())


def test_each_two_peers_have_one_link() -> None:
    meeting_point = f"tcp/127.0.0.1:{free_port()}"
    first = open_session([], meeting_point)
    with ThreadPoolExecutor(PEERS) as pool:
        sessions = [first, *pool.map(lambda _: open_session([meeting_point]), range(PEERS))]
    try:
        deadline = time.monotonic() + PATIENCE_S
        while any(len(links_of(each)) < PEERS for each in sessions):
            assert time.monotonic() < deadline, [len(links_of(each)) for each in sessions]
            time.sleep(0.05)
        time.sleep(SETTLED_S)
        for session in sessions:
            assert set(links_of(session).values()) == {1}
    finally:
        for session in sessions:
            session.close()
