"""`watch`: a text view of one robot for any host that can reach it."""

from __future__ import annotations

import time
from collections.abc import Iterator

from zloam_monitor.keys import STAGES, Keys
from zloam_monitor.link import Link, open_session
from zloam_monitor.live import state_line
from zloam_monitor.records import StatusRecord

#: stages say how they are once a second: more than a few of these lost is no chance
STALE_SECONDS = 5.0


def _stage_line(status: StatusRecord, silent_s: float) -> str:
    received = sum(each.received for each in status.inputs)
    queued = sum(each.queued for each in status.inputs)
    drops = {
        reason: count for each in status.inputs for reason, count in each.dropped.items() if count
    }
    words = [
        f"{status.stage:<13}{status.health:<9}",
        f"received {received:>7}  queued {queued:>3}",
        f"RSS {status.rss_mib['end']:6.0f} MiB  CPU {status.cpu_ms / 1000:7.1f} s",
    ]
    if drops:
        words.append("dropped " + ", ".join(f"{n} {reason}" for reason, n in drops.items()))
    if status.reason:
        words.append(status.reason)
    if silent_s > STALE_SECONDS:
        words.append(f"STALE: nothing heard for {silent_s:.0f} s")
    return "  ".join(words)


def view(link: Link, began: float, now: float) -> Iterator[str]:
    """The lines of one look."""
    yield f"robot {link.keys.robot}: {state_line(link, began, now)}"
    for stage in STAGES:
        status = link.stage(stage)
        if status is None:
            yield f"{stage:<13}nothing heard"
        else:
            yield _stage_line(status, link.silent_s(status, now))
    if link.garbage:
        yield f"{link.garbage} messages could not be read"


def watch(keys: Keys, endpoints: list[str], seconds: float | None, every_s: float) -> int:
    """Prints a look every so often; exit code 1 when nothing at all was heard."""
    session = open_session(endpoints)
    link = Link(session, keys)
    began = shown = time.monotonic()
    try:
        while seconds is None or time.monotonic() - began < seconds:
            link.poll(0.2)
            now = time.monotonic()
            if now - shown >= every_s:
                shown = now
                print("\n".join(view(link, began, now)), flush=True)
                print(flush=True)
    except KeyboardInterrupt:
        pass
    finally:
        link.close()
        session.close()
    return 0 if link.statuses or link.poses else 1
