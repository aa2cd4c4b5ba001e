"""Prints the pose of a robot. Needs eclipse-zenoh, flatbuffers and the generated code:
PYTHONPATH=build/release/generated/python python subscribe.py [ENDPOINT [ROBOT [COUNT]]]"""

import sys

import zenoh
from zloam.msg.MapPose import MapPose
from zloam.msg.Vec3 import Vec3

endpoint, robot, count = sys.argv[1:] + ["tcp/127.0.0.1:7464", "robot", "0"][len(sys.argv) - 1 :]
config = zenoh.Config()
config.insert_json5("connect/endpoints", f'["{endpoint}"]')
with zenoh.open(config) as session:
    poses = session.declare_subscriber(f"loam/{robot}/pose")
    for seen, sample in enumerate(poses, start=1):
        pose = MapPose.GetRootAs(sample.payload.to_bytes())
        p = pose.PoseMapBase().Translation(Vec3())
        print(pose.Header().Sweep(), pose.InstantNs(), p.X(), p.Y(), p.Z(), flush=True)
        if seen == int(count):
            break
