"""What Foxglove is shown, from the state of one robot."""

from __future__ import annotations

import numpy as np

from zloam_monitor import messages
from zloam_monitor.clouds import Tile
from zloam_monitor.foxglove_scene import Scene
from zloam_monitor.keys import Keys
from zloam_monitor.records import HEALTH, PoseRecord


def pose(run: int) -> PoseRecord:
    unit = np.array([0.0, 0.0, 0.0, 1.0])
    return PoseRecord(run, 0, 1, np.zeros(3), unit, HEALTH.index("ok"), 0, False, ())


def topics(scene: Scene) -> list[str]:
    return [each.topic for each in scene.whole(1)]


def test_tiles_from_before_the_first_pose_are_of_its_run() -> None:
    scene = Scene(Keys("r"), 0.0, np.eye(4))
    scene.keep(Tile("plane", (0, 0, 0), 1, np.zeros(5, messages.MAP_POINT)))
    list(scene._pose(pose(run=7)))
    assert topics(scene) == ["/map"]
    list(scene._pose(pose(run=8)))
    assert topics(scene) == []
