"""The public keys of one robot (table in schemas/README.md)."""

from __future__ import annotations

from dataclasses import dataclass

STAGES = ("driver", "registration", "odometry", "mapping", "integration")
#: stages on the way of a pose; what mapping skips costs no pose
POSE_PATH = ("driver", "registration", "odometry", "integration")


@dataclass(frozen=True)
class Keys:
    """Key expressions below loam/<robot>/."""

    robot: str
    sensor: str = "lidar"

    def below(self, rest: str) -> str:
        return f"loam/{self.robot}/{rest}"

    @property
    def sweep(self) -> str:
        return self.below(f"lidar/{self.sensor}/sweep")

    @property
    def features(self) -> str:
        return self.below(f"lidar/{self.sensor}/features")

    @property
    def odometry(self) -> str:
        return self.below("odometry")

    @property
    def odometry_features(self) -> str:
        return self.below("odometry/features")

    @property
    def map_correction(self) -> str:
        return self.below("map/correction")

    @property
    def map_odometry(self) -> str:
        return self.below("map/odometry")

    @property
    def pose(self) -> str:
        return self.below("pose")

    @property
    def tiles(self) -> str:
        return self.below("map/tile/**")

    @property
    def path_map(self) -> str:
        return self.below("path/map")

    @property
    def path_odometry(self) -> str:
        return self.below("path/odometry")

    @property
    def every_status(self) -> str:
        return self.below("service/*/*/status")

    @property
    def every_config(self) -> str:
        return self.below("service/*/*/config")

    @property
    def every_alive(self) -> str:
        return self.below("service/*/*/alive")

    @property
    def every_revision(self) -> str:
        return self.below("config/*")

    def revision(self, stage: str) -> str:
        return self.below(f"config/{stage}")

    def command(self, stage: str, verb: str) -> str:
        return self.below(f"command/{stage}/{verb}")

    def ack(self, sink: str) -> str:
        return self.below(f"flow/{sink}/ack")

    def main_input(self, stage: str) -> str | None:
        """The key whose messages are the sweeps that come into a stage; None: packets."""
        return {
            "registration": self.sweep,
            "odometry": self.features,
            "mapping": self.odometry_features,
            "integration": self.odometry,
        }.get(stage)

    def main_output(self, stage: str) -> str:
        """The key with one message for each sweep that leaves a stage."""
        return {
            "driver": self.sweep,
            "registration": self.features,
            "odometry": self.odometry,
            "mapping": self.map_correction,
            "integration": self.pose,
        }[stage]
