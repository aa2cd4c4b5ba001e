"""Each remark of the stages is shown once, regardless of numbers, and summarized by cause."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

from zloam_monitor.records import StatusRecord
from zloam_monitor.remarks import AWAY_SECONDS, Logs, Remarks, reasons


def test_numbers_that_change_are_no_news() -> None:
    remarks = Remarks()
    shown = []
    for second in range(60):
        dropped = f"odometry: overload: {second + 3} sweeps dropped in a second"
        quiet = f"driver: no packets on UDP 2368 for {second}.5 s"
        shown += remarks.news([dropped, quiet], float(second))
    assert shown == [
        "odometry: overload: 3 sweeps dropped in a second",
        "driver: no packets on UDP 2368 for 0.5 s",
    ]
    assert remarks.summary()[0] == f"{shown[0]} (said 60 times)"


def test_what_several_stages_say_is_one_line() -> None:
    remarks = Remarks()
    room = "no room for shared memory: 64 MiB"
    said = [f"driver: {room}", "no packets", f"mapping: {room}", "mapping: slow"]
    assert remarks.news(said, 0.0) == [f"driver, mapping: {room}", "no packets", "mapping: slow"]
    # Only the stage that joins in is news.
    assert remarks.news([*said, f"odometry: {room}"], 1.0) == [f"odometry: {room}"]
    assert remarks.summary() == [
        f"driver, mapping, odometry: {room} (said 2 times)",
        "no packets (said 2 times)",
        "mapping: slow (said 2 times)",
    ]


def test_a_reason_with_semicolons_is_one_remark() -> None:
    """Only a topic begins another one."""
    quiet = (
        "packets: no packets on UDP 2368 for 3 s: is the sensor on; does a firewall drop them; is "
        "it a model that is decoded here? Seen so far: packets_received 0; 7 datagrams came to UDP "
        "ports that no program listens on: if the sensor's are among them, driver.port is another"
    )
    imu = "imu file: a.csv: 3 readings were left out"
    silent = "silent loam/robot/lidar/lidar/sweep: no loam/robot/lidar/lidar/sweep for 3 s"
    status = cast(
        StatusRecord,
        SimpleNamespace(stage="driver", health="degraded", reason="; ".join([imu, quiet, silent])),
    )
    assert reasons([status]) == [f"driver: {imu}", f"driver: {quiet}", f"driver: {silent}"]
    assert reasons([cast(StatusRecord, SimpleNamespace(health="degraded", reason=""))]) == []


def test_what_status_and_log_say_is_one_remark() -> None:
    """The status has the topic before it."""
    remarks = Remarks()
    in_status, in_log = (
        "driver: packets: no packets for 3 s: see it",
        "driver: no packets for 3 s: see it",
    )
    assert remarks.news([in_status, in_log], 0.0) == [in_status]
    assert remarks.news([in_log], 1.0) == []
    assert len(remarks.summary()) == 1
    assert len(remarks.news(["mapping: no packets for 3 s: see it"], 2.0)) == 1


def test_what_comes_again_after_a_while_is_news() -> None:
    remarks = Remarks()
    assert remarks.news(["driver: no packets for 3 s"], 0.0)
    assert not remarks.news(["driver: no packets for 9 s"], AWAY_SECONDS)
    assert remarks.news(["driver: no packets for 3 s"], 3 * AWAY_SECONDS)


def test_warnings_of_logs_line_by_line(tmp_path: Path) -> None:
    stamp = "2026-11-25T10:00:00.123456Z"
    earlier = tmp_path / "mapping-standby.log"
    earlier.write_text(f"{stamp} warning mapping: the disk is full\n")
    log, logs = tmp_path / "driver.log", Logs(tmp_path)
    assert logs.new_warnings() == []
    log.write_text(f"{stamp} info    driver: ready\n{stamp} warning driver: the product byte lies")
    assert logs.new_warnings() == []  # The line is not complete yet.
    with log.open("a") as more:
        more.write(f' model="VLP-16"\nnot a line of ours\n{stamp} error   driver: gone\n')
    assert logs.new_warnings() == [
        'driver: the product byte lies model="VLP-16"',
        "driver: gone",
    ]
    assert logs.new_warnings() == []
    with earlier.open("a") as more:
        more.write(f"{stamp} warning mapping: slow\n")
    assert logs.new_warnings() == ["mapping: slow"]
