"""The public keys of one robot (table in schemas/README.md)."""

from __future__ import annotations

from dataclasses import dataclass

from zloam_monitor.failures import Misuse
from zloam_monitor.stages import ROWS

#: Below the robot's key: the keys of all tiles begin with it.
TILES = "map/tile"


class KeyNameError(Misuse, ValueError):
    """A user's name of something can't be part of a key; the text says why."""


def name_error(text: str) -> str | None:
    """Why a name can't be part of a key; None: it can. The stages refuse the same names."""
    if not text:
        return "an empty name can't be part of a key"
    if text.startswith("@"):
        return f"'{text}' can't be part of a key: it starts with '@'"
    if any(c in "/*?#$\x7f" or c <= " " for c in text):
        return f"'{text}' can't be part of a key: no '/', '*', '?', '#', '$' or white space"
    return None


def topic_of(key: str) -> str:
    """The key, but one topic for all tiles, which have one publisher and an index in their key."""
    head, found, _ = key.partition(f"/{TILES}/")
    return f"{head}/{TILES}" if found else key


def _checked(what: str, name: str) -> str:
    if wrong := name_error(name):
        raise KeyNameError(f"name of the {what}: {wrong}")
    return name


@dataclass(frozen=True)
class Keys:
    """Key expressions below loam/<robot>/; raises KeyNameError."""

    robot: str
    sensor: str = "lidar"

    def __post_init__(self) -> None:
        _checked("robot", self.robot)
        _checked("sensor", self.sensor)

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
    def odometry_sweep(self) -> str:
        return self.below("odometry/sweep")

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
    def preview(self) -> str:
        return self.below("preview")

    @property
    def tiles(self) -> str:
        return self.below("map/tile/**")

    def tiles_of(self, layer: str) -> str:
        """Tiles of one layer; `*`: of every layer."""
        return self.below(f"map/tile/{layer}/**")

    def tile(self, layer: str, index: tuple[int, int, int]) -> str:
        return self.below("/".join([TILES, layer, *map(str, index)]))

    @property
    def submap(self) -> str:
        return self.below("map/submap")

    @property
    def graph_poses(self) -> str:
        return self.below("graph/poses")

    @property
    def graph_loop(self) -> str:
        return self.below("graph/loop")

    @property
    def path_world(self) -> str:
        return self.below("path/world")

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
    def every_active(self) -> str:
        return self.below("service/*/*/active/*/*")

    @property
    def every_revision(self) -> str:
        return self.below("config/*")

    def revision(self, stage: str) -> str:
        return self.below(f"config/{stage}")

    def command(self, stage: str, verb: str) -> str:
        return self.below(f"command/{_checked('stage', stage)}/{verb}")

    def takeover(self, stage: str, instance: str) -> str:
        return self.command(stage, f"takeover/{_checked('instance', instance)}")

    def ack(self, sink: str) -> str:
        return self.below(f"flow/{sink}/ack")

    def of(self, pattern: str) -> str:
        """The key for a pattern of services/stages.json."""
        return self.below(pattern.replace("<sensor>", self.sensor))

    def main_input(self, stage: str) -> str | None:
        """The key that brings a stage its sweeps; None: its input is packets."""
        row = ROWS.get(stage)
        return self.of(row.reads[0]) if row and row.reads else None

    def main_output(self, stage: str) -> str:
        """The key with one message for each sweep that leaves a stage; empty: it has no output."""
        writes = ROWS[stage].writes
        return self.of(writes[0]) if writes else ""
