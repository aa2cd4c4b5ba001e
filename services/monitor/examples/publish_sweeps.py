"""Publishes sweeps of a lidar that the driver does not support; replace revolution() by yours.
PYTHONPATH=build/release/generated/python python publish_sweeps.py ENDPOINT ROBOT SENSOR COUNT"""

import sys
import time
from typing import Any

import flatbuffers
import numpy as np
import zenoh
from zloam.msg import Header, Sweep

RINGS, COLUMNS, PERIOD_NS = 16, 900, 100_000_000
KIND = "application/x-flatbuffers;schema=sweep;major=1"
#: In m, and ns after the sweep's stamp; ring 0 is the lowest (byte 22 is the return type).
POINT = np.dtype([("xyz", "<f4", 3), ("intensity", "<f4"), ("time_ns", "<u4"), ("ring", "<u4")])


def revolution(number: int) -> Any:
    """Points in time order, from a sensor that drives at 0.3 m/s through a room of 12 x 9 x 4 m."""
    points = np.zeros(RINGS * COLUMNS, POINT)
    turned, points["ring"] = np.divmod(np.arange(len(points)), RINGS) / np.array([[COLUMNS], [1]])
    points["time_ns"] = turned * PERIOD_NS
    azimuth, elevation = -2 * np.pi * (turned + 1e-6), np.radians(2.0 * points["ring"] - 15.0)
    way = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=1)
    from_m = np.outer((number + turned) * PERIOD_NS * 1e-9, [0.3, 0.0, 0.0])
    points["xyz"] = way * ((np.sign(way) * [6, 4.5, 2] - from_m) / way).min(axis=1)[:, None]
    return points


def message(robot: str, sensor: str, run: int, number: int, points: Any) -> bytes:
    b = flatbuffers.Builder(points.nbytes + 1024)
    names = [b.CreateString(text) for text in (robot, sensor, "lidar", "my-driver")]
    b.StartVector(POINT.itemsize, len(points), 4)
    b.head -= points.nbytes
    b.Bytes[b.head : b.head + points.nbytes] = points.tobytes()
    points_at = b.EndVector()
    Header.Start(b)
    Header.AddRobot(b, names[0]), Header.AddSensor(b, names[1]), Header.AddFrame(b, names[2])
    Header.AddInstance(b, names[3]), Header.AddRun(b, run), Header.AddSweep(b, number)
    Header.AddStampNs(b, run + number * PERIOD_NS), Header.AddSeq(b, number)
    header = Header.End(b)
    Sweep.Start(b)
    Sweep.AddHeader(b, header), Sweep.AddPoints(b, points_at), Sweep.AddRings(b, RINGS)
    Sweep.AddPeriodNs(b, PERIOD_NS), Sweep.AddComplete(b, True)
    b.Finish(Sweep.End(b), file_identifier=b"ZLSW")
    return bytes(b.Output())


endpoint, robot, sensor, count = sys.argv[1:5]
# No scouting: a program that scouts would link all robots that it hears on the network.
links = f'{{connect: {{endpoints: ["{endpoint}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
with zenoh.open(zenoh.Config.from_json5(links)) as session:
    publisher: Any = session.declare_publisher(f"loam/{robot}/lidar/{sensor}/sweep", encoding=KIND)
    while not publisher.matching_status.matching:
        time.sleep(0.1)  # Until registration subscribes.
    run = time.time_ns()  # Identifies this start, and is the stamp of its first sweep.
    for number in range(int(count)):
        time.sleep(max(0.0, (run + (number + 1) * PERIOD_NS - time.time_ns()) * 1e-9))
        publisher.put(message(robot, sensor, run, number, revolution(number)))
    time.sleep(1.0)  # Lets the last messages leave.
