"""`watch`: shows one robot as text, on any host that can reach it."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import Any

from zloam_monitor import answers, pose_health
from zloam_monitor.link import Link
from zloam_monitor.records import StatusRecord
from zloam_monitor.stages import ROWS, STAGES

#: Age at which a status is stale: they come once a second, and several in a row are rarely lost.
STALE_SECONDS = 5.0
#: Links to further stages come up one after another after the first one answers.
ALL_SECONDS = 1.5


def rate_text(link: Link, now: float) -> str:
    """The rate of poses with a comma; empty after a time too short for a rate."""
    rate = link.posed.per_s(now)
    return "" if rate is None else f"{rate:.1f} poses/s, "


def state_line(link: Link, now: float) -> str:
    """One line: position of the robot, and rate of poses."""
    newest = link.poses.last()
    if newest is None:
        return "no pose yet"
    x, y, z = newest.translation
    marks = ", degenerate" if newest.degenerate else ""
    return f"sweep {newest.sweep}, {rate_text(link, now)}at {x:.2f} {y:.2f} {z:.2f} m{marks}"


def _amount(link: Link, status: StatusRecord) -> str:
    """Messages through a stage: those that it sent if it is a source, which receives none here."""
    if not ROWS[status.stage].reads:
        return f"sent     {status.published.get(link.keys.main_output(status.stage), 0):>7}"
    return f"received {sum(each.received for each in status.inputs):>7}"


def _stage_line(link: Link, status: StatusRecord, silent_s: float) -> str:
    queued = sum(each.queued for each in status.inputs)
    drops = {
        reason: count for each in status.inputs for reason, count in each.dropped.items() if count
    }
    words = [
        f"{status.stage:<13}{status.health:<9}",
        f"{_amount(link, status)}  queued {queued:>3}",
        f"RSS {status.rss_mib['end']:6.0f} MiB  CPU {status.cpu_ms / 1000:7.1f} s",
    ]
    if drops:
        words.append("dropped " + ", ".join(f"{n} {reason}" for reason, n in drops.items()))
    if status.reason:
        words.append(status.reason)
    if silent_s > STALE_SECONDS:
        words.append(f"STALE: nothing heard for {silent_s:.0f} s")
    return "  ".join(words)


def traffic_lines(link: Link, now: float) -> Iterator[str]:
    """Lines about the data rate of each key for one subscriber; payloads, to which Zenoh and TCP
    add some percent."""
    prefix = link.keys.below("")
    rates = link.published.kb_s()
    if rates:
        named = (f"{key.removeprefix(prefix)} {_kb(rate)}" for key, rate in rates.items())
        yield "a subscriber takes, kB/s: " + ", ".join(named)
    taken = link.taken.kb_s(now)
    if taken is not None:
        yield f"this view takes {_kb(taken)} kB/s"


def _kb(rate: float) -> str:
    return f"{rate:.1f}" if rate < 100.0 else f"{rate:.0f}"


def view(link: Link, now: float) -> Iterator[str]:
    """Lines of one update."""
    yield f"robot '{link.keys.robot}': {state_line(link, now)}"
    for stage in STAGES:
        status = link.stage(stage)
        if status is None:
            yield f"{stage:<13}nothing heard"
        else:
            yield _stage_line(link, status, link.silent_s(status, now))
    if link.poses:
        yield pose_health.line(pose_health.judge(link.poses.values()).as_dict())
    yield from traffic_lines(link, now)
    if link.garbage:
        yield f"{link.garbage} messages could not be read"


def looked(link: Link, now: float) -> dict[str, Any]:
    """One update as plain values, for JSON."""
    newest = link.poses.last()
    stages = link.newest_statuses()
    return {
        "robot": link.keys.robot,
        "pose": newest,
        "poses_per_s": link.posed.per_s(now),
        "stages": stages,
        "silent_s": {name: link.silent_s(status, now) for name, status in stages.items()},
        "health": pose_health.judge(link.poses.values()).as_dict() if newest else None,
        "unreadable_messages": link.garbage,
        "subscriber_kb_s": link.published.kb_s(),
        "this_view_kb_s": link.taken.kb_s(now),
    }


def _show(link: Link, now: float, as_json: bool) -> None:
    if as_json:
        print(answers.text(looked(link, now)), flush=True)
    else:
        print("\n".join(view(link, now)), flush=True)


def _dead(link: Link) -> list[StatusRecord]:
    """Newest statuses of instances without a liveliness token: a router that stores statuses still
    answers with them, and that of an ended instance may have a greater stamp than its successor's,
    if the robot's clock was set back. One that says `stopping` shows by itself that it ends."""
    living = link.living_instances()
    return [
        status
        for stage, status in link.newest_statuses().items()
        if (stage, status.instance) not in living and status.health != "stopping"
    ]


def _gathered(link: Link, patience_s: float) -> list[StatusRecord]:
    """Waits until all stages and a pose were heard; returns the statuses of dead instances."""
    deadline = time.monotonic() + patience_s
    while True:
        link.query_statuses()
        link.poll()
        # A pose comes within some sweeps if any are published; after the end of a run none come.
        whole = len(link.newest_statuses()) == len(STAGES) and len(link.poses) > 0
        late = time.monotonic() > deadline
        dead = _dead(link) if whole or late else []
        # A starting stage answers a moment before its token is there.
        if late or (whole and not dead):
            return dead
        link.poll(0.2)


def look(link: Link, as_json: bool = False) -> int:
    """Prints one update; returns 1 if a stage has failed, is silent, or is no longer there."""
    dead = _gathered(link, ALL_SECONDS)
    _show(link, time.monotonic(), as_json)
    for status in dead:
        print(
            f"{status.stage}: {status.instance} is not alive; its status above is its last one, "
            f"which a router keeps. See logs/{status.stage}.log or docker compose logs "
            f"{status.stage}",
            file=sys.stderr,
        )
    found = link.newest_statuses()
    failed = any(status.health == "failed" for status in found.values())
    return 1 if dead or failed or len(found) < len(STAGES) else 0


def watch(link: Link, seconds: float | None, every_s: float, as_json: bool = False) -> int:
    """Prints an update as soon as all is heard, and then every `every_s`; returns 1 if nothing was
    heard."""
    try:
        # Else the first update says `no pose yet`, as none has come in its first milliseconds.
        _gathered(link, ALL_SECONDS)
        began = time.monotonic()
        shown = began - every_s
        while seconds is None or time.monotonic() - began < seconds:
            now = time.monotonic()
            if now - shown >= every_s:
                shown = now
                _show(link, now, as_json)
                if not as_json:
                    print(flush=True)
            link.poll(0.2)
    except KeyboardInterrupt:
        pass
    return 0 if link.statuses or link.poses else 1
