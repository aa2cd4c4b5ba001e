"""Checks both identities of docs/protocol.md, section 2, from statuses and poses."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import pairwise

from zloam_monitor.keys import Keys
from zloam_monitor.records import StatusRecord
from zloam_monitor.stages import POSE_PATH, STAGES

#: Drop reasons that do not mean that a sweep went missing: second copies, and messages of other
#: runs or senders. A sweep whose only message was refused is counted as lost.
NO_SWEEP_GIVEN_UP = ("duplicate", "fenced", "wrong_run", "garbage", "invalid", "torn")


@dataclass(frozen=True)
class StageSweeps:
    """Counts of a run's sweeps at one stage."""

    came_in: int
    went_out: int
    dropped: dict[str, int]
    lost: int = 0
    recovered: int = 0
    #: Received, but still queued or in work when the run ended.
    unfinished: int = 0


@dataclass(frozen=True)
class Accounts:
    """The message accounts of a run."""

    stages: dict[str, StageSweeps]
    sweeps: int
    poses: int
    #: "stage.reason" -> number of sweeps without a pose.
    given_up: dict[str, int]
    unbalanced: list[str] = field(default_factory=list)
    without_status: list[str] = field(default_factory=list)
    #: The driver began again while the other stages went on counting: all counts, `sweeps` and
    #: `poses` too, are of more runs than the driver's last one.
    several_runs: bool = False

    def sweeps_of(self, stage: str) -> int:
        """Number of sweeps that the stage's other figures are of."""
        return self.stages[stage].came_in if stage == "driver" else self.sweeps

    @property
    def inputs_balanced(self) -> bool:
        """received = processed + not_mine + queued + in_work + sum of dropped, at every input."""
        return not self.unbalanced and not self.without_status

    @property
    def sweeps_accounted(self) -> bool:
        """last sweep + 1 = poses + sweeps without a pose, each with its reason."""
        return self.sweeps > 0 and self.sweeps == self.poses + sum(self.given_up.values())

    def complaints(self) -> list[str]:
        """The identities that do not hold, as texts."""
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
    if account is None:  # The driver: its input is packets, from which it cuts sweeps.
        came_in = status.last_sweep + 1 if status.last_sweep is not None else 0
        drops: Counter[str] = Counter()
        for each in status.inputs:
            drops.update(each.dropped)
        return StageSweeps(max(came_in, out), out, _nonzero(drops))
    came_in = account.received - account.dropped.get("duplicate", 0)
    return StageSweeps(
        came_in,
        out,
        _nonzero(Counter(account.dropped)),
        account.lost,
        account.recovered,
        account.queued + account.in_work,
    )


def _nonzero(counts: Counter[str]) -> dict[str, int]:
    return {reason: n for reason, n in sorted(counts.items()) if n}


def _reasons(sweeps: StageSweeps) -> Counter[str]:
    """Reasons why a stage may have given up sweeps, each with the greatest possible count."""
    found = Counter({r: n for r, n in sweeps.dropped.items() if r not in NO_SWEEP_GIVEN_UP})
    found["lost"] = sweeps.lost
    found["unfinished"] = sweeps.unfinished
    return found


def _vanished(stages: dict[str, StageSweeps], sweeps: int, poses: int) -> dict[str, int] | None:
    """Counts each sweep without a pose at the stage that it did not come out of. A sweep that
    registration gives up still leaves it, as an empty message, and may be lost further on, so that
    the drop counters would count it twice. None if a stage has counted since a later start than
    the others."""
    outs = [stages[stage].went_out for stage in POSE_PATH if stage in stages][:-1]
    steps = list(pairwise([sweeps, *outs, poses]))
    if len(outs) != len(POSE_PATH) - 1 or any(came < went for came, went in steps):
        return None
    found: dict[str, int] = {}
    # Sweeps that left registration as empty messages with the reason for the drop.
    told: Counter[tuple[str, str]] = Counter()
    for stage, (came, went) in zip(POSE_PATH, steps, strict=True):
        missing = came - went
        reasons = _reasons(stages[stage])
        # A stage does not notice messages that are missing after the last one that it received.
        reasons["lost"] = max(reasons["lost"], came - stages[stage].came_in)
        own = Counter({(stage, reason): most for reason, most in reasons.items()})
        for (at, reason), most in [*own.most_common(), *told.most_common()]:
            if given := max(0, min(missing, most)):
                found[f"{at}.{reason}"] = given
                missing -= given
                own[at, reason] -= given
        told = own if stage == "registration" else Counter()
    return dict(sorted(found.items()))


def _given_up(
    stages: dict[str, StageSweeps], sweeps: int, poses: int, predicted_for_dropped: int
) -> dict[str, int]:
    vanished = _vanished(stages, sweeps, poses)
    if vanished is not None:
        return vanished
    found: Counter[str] = Counter()
    for stage in POSE_PATH:
        if stage in stages:
            found.update({f"{stage}.{r}": n for r, n in _reasons(stages[stage]).items()})
    # A sweep that registration gave up still has a predicted pose, marked `dropped`.
    if predicted_for_dropped and found:
        largest = max(found, key=lambda name: found[name])
        found[largest] -= min(predicted_for_dropped, found[largest])
    return _nonzero(found)


def _counts_several_runs(stage: str, status: StatusRecord, keys: Keys) -> bool:
    """True if it has published more sweeps than there are in its own run, whose last it names. The
    driver's status may be older than the others': more sweeps than in that are no other run."""
    of_this_run = 0 if status.last_sweep is None else status.last_sweep + 1
    return status.published.get(keys.main_output(stage), 0) > of_this_run


def _of_all_runs(
    stages: dict[str, StageSweeps], statuses: dict[str, StatusRecord], keys: Keys
) -> StageSweeps | None:
    """The driver's sweeps in all runs that the other stages have counted, as its reader saw them;
    None if they have counted no more than the driver's last run."""
    if any(stage not in stages for stage in POSE_PATH):
        return None
    driver, *others = (stages[stage] for stage in POSE_PATH)
    if any(stage.went_out <= driver.came_in for stage in others):
        return None
    if not all(_counts_several_runs(each, statuses[each], keys) for each in POSE_PATH[1:]):
        return None
    # `came_in` has no second copies. What comes late was counted as lost before.
    foreign = {"late", *NO_SWEEP_GIVEN_UP} - {"duplicate"}
    all_sweeps = others[0].came_in + others[0].lost
    all_sweeps -= sum(n for reason, n in others[0].dropped.items() if reason in foreign)
    return replace(driver, came_in=all_sweeps, went_out=all_sweeps)


def account(
    statuses: dict[str, StatusRecord], keys: Keys, poses: int, predicted_for_dropped: int = 0
) -> Accounts:
    """Accounts from the last status of each stage and the number of distinct sweeps for which a
    pose was received."""
    stages = {s: _stage_sweeps(s, statuses[s], keys) for s in STAGES if s in statuses}
    driver = _of_all_runs(stages, statuses, keys)
    counted = stages if driver is None else {**stages, "driver": driver}
    sweeps = counted["driver"].came_in if "driver" in counted else 0
    published = stages["integration"].went_out if "integration" in stages else 0
    # A subscriber may miss some poses.
    if poses < published <= sweeps:
        poses = published
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
        _given_up(counted, sweeps, poses, predicted_for_dropped),
        unbalanced,
        [s for s in STAGES if s not in statuses],
        driver is not None,
    )
