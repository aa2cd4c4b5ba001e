"""Prints the pose of a robot. Needs eclipse-zenoh, flatbuffers and the generated code:
PYTHONPATH=build/release/generated/python python subscribe.py [ENDPOINT [ROBOT [COUNT]]]"""

import json
import sys

import zenoh
from zloam.msg.MapPose import MapPose
from zloam.msg.Vec3 import Vec3

given = dict(enumerate(sys.argv))
# Default endpoints on this machine: the stages (make run, make demo), or the containers' router.
here = ["tcp/127.0.0.1:7464", "tcp/127.0.0.1:7447"]
config = zenoh.Config()
config.insert_json5("connect/endpoints", json.dumps([given[1]] if 1 in given else here))
# No scouting: a program that scouts would link all robots that it hears on the network.
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    poses = session.declare_subscriber(f"loam/{given.get(2, 'robot')}/pose")
    for seen, sample in enumerate(poses, start=1):
        pose = MapPose.GetRootAs(sample.payload.to_bytes())
        p = pose.PoseMapBase().Translation(Vec3())
        x, y, z = (f"{metres:.3f}" for metres in (p.X(), p.Y(), p.Z()))
        print(pose.Header().Sweep(), pose.InstantNs(), x, y, z, flush=True)
        if seen == int(given.get(3, 0)):
            break
