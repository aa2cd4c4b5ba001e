"""Publishes angles of the motor that turns a scanner, read as lines "t_ns,angle_rad" from standard
input; replace that by your encoder. The stamps are of this host's clock.
PYTHONPATH=build/release/generated/python python publish_angles.py ENDPOINT ROBOT SENSOR"""

import sys
import time
from collections.abc import Iterable, Iterator
from typing import Any

import flatbuffers
import zenoh
from zloam.msg import AngleReading, Header, MotorAngles

KIND = "application/x-flatbuffers;schema=angle;major=1"
#: Readings are published in batches of this duration.
BATCH_NS = 20_000_000


def message(robot: str, sensor: str, seq: int, readings: list[tuple[int, float]]) -> bytes:
    b = flatbuffers.Builder(1024)
    names = [b.CreateString(text) for text in (robot, sensor, "lidar", "my-motor")]
    b.StartVector(16, len(readings), 8)
    for stamp_ns, angle_rad in reversed(readings):
        AngleReading.CreateAngleReading(b, stamp_ns, angle_rad)
    angles = b.EndVector()
    Header.Start(b)
    Header.AddRobot(b, names[0]), Header.AddSensor(b, names[1]), Header.AddFrame(b, names[2])
    Header.AddInstance(b, names[3]), Header.AddStampNs(b, readings[0][0]), Header.AddSeq(b, seq)
    header = Header.End(b)
    MotorAngles.Start(b)
    MotorAngles.AddHeader(b, header), MotorAngles.AddReadings(b, angles)
    b.Finish(MotorAngles.End(b), file_identifier=b"ZLAN")
    return bytes(b.Output())


def batches(lines: Iterable[str]) -> Iterator[list[tuple[int, float]]]:
    """The readings of some lines at a time, each batch in ascending time."""
    waiting: list[tuple[int, float]] = []
    for line in lines:
        if line.startswith("t_ns"):  # the head of a table
            continue
        stamp, angle = line.split(",")
        reading = int(stamp), float(angle)
        # After the clock was set back, the stamps begin again.
        if waiting and reading[0] < waiting[-1][0]:
            yield waiting
            waiting = []
        waiting.append(reading)
        if reading[0] - waiting[0][0] >= BATCH_NS:
            yield waiting
            waiting = []
    if waiting:
        yield waiting


endpoint, robot, sensor = sys.argv[1:4]
# No scouting: a program that scouts would link all robots that it hears on the network.
links = f'{{connect: {{endpoints: ["{endpoint}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
with zenoh.open(zenoh.Config.from_json5(links)) as session:
    publisher: Any = session.declare_publisher(f"loam/{robot}/lidar/{sensor}/angle", encoding=KIND)
    for seq, readings in enumerate(batches(sys.stdin)):
        publisher.put(message(robot, sensor, seq, readings))
    time.sleep(0.5)  # Lets the last messages leave.
