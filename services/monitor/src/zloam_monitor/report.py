"""Builds report.json, and the table at the end of a run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from zloam_monitor import evaluation, latency, pose_health
from zloam_monitor.accounting import Accounts, account
from zloam_monitor.evaluation import Scores
from zloam_monitor.files import written_whole
from zloam_monitor.keys import Keys
from zloam_monitor.link import Link
from zloam_monitor.records import DROPPED, PoseRecord, StatusRecord
from zloam_monitor.settings import changes
from zloam_monitor.stages import STAGES
from zloam_monitor.trajectory import Trajectory

#: Exit code if a file could not be written.
FILE_CODE = 3
#: Kind of trajectory in the report -> its name in the table.
KINDS = {"pose": "pose", "odometry": "odometry", "world": "pose with loops closed"}
#: What table and page say if the counts and the poses are not of the same runs.
SEVERAL_RUNS = (
    "the driver began again: the counts are of all its runs, health and latency of the last one"
)
#: Names of errors, both in the report and in Scores.
SCORE_NAMES = ("ate_rmse_m", "drift_percent", "rpe_1m_m")


@dataclass(frozen=True)
class Run:
    """All that was received of one run."""

    keys: Keys
    statuses: dict[str, StatusRecord]
    poses: Mapping[int, PoseRecord]
    mapped: Mapping[int, PoseRecord]
    trajectory: Trajectory
    odometry: Trajectory
    wall_s: float
    #: Name of the reference -> truth of base_link.
    truths: dict[str, Trajectory] = field(default_factory=dict)
    #: Texts about references that can't be used.
    no_reference: list[str] = field(default_factory=list)
    exit_codes: dict[str, int] = field(default_factory=dict)
    #: Changes during the run, as texts for --set-at.
    set_at: list[str] = field(default_factory=list)
    #: Changes that the run ended before, in the same form.
    set_too_late: list[str] = field(default_factory=list)
    #: Remarks of the stages, each cause once.
    remarks: list[str] = field(default_factory=list)
    #: MiB of each stage that still ran at the end.
    pss_mib: dict[str, float] = field(default_factory=dict)
    #: Texts about what its recording lacks.
    not_recorded: list[str] = field(default_factory=list)
    #: Trajectory after pose-graph optimization, if there was a graph.
    world: Trajectory | None = None
    #: Last status of the graph, if there was one.
    graph: StatusRecord | None = None

    @classmethod
    def heard(
        cls,
        link: Link,
        wall_s: float,
        exit_codes: dict[str, int] | None = None,
        truths: dict[str, Trajectory] | None = None,
        pss_mib: dict[str, float] | None = None,
    ) -> Run:
        """The run as a link has received it until now."""
        in_force, late = changes(link.revisions, link.run, max(link.poses, default=0))
        return cls(
            keys=link.keys,
            statuses=link.newest_statuses(),
            poses=link.poses,
            mapped=link.mapped,
            trajectory=link.trajectory(),
            odometry=link.odometry_trajectory(),
            wall_s=wall_s,
            truths=truths or {},
            exit_codes=exit_codes or {},
            set_at=in_force,
            set_too_late=late,
            pss_mib=pss_mib or {},
            graph=link.stage("graph"),
        )


def _worst(scores: list[Scores], name: str) -> float | None:
    """The largest error against any of several references."""
    values = [getattr(s, name) for s in scores]
    known = [float(v) for v in values if v is not None]
    return max(known) if known else None


def _data_seconds(poses: Trajectory) -> float:
    stamps = poses.stamps_ns
    if stamps is None or len(stamps) < 2:
        return 0.0
    # The first sweep is taken to be as long as the mean of the others.
    return float(stamps[-1] - stamps[0]) * 1e-9 * len(stamps) / (len(stamps) - 1)


def _went_back(poses: Mapping[int, PoseRecord]) -> list[int]:
    """Sweeps whose instant is not later than those of all sweeps before."""
    latest, found = None, []
    for sweep in sorted(poses):
        instant_ns = poses[sweep].instant_ns
        if latest is not None and instant_ns <= latest:
            found.append(sweep)
        else:
            latest = instant_ns
    return found


def _without(trajectory: Trajectory, sweeps: list[int]) -> Trajectory:
    """The trajectory without these sweeps."""
    kept = ~np.isin(trajectory.sweeps, sweeps)
    stamps = trajectory.stamps_ns
    return Trajectory(
        trajectory.transforms[kept],
        None if stamps is None else stamps[kept],
        trajectory.sweeps[kept],
    )


def _of_stamps(went_back: list[int]) -> list[str]:
    if not went_back:
        return []
    return [f"{len(went_back)} stamps are not after those before, first of sweep {went_back[0]}"]


def accounts_of(run: Run) -> Accounts:
    """The message accounts of the run."""
    dropped = sum(1 for pose in run.poses.values() if pose.health == DROPPED)
    return account(run.statuses, run.keys, len(run.trajectory), dropped)


def _loops(run: Run) -> dict[str, int] | None:
    """Results of the pose graph; None without one."""
    if run.graph is None:
        return None
    return {name: int(run.graph.figures.get(name, 0)) for name in ("submaps", "loops", "revision")}


def build(run: Run) -> dict[str, Any]:
    """The report as described in the README; null for unknown figures."""
    accounts = accounts_of(run)
    scores = {
        "pose": {name: evaluation.evaluate(run.trajectory, t) for name, t in run.truths.items()},
        "odometry": {name: evaluation.evaluate(run.odometry, t) for name, t in run.truths.items()},
    }
    if run.world is not None:
        scores["world"] = {n: evaluation.evaluate(run.world, t) for n, t in run.truths.items()}
    whole, work = latency.by_stage(run.poses.values(), run.mapped.values())
    end_to_end = latency.from_last_packet(run.poses.values(), "integration")
    mapped_pose = latency.from_last_packet(run.mapped.values(), "mapping")
    went_back = _went_back(run.poses)
    poses = _without(run.trajectory, went_back)
    seconds = _data_seconds(poses)
    known = [stage for stage in STAGES if stage in run.statuses]
    sweeps = {stage: max(accounts.sweeps_of(stage), 1) for stage in known}
    report: dict[str, Any] = {
        "sweeps": {
            stage: {
                "in": s.came_in,
                "out": s.went_out,
                "dropped": s.dropped,
                "lost": s.lost,
                "recovered": s.recovered,
            }
            for stage, s in accounts.stages.items()
        },
        "identities": {
            "inputs_balanced": accounts.inputs_balanced,
            "sweeps_accounted": accounts.sweeps_accounted,
            "several_runs": accounts.several_runs,
            "sweeps": accounts.sweeps,
            "poses": accounts.poses,
            "given_up": accounts.given_up,
            "complaints": [*accounts.complaints(), *_of_stamps(went_back)],
        },
        "latency_ms": {**whole, "end_to_end": end_to_end, "mapped_pose": mapped_pose},
        "work_ms": work,
        "cpu_ms_per_sweep": {stage: run.statuses[stage].cpu_ms / sweeps[stage] for stage in known},
        "rss_mib": {stage: run.statuses[stage].rss_mib for stage in known},
        "pss_mib": run.pss_mib,
        "bytes": {stage: run.statuses[stage].memory for stage in known},
        "bytes_per_sweep": {
            stage: {
                name.removeprefix("bytes_"): count / sweeps[stage]
                for name, count in run.statuses[stage].memory.items()
                if name.startswith("bytes_")
            }
            for stage in known
        },
        "wall_s": run.wall_s,
        "realtime_factor": seconds / run.wall_s if run.wall_s > 0 and seconds > 0 else None,
        "path_m": poses.path_length_m(),
        "stamps_went_back": went_back,
        "health": pose_health.judge(run.poses.values()).as_dict(),
        "exit_codes": run.exit_codes,
        "loops": _loops(run),
        "set_at": run.set_at,
        "set_too_late": run.set_too_late,
        "remarks": run.remarks,
        "references": {
            name: {kind: scores[kind][name].as_dict() for kind in scores} for name in run.truths
        },
        "no_reference": run.no_reference,
    }
    for name in SCORE_NAMES:
        report[name] = {kind: _worst(list(each.values()), name) for kind, each in scores.items()}
    return report


def exit_code(report: dict[str, Any]) -> int:
    """3 if a file is missing, as the stages do; 1 if anything else is wrong."""
    if report.get("not_written") or FILE_CODE in report["exit_codes"].values():
        return FILE_CODE
    return 0 if accounted(report) else 1


def accounted(report: dict[str, Any]) -> bool:
    """True if all accounts balance and every process ended with 0."""
    identities = report["identities"]
    return (
        identities["inputs_balanced"]
        and identities["sweeps_accounted"]
        and not report.get("stamps_went_back")
        and not report.get("not_written")
        and all(code == 0 for code in report["exit_codes"].values())
    )


def write(path: Path, report: dict[str, Any]) -> None:
    with written_whole(path) as out:
        json.dump(report, out, indent=2)
        out.write("\n")


def number_text(value: float | None, digits: int = 1) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _grid(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        row[0].ljust(widths[0])
        + "".join("  " + cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
        for row in rows
    ]


def stage_rows(report: dict[str, Any]) -> list[list[str]]:
    """Rows of a table: a head, and one row per stage."""
    rows = [["stage", "in", "out", "dropped", "p50 ms", "p99 ms", "CPU ms/sweep", "RSS MiB (peak)"]]
    for stage, sweeps in report["sweeps"].items():
        took = report["work_ms"].get(stage) or {}
        drops = ", ".join(f"{n} {reason}" for reason, n in sweeps["dropped"].items()) or "0"
        rss = report["rss_mib"][stage]
        rows.append(
            [
                stage,
                str(sweeps["in"]),
                str(sweeps["out"]),
                drops,
                number_text(took.get("p50")),
                number_text(took.get("p99")),
                number_text(report["cpu_ms_per_sweep"][stage]),
                f"{rss['end']:.0f} ({rss['peak']:.0f})",
            ]
        )
    return rows


def scores_of(report: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """(trajectory and reference, its errors) for each of both."""
    return [
        (f"{words} against {name}", each[kind])
        for name, each in report["references"].items()
        for kind, words in KINDS.items()
        if each.get(kind) is not None
    ]


def without_error(report: dict[str, Any]) -> list[str]:
    """Texts that say why errors are missing."""
    lacking: list[str] = report.get("no_reference", [])
    if lacking or report["references"]:
        return lacking
    return ["no truth was given: no error can be stated"]


#: Says what the times of stage_rows() are.
WORK_TIMES = "p50, p99: from the beginning of a stage's work on a sweep to its result"


def latency_line(report: dict[str, Any]) -> str:
    """A sentence about the latency."""
    parts = []
    for name, words in (("end_to_end", "fused pose"), ("mapped_pose", "mapped pose")):
        found = report["latency_ms"][name]
        if found:
            parts.append(f"its {words}: p50 {found['p50']:.0f} ms, p99 {found['p99']:.0f} ms")
    if not parts:
        return "latency: not measured, as packets of a replay at full pace have no time of arrival"
    return "latency, from the arrival of a sweep's last packet to " + "; to ".join(parts)


def table(report: dict[str, Any]) -> str:
    """Text for a person at the end of a run."""
    lines = [*_grid(stage_rows(report)), WORK_TIMES, ""]
    for words, s in scores_of(report):
        lines.append(
            f"{words}: ATE {number_text(s['ate_rmse_m'], 3)} m, "
            f"drift {number_text(s['drift_percent'], 3)} %, "
            f"RPE over 1 m {number_text(s['rpe_1m_m'], 3)} m ({s['matched']} poses)"
            + (f"; {s['remark']}" if s["remark"] else "")
        )
    lines += without_error(report)
    if loops := report.get("loops"):
        lines.append(f"{loops['loops']} loops in force between {loops['submaps']} submaps")
    lines.append(latency_line(report))
    lines.append(summary_line(report))
    lines.append(pose_health.line(report["health"]))
    if report.get("remarks"):
        lines += ["said by the stages:", *(f"  {each}" for each in report["remarks"])]
    if late := report.get("set_too_late"):
        lines.append("the run ended before these changes: " + ", ".join(late))
    if earlier := report.get("earlier_runs"):
        lines.append("files of earlier runs: " + ", ".join(earlier))
    wrong = complaints(report)
    lines.append("accounted for: " + ("yes" if not wrong else "NO: " + "; ".join(wrong)))
    return "\n".join(lines)


def summary_line(report: dict[str, Any]) -> str:
    """A line about amount and speed."""
    factor = report["realtime_factor"]
    return (
        f"{report['identities']['sweeps']} sweeps, {report['identities']['poses']} poses, "
        f"path {report['path_m']:.1f} m, {report['wall_s']:.1f} s"
        + (f", {factor:.1f} × real time" if factor else "")
        + (f"; {SEVERAL_RUNS}" if report["identities"].get("several_runs") else "")
    )


def complaints(report: dict[str, Any]) -> list[str]:
    """Texts about all that is wrong; empty if everything is accounted for."""
    return [
        *report["identities"]["complaints"],
        *(f"not written: {each}" for each in report.get("not_written", [])),
        *(f"{stage} ended with {code}" for stage, code in report["exit_codes"].items() if code),
    ]
