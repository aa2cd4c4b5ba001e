"""The `active` tokens, by which instances of a stage say that they work or could work
(docs/protocol.md, section 6)."""

from __future__ import annotations

import re
from dataclasses import dataclass

from zloam_monitor.records import StatusRecord
from zloam_monitor.stages import ROWS


@dataclass(frozen=True, order=True)
class Claim:
    """What the token of an instance says."""

    stage: str
    instance: str
    term: int
    since_ns: int

    def is_of(self, status: StatusRecord) -> bool:
        """True if the instance that published the status declared it."""
        return (self.stage, self.instance, self.since_ns) == (
            status.stage,
            status.instance,
            status.started_ns,
        )


_CLAIM = re.compile(r"/service/(?P<stage>[^/]+)/(?P<instance>[^/]+)/active/(\d+)/(-?\d+)$")


def claim_of(key: str) -> Claim | None:
    """None: not the token of a stage that has a single working instance."""
    found = _CLAIM.search(key)
    if found is None or found["stage"] not in ROWS or ROWS[found["stage"]].replicas:
        return None
    return Claim(found["stage"], found["instance"], int(found[3]), int(found[4]))
