"""Views over a thin link: the keys they use, and advice if no preview comes."""

from __future__ import annotations

import time

from zloam_monitor.heard import Finding, Heard
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link
from zloam_monitor.records import StatusRecord
from zloam_monitor.watch import STALE_SECONDS

#: Time without a preview that is reported; four previews come each second.
SILENT_SECONDS = 2.0


def expressions(keys: Keys) -> list[str]:
    """All keys that a thin view subscribes to."""
    return [keys.preview, keys.every_status]


def finding(link: Link) -> Finding | None:
    """Advice on what to start; None: previews come, or the view is not thin."""
    if not link.thin or time.monotonic() - link.preview_s < SILENT_SECONDS:
        return None
    return Finding(
        f"nothing comes on {link.keys.preview}",
        "start on the robot, beside its stages: zloam preview --config ROBOT.yaml; with containers "
        "the layer deploy/compose/preview.yml",
    )


def silence(link: Link) -> str | None:
    """The same as one line."""
    found = finding(link)
    return f"{found.what}: {found.do}" if found is not None else None


def heard(link: Link, before: dict[tuple[str, str], StatusRecord], seconds: float) -> Heard:
    """The doctor's input from statuses alone, as a thin view sends no queries."""
    now = time.monotonic()
    silent_s = {who: link.silent_s(status, now) for who, status in link.statuses.items()}
    living = {who for who, silent in silent_s.items() if silent <= STALE_SECONDS}
    after = dict(link.statuses)
    robot, late_s = link.keys.robot, link.late.seconds(living)
    return Heard(
        robot, seconds, before, after, silent_s, living, [], {}, link.garbage, late_s=late_s
    )
