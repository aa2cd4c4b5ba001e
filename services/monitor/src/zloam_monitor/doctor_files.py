"""Finds out what is wrong with a recording: with a capture by the decoder's summary, with a file
of `zloam record` by the stages' statuses in it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from zloam_monitor import messages, recordings, records
from zloam_monitor.chain import binary
from zloam_monitor.doctor import findings_of_poses, findings_of_statuses
from zloam_monitor.doctor_sensor import PACKETS, of_losses
from zloam_monitor.heard import Finding, Heard
from zloam_monitor.kept_poses import PackedPoses
from zloam_monitor.recordings import robot_log
from zloam_monitor.recordings.robot_log import CONFIG, Logged, RobotLog
from zloam_monitor.records import StatusRecord
from zloam_monitor.remarks import Remarks, reasons
from zloam_monitor.sources import SourceError
from zloam_monitor.watch import STALE_SECONDS

STATUS, POSE = "zloam.msg.Status", "zloam.msg.MapPose"


def of_file(build: Path, file: Path, model: str | None, metadata: Path | None) -> list[Finding]:
    """Findings for a capture or file of `zloam record`; raises SourceError if it can't be read."""
    if robot_log.is_one(file):
        return of_recording(file)
    if robot_log.is_mcap(file):
        raise SourceError(
            f"{file}: zloam record did not write it; what is in a bag, zloam demo --bag {file} says"
        )
    return _of_capture(build, file, model, metadata)


class _Said:
    """Statuses, poses and configurations of a recording, in their order."""

    def __init__(self, log: RobotLog) -> None:
        self.before: dict[tuple[str, str], StatusRecord] = {}
        self.after: dict[tuple[str, str], StatusRecord] = {}
        self.last_ns: dict[tuple[str, str], int] = {}
        #: Packed, as a recording may take days.
        self.poses, self.mapped = PackedPoses(), PackedPoses()
        self.configs: dict[str, dict[str, Any]] = {}
        self.garbage = 0
        #: Troubles that stages reported.
        self.troubles = Remarks()
        for logged in log.messages((STATUS, POSE, CONFIG)):
            try:
                self._take(logged)
            except messages.DECODE_ERRORS:
                self.garbage += 1

    def _take(self, logged: Logged) -> None:
        if logged.schema == STATUS:
            self._status(records.status(logged.payload), logged.log_ns)
        elif logged.schema == CONFIG:
            stage, values = records.effective_config(logged.payload)
            self.configs[stage] = values
        elif logged.topic.endswith(("/pose", "/map/odometry")):
            to = self.poses if logged.topic.endswith("/pose") else self.mapped
            to.append(replace(records.map_pose(logged.payload), covariance=()))

    def _status(self, status: StatusRecord, log_ns: int) -> None:
        who = status.stage, status.instance
        self.before.setdefault(who, status)
        self.after[who] = status
        self.last_ns[who] = log_ns
        self.troubles.news(reasons([status]), 1e-9 * log_ns)

    def health(self, _heard: Heard) -> Iterator[Finding]:
        """Findings over the whole recording, not only its end. One status stands for a second."""
        for text, times in self.troubles.counted():
            stage, _, reason = text.partition(": ")
            yield Finding(
                f"{stage} was not well for {times} s: {reason}", "see what it says of itself"
            )


def of_recording(file: Path) -> list[Finding]:
    """Findings from all that the robot's stages published while it was recorded."""
    log = RobotLog(file)
    try:
        extent = log.extent()
    except recordings.Refused as refused:
        raise SourceError(f"{file}: {refused}") from refused
    said = _Said(log)
    about = log.about or {}
    # A stage that reported that it is stopping does not count as silent.
    silent_s = {
        who: 0.0 if said.after[who].health == "stopping" else 1e-9 * (extent.end_ns - at_ns)
        for who, at_ns in said.last_ns.items()
    }
    living = {who for who, silent in silent_s.items() if silent <= STALE_SECONDS}
    heard = Heard(
        about.get("robot", ""),
        extent.seconds,
        said.before,
        said.after,
        silent_s,
        living,
        said.poses,
        said.configs,
        said.garbage,
        said.mapped,
    )
    found = [*findings_of_statuses(heard, said.health), *findings_of_poses(heard)]
    return [
        *(Finding(remark, "record it again, if that matters") for remark in log.remarks),
        *found,
    ]


def _of_capture(build: Path, file: Path, model: str | None, metadata: Path | None) -> list[Finding]:
    command = [
        str(binary(build, "decode")),
        "--bin" if file.suffix == ".bin" else "--pcap",
        str(file),
    ]
    command += ["--model", model] if model else []
    command += ["--metadata", str(metadata)] if metadata else []
    done = subprocess.run(
        command, capture_output=True, text=True, errors="backslashreplace", check=False
    )
    said = [line.removeprefix("zloam-decode: ") for line in done.stderr.splitlines()]
    if done.returncode != 0:
        raise SourceError("; ".join(said) or f"{file}: cannot be read")
    return of_counts(json.loads(done.stdout), said)


def of_counts(counts: dict[str, float], remarks: list[str]) -> list[Finding]:
    """Findings from the decoder's summary."""
    found = [Finding(remark, "see services/driver/README.md") for remark in remarks]
    received, lost = counts.get("packets_received", 0), counts.get("packets_lost", 0)
    if not received:
        return [
            *found,
            Finding(
                "no packet of a lidar is in it",
                "was it recorded on the sensor's network, by the sensor's port (driver.port)?",
            ),
        ]
    if not counts.get("points"):
        found.append(Finding("no packet of it could be decoded", "the other findings say why"))
    found += of_losses(
        received,
        lost,
        f"{lost:.0f} of {received + lost:.0f} packets are missing",
        "record on a machine that keeps up (tcpdump -B 8192), on the sensor's own card",
    )
    if counts.get("points") and counts.get("sweeps", 0) > 4 and not counts.get("complete"):
        found.append(
            Finding("no revolution in it is complete", "the model or the sensor's view is another")
        )
    for name, (what, do) in PACKETS.items():
        if counts.get(name):
            found.append(Finding(f"{what} ({counts[name]:.0f})", do))
    return found
