"""What Foxglove and Rerun are shown, from the state of one robot."""

from __future__ import annotations

import importlib
import math
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fake_session import needs_schemas
from zloam_monitor import compose, ending, foxglove_scene, messages, rerun_scene, rerun_view
from zloam_monitor.clouds import Tile
from zloam_monitor.foxglove_scene import Scene, Shown
from zloam_monitor.foxglove_server import Server
from zloam_monitor.intake import Sample
from zloam_monitor.keys import Keys
from zloam_monitor.records import HEALTH, SERVICE_HEALTH, PoseRecord
from zloam_monitor.traffic import Taken


def pose(run: int) -> PoseRecord:
    unit = np.array([0.0, 0.0, 0.0, 1.0])
    return PoseRecord(run, 0, 1, np.zeros(3), unit, HEALTH.index("ok"), 0, False, ())


def topics(scene: Scene) -> list[str]:
    return [each.topic for each in scene.whole(1)]


def tile(number: int, map_id: int) -> Tile:
    return Tile("plane", (number, 0, 0), 1, np.zeros(5, messages.MAP_POINT), map_id)


def foxglove_table(name: str) -> Any:
    """The class that reads a table of Foxglove's; skips the test where it is not installed."""
    pytest.importorskip("foxglove_schemas_flatbuffer")
    return getattr(importlib.import_module(f"foxglove_schemas_flatbuffer.{name}"), name)


def drawn_by_foxglove(scene: Scene) -> int:
    """Number of the map's points."""
    message = foxglove_table("PointCloud")
    return int(message.GetRootAs(scene.map(1).data).DataLength()) // 16


def test_tiles_stay_while_the_map_is_the_same() -> None:
    """Those from before the first pose, and those of the run before, as mapping keeps its map when
    the driver is restarted. Tiles of another map, e.g. after a reset within the run, end it."""
    pytest.importorskip("foxglove_schemas_flatbuffer")
    scene = Scene(Keys("r"), 0.0, np.eye(4))
    scene.keep(tile(0, map_id=7))
    list(scene._pose(pose(run=7)))
    assert topics(scene) == ["/map"]
    list(scene._pose(pose(run=8)))
    scene.keep(tile(1, map_id=7))
    assert drawn_by_foxglove(scene) == 10
    scene.keep(tile(0, map_id=8))
    assert drawn_by_foxglove(scene) == 5


def test_a_path_ends_with_its_map() -> None:
    """After a reset the next pose is at the origin of another map."""
    message = foxglove_table("PosesInFrame")
    scene = Scene(Keys("r"), 0.0, np.eye(4))

    def length() -> int:
        shown = [each for each in scene._pose(pose(run=7)) if each.topic == "/path"]
        return int(message.GetRootAs(shown[0].data).PosesLength())

    assert length() == 1
    scene.keep(tile(0, map_id=7))
    scene.keep(tile(1, map_id=7))
    assert length() == 2
    scene.keep(tile(0, map_id=8))
    assert length() == 1


def logged(shown: list[Shown]) -> list[str]:
    message = foxglove_table("Log")
    return [message.GetRootAs(each.data).Message().decode() for each in shown]


def test_what_an_ended_instance_said_is_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mapping that failed and was started again has another name; the old one's words, with the
    time of now, would be an error that never ends."""
    pytest.importorskip("foxglove_schemas_flatbuffer")
    needs_schemas()
    now_s = 100.0
    monkeypatch.setattr(foxglove_scene, "time", SimpleNamespace(monotonic=lambda: now_s))
    scene = Scene(Keys("r"), 0.0, np.eye(4))

    def says(instance: str, health: str, reason: str = "") -> None:
        number = SERVICE_HEALTH.index(health)
        status = compose.status(
            "mapping", 1, 1, 0, [], {}, health=number, reason=reason, instance=instance
        )
        scene.take(Sample(f"loam/r/service/mapping/{instance}/status", status, 1))

    says("mapping-1", "failed", "no memory")
    says("mapping-3", "stopping")
    now_s += 4.0
    says("mapping-2", "ready")
    assert logged(scene.whole(1)) == ["failed: no memory", "stopping", "ready"]
    now_s += 4.0
    says("mapping-2", "ready")
    assert logged(scene.whole(1)) == ["silent: nothing more is heard of mapping-1", "ready"]
    assert logged(scene.whole(1)) == ["ready"]


def rerun_scene_in(shown: dict[str, Any]) -> rerun_scene.Scene:
    """A scene whose entities that are not cleared are kept in `shown`."""
    rr = pytest.importorskip("rerun")

    def log(entity: str, what: Any, **_: Any) -> None:
        if isinstance(what, rr.Clear):
            for below in [each for each in shown if each.startswith(f"{entity}/")]:
                del shown[below]
        else:
            shown[entity] = what

    recording = SimpleNamespace(log=log, set_time=lambda *_, **__: None)
    return rerun_scene.Scene(Keys("r"), recording, np.eye(4))


def test_rerun_clears_the_tiles_of_another_map() -> None:
    shown: dict[str, Any] = {}
    scene = rerun_scene_in(shown)
    for number in (0, 1):
        scene.keep(tile(number, map_id=7))
    scene._pose(pose(run=7))
    scene._pose(pose(run=8))
    assert {each for each in shown if "tiles" in each} == {
        "map/tiles/plane/0_0_0",
        "map/tiles/plane/1_0_0",
    }
    scene.keep(tile(0, map_id=8))
    assert {each for each in shown if "tiles" in each} == {"map/tiles/plane/0_0_0"}


@pytest.mark.parametrize(("run", "map_id", "pieces"), [(7, 7, 4), (8, 7, 1), (7, 8, 1)])
def test_rerun_clears_the_paths_of_another_run_or_map(run: int, map_id: int, pieces: int) -> None:
    """The run before drove elsewhere: its line would seem to be of this one."""
    shown: dict[str, Any] = {}
    scene = rerun_scene_in(shown)
    scene.keep(tile(0, map_id=7))
    for _ in range(rerun_scene.PIECE + 1):
        scene._pose(pose(run=7))
        scene._odometry_pose(pose(run=7))
    drawn = {each for each in shown if "path" in each}
    assert len(drawn) == 4
    scene.keep(tile(0, map_id))
    scene._pose(pose(run))
    assert len([each for each in shown if "path" in each]) == pieces


def test_rerun_ends_the_sureness_of_a_pose_before() -> None:
    rr = pytest.importorskip("rerun")
    shown: list[str] = []

    def log(entity: str, what: Any, **_: Any) -> None:
        if entity in ("map/sureness", "plots/sigma/position_m"):
            shown.append(type(what).__name__)

    recording = SimpleNamespace(log=log, set_time=lambda *_, **__: None)
    scene = rerun_scene.Scene(Keys("r"), recording, np.eye(4))
    scene._pose(replace(pose(run=7), covariance=tuple(np.eye(6).ravel())))
    scene._pose(pose(run=7))
    kinds = [rr.Ellipsoids3D, rr.Scalars, rr.Clear]
    assert shown == [kind.__name__ for kind in kinds]


def samples(keys: Keys) -> list[Sample]:
    """A pose, and what has its key alone: a message of another version, or a stranger's."""
    made = compose.pose("MapPose", compose.HeaderValues(1, 1, 1), 1, (0, 0, 0), (0, 0, 0, 1))
    return [Sample(keys.pose, payload, 1) for payload in (made, b"no pose at all")]


def test_foxglove_counts_what_can_not_be_read() -> None:
    pytest.importorskip("foxglove_schemas_flatbuffer")
    needs_schemas()
    keys = Keys("r")
    server = Server.__new__(Server)
    channel = SimpleNamespace(log=lambda *_, **__: None)
    waiting = SimpleNamespace(taken=lambda: samples(keys), dropped={})
    values = {"_scene": Scene(keys, 1e9, np.eye(4)), "_intake": waiting, "_again": math.inf}
    vars(server).update(values, _channels={"/pose": channel}, shown=0, garbage=0)
    server.poll()
    assert server.words() == "1 messages shown, 0 left out, 1 could not be read"


def test_rerun_counts_what_can_not_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    needs_schemas()
    scene, keys, looks = rerun_scene_in({}), Keys("r"), iter([True])
    link: Any = SimpleNamespace(keys=keys, thin=False, taken=Taken(), preview_s=0.0)
    waiting: Any = SimpleNamespace(taken=lambda: samples(keys), close=lambda: None)
    goes_on = nullcontext(lambda: next(looks, False))
    monkeypatch.setattr(ending, "until_told", lambda _: goes_on)
    sink = rerun_view._Sink(None, rerun_view.Options(), None)
    assert rerun_view._draw(link, waiting, scene, None, sink) == 1
    assert scene.garbage == 1
