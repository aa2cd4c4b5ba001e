"""Both identities of protocols.md section 2, checked from statuses and poses."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from zloam_monitor.keys import POSE_PATH, STAGES, Keys
from zloam_monitor.records import StatusRecord

#: second copies and strangers are no sweeps that went missing
NO_SWEEP_GIVEN_UP = ("duplicate", "fenced", "wrong_run", "garbage")


@dataclass(frozen=True)
class StageSweeps:
    """What one stage did with the sweeps of a run."""

    came_in: int
    went_out: int
    dropped: dict[str, int]
    lost: int = 0
    recovered: int = 0


@dataclass(frozen=True)
class Accounts:
    """The run's books."""

    stages: dict[str, StageSweeps]
    sweeps: int
    poses: int
    #: sweeps without a pose, by stage and reason
    given_up: dict[str, int]
    unbalanced: list[str] = field(default_factory=list)
    without_status: list[str] = field(default_factory=list)

    @property
    def inputs_balanced(self) -> bool:
        """received = processed + not_mine + queued + in_work + sum of dropped, at every input."""
        return not self.unbalanced and not self.without_status

    @property
    def sweeps_accounted(self) -> bool:
        """last sweep + 1 = poses + sweeps without a pose, each with its reason."""
        return self.sweeps > 0 and self.sweeps == self.poses + sum(self.given_up.values())

    def complaints(self) -> list[str]:
        """What does not add up, in words."""
        found = [f"no status of {stage}" for stage in self.without_status]
        found += [f"the account of {key} does not balance" for key in self.unbalanced]
        if self.sweeps == 0:
            found.append("no sweep came: there is nothing to account for")
        elif not self.sweeps_accounted:
            found.append(
                f"{self.sweeps} sweeps, but {self.poses} poses and "
                f"{sum(self.given_up.values())} given up"
            )
        return found


def _stage_sweeps(stage: str, status: StatusRecord, keys: Keys) -> StageSweeps:
    out = status.published.get(keys.main_output(stage), 0)
    name = keys.main_input(stage)
    account = status.input(name) if name else None
    if account is None:  # the driver: what it cut out of packets
        came_in = status.last_sweep + 1 if status.last_sweep is not None else 0
        drops: Counter[str] = Counter()
        for each in status.inputs:
            drops.update(each.dropped)
        return StageSweeps(max(came_in, out), out, _nonzero(drops))
    came_in = account.received - account.dropped.get("duplicate", 0)
    return StageSweeps(
        came_in, out, _nonzero(Counter(account.dropped)), account.lost, account.recovered
    )


def _nonzero(counts: Counter[str]) -> dict[str, int]:
    return {reason: n for reason, n in sorted(counts.items()) if n}


def _given_up(
    stages: dict[str, StageSweeps], sweeps: int, predicted_for_dropped: int
) -> dict[str, int]:
    found: Counter[str] = Counter()
    for stage in POSE_PATH:
        if stage not in stages:
            continue
        for reason, count in stages[stage].dropped.items():
            if reason not in NO_SWEEP_GIVEN_UP:
                found[f"{stage}.{reason}"] += count
        if stages[stage].lost:
            found[f"{stage}.lost"] += stages[stage].lost
    # a sweep that registration gave up still has a predicted pose, marked `dropped`
    if predicted_for_dropped and found:
        largest = max(found, key=lambda name: found[name])
        found[largest] -= min(predicted_for_dropped, found[largest])
    return _nonzero(found)


def account(
    statuses: dict[str, StatusRecord], keys: Keys, poses: int, predicted_for_dropped: int = 0
) -> Accounts:
    """From the last status of each stage and the number of different sweeps with a pose."""
    stages = {s: _stage_sweeps(s, statuses[s], keys) for s in STAGES if s in statuses}
    sweeps = stages["driver"].came_in if "driver" in stages else 0
    unbalanced = [
        f"{stage} {each.key}"
        for stage, status in statuses.items()
        for each in status.inputs
        if not each.balanced()
    ]
    return Accounts(
        stages,
        sweeps,
        poses,
        _given_up(stages, sweeps, predicted_for_dropped),
        unbalanced,
        [s for s in STAGES if s not in statuses],
    )
