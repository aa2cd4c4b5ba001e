"""Draws a robot in Rerun, in space and over time, from the messages that anybody can subscribe
to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zloam_monitor import messages, records, se3
from zloam_monitor.clouds import POINT_LAYERS, Tile
from zloam_monitor.extras import needed
from zloam_monitor.intake import Sample
from zloam_monitor.keys import Keys
from zloam_monitor.map_frame import MapFrame, Matrix, matrix
from zloam_monitor.pose_health import position_sigma_m
from zloam_monitor.preview_map import Index, PreviewMap
from zloam_monitor.records import PoseRecord, PreviewRecord, StatusRecord

#: Class of features -> colour.
FEATURES = {
    "LessFlat": (90, 120, 160),
    "Flat": (60, 140, 230),
    "LessSharp": (230, 150, 60),
    "Sharp": (230, 60, 50),
}
REJECTED = (150, 60, 150)
LAYERS = {"edge": (230, 150, 60), "plane": (120, 130, 140)}
#: Entity above those of the map's tiles.
TILES = "map/tiles"
POSE_COLOUR, ODOMETRY_COLOUR = (40, 170, 90), (160, 160, 60)
WEAK_COLOUR = (214, 39, 40)
#: Poses in a piece of the path. Only the last piece is sent again with each new pose.
PIECE = 50
#: Blocks of a preview along an edge of the cube that is drawn as one entity.
DRAWN_BLOCKS = 4
#: The three-sigma ellipsoid is enlarged by this factor, as it would be too small to see.
ELLIPSOID_SCALE = 10.0


def expressions(keys: Keys, everything: bool) -> list[str]:
    """Keys that a scene needs; `everything`: also those published only for subscribers."""
    wanted = [keys.pose, keys.map_odometry, keys.odometry, keys.tiles, keys.every_status]
    looked_at = [keys.odometry_sweep, keys.features, keys.below("lidar/*/rejected")]
    return wanted + looked_at if everything else wanted


class Scene:
    """Draws into a recording stream of Rerun."""

    def __init__(self, keys: Keys, recording: Any, T_base_lidar: NDArray[np.float64]) -> None:
        self._rr = needed("rerun", "rerun-sdk")
        self._keys, self._recording = keys, recording
        self._run: int | None = None
        self._frame = MapFrame()
        self._pieces: dict[str, list[NDArray[np.float64]]] = {"map/path": [], "odom/path": []}
        self._numbers: dict[str, int] = {}
        self._said: dict[tuple[str, str], tuple[str, str]] = {}
        self._map_id: int | None = None
        self._preview = PreviewMap()
        self._last_preview = (-1, -1)
        self._log("map", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log("map/odom/base_link/lidar", self._transform(T_base_lidar), static=True)
        self.garbage = 0

    def _log(self, entity: str, what: Any, static: bool = False) -> None:
        self._recording.log(entity, what, static=static)

    def _transform(self, T: Matrix) -> Any:
        return self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def _at(self, stamp_ns: int, sweep: int | None = None) -> None:
        self._recording.set_time("time", timestamp=np.datetime64(stamp_ns, "ns"))
        if sweep is not None:
            self._recording.set_time("sweep", sequence=sweep)

    def take(self, sample: Sample) -> None:
        """Draws the change that a message makes, if it is part of the scene."""
        try:
            self._take(sample)
        except messages.DECODE_ERRORS:
            self.garbage += 1

    def _take(self, sample: Sample) -> None:
        keys = self._keys
        if sample.key == keys.pose:
            self._pose(records.map_pose(sample.payload))
        elif sample.key == keys.map_odometry:
            self._mapped(records.map_pose(sample.payload))
        elif sample.key == keys.preview:
            self._previewed(records.preview(sample.payload))
        elif sample.key == keys.odometry:
            self._odometry_pose(records.odometry(sample.payload))
        elif sample.key == keys.features:
            self._features(sample.payload)
        elif sample.key == keys.odometry_sweep:
            self._sweep(sample.payload)
        elif sample.key.endswith("/rejected"):
            self._rejected(sample.payload)
        elif sample.key.startswith(keys.below("map/tile/")):
            self.keep(records.tile(sample.payload))
        elif sample.key.endswith("/status"):
            self._status(records.status(sample.payload))

    def _pose(self, pose: PoseRecord) -> None:
        self._at(pose.instant_ns, pose.sweep)
        if pose.run != self._run:
            self._begin(pose.run)
        self._map_to_odom(self._frame.of_pose(pose))
        T_map_base = matrix(pose)
        self._extend("map/path", T_map_base[:3, 3], POSE_COLOUR)
        self._sureness(pose, T_map_base)
        self._scalar("plots/health/pose", float(pose.health))
        for name, value in _steps_ms(pose):
            self._scalar(f"plots/latency/{name}", value)

    def _mapped(self, pose: PoseRecord) -> None:
        """Charts the time of mapping, for which fused poses do not wait."""
        self._at(pose.instant_ns, pose.sweep)
        for name, value in _steps_ms(pose):
            if name == "mapping":
                self._scalar(f"plots/latency/{name}", value)

    def _previewed(self, said: PreviewRecord) -> None:
        pose = said.pose
        if pose is not None and (pose.run, pose.sweep) != self._last_preview:
            self._last_preview = (pose.run, pose.sweep)
            self._pose(pose)
            # A preview has no odometry: odom is shown at the map's origin.
            self._log("map/odom", self._transform(np.eye(4)))
            self._log("map/odom/base_link", self._transform(matrix(pose)))
        changed = self._preview.take(said)
        for group in {tuple(axis // DRAWN_BLOCKS for axis in index) for index in changed}:
            self._draw_group(group)

    def _draw_group(self, group: tuple[int, ...]) -> None:
        steps = range(DRAWN_BLOCKS)
        low = [DRAWN_BLOCKS * axis for axis in group]
        within: list[Index] = [
            (low[0] + i, low[1] + j, low[2] + k) for i in steps for j in steps for k in steps
        ]
        found = [index for index in within if index in self._preview.blocks]
        centres = [self._preview.centres(index) for index in found]
        radii = [
            np.full(len(c), 0.5 * self._preview.cell_m(i))
            for c, i in zip(centres, found, strict=True)
        ]
        self._log(
            f"map/preview/{'_'.join(map(str, group))}",
            self._rr.Points3D(
                np.concatenate([np.empty((0, 3)), *centres]),
                radii=np.concatenate([np.empty(0), *radii]),
                colors=[LAYERS["plane"]],
            ),
        )

    def _map_to_odom(self, T_map_odom: Matrix | None) -> None:
        if T_map_odom is not None:
            self._log("map/odom", self._transform(T_map_odom))

    def _sureness(self, pose: PoseRecord, T_map_base: Matrix) -> None:
        rr = self._rr
        longest_m = position_sigma_m(pose)
        if longest_m is not None:
            values, vectors = np.linalg.eigh(np.array(pose.covariance).reshape(6, 6)[:3, :3])
            sigma_m = np.sqrt(np.maximum(values, 0.0))
            if np.linalg.det(vectors) < 0:
                vectors[:, 0] *= -1.0
            turned = np.eye(4)[None].copy()
            turned[0, :3, :3] = T_map_base[:3, :3] @ vectors
            self._log(
                "map/sureness",
                rr.Ellipsoids3D(
                    centers=[T_map_base[:3, 3]],
                    half_sizes=[3.0 * ELLIPSOID_SCALE * sigma_m],
                    quaternions=[rr.Quaternion(xyzw=se3.quaternions(turned)[0])],
                    colors=[POSE_COLOUR],
                ),
            )
            self._scalar("plots/sigma/position_m", longest_m)
        else:
            # Rerun would go on showing that of an earlier pose.
            self._log("map/sureness", rr.Clear(recursive=False))
        weak = np.array(pose.weak_translation)
        arrows = [3.0 * weak] if pose.degenerate and weak.any() else []
        self._log(
            "map/odom/base_link/weak_direction",
            rr.Arrows3D(vectors=arrows, colors=[WEAK_COLOUR] * len(arrows)),
        )

    def _begin(self, run: int) -> None:
        self._run = run
        self._frame.clear()
        self._clear_paths()

    def _clear_paths(self) -> None:
        for entity in self._pieces:
            # Rerun goes on showing each piece until it is cleared.
            self._log(entity, self._rr.Clear(recursive=True))
            self._pieces[entity].clear()
            self._numbers[entity] = self._numbers.get(entity, 0) + 1

    def _extend(self, entity: str, point: NDArray[np.float64], colour: tuple[int, ...]) -> None:
        piece = self._pieces[entity]
        piece.append(point.copy())
        number = self._numbers.get(entity, 0)
        strip = self._rr.LineStrips3D([np.array(piece)], colors=[colour])
        self._log(f"{entity}/{number}", strip)
        if len(piece) >= PIECE:
            self._pieces[entity] = piece[-1:]
            self._numbers[entity] = number + 1

    def _odometry_pose(self, pose: PoseRecord) -> None:
        self._at(pose.instant_ns, pose.sweep)
        self._map_to_odom(self._frame.of_odometry(pose))
        T_odom_base = matrix(pose)
        self._log("map/odom/base_link", self._transform(T_odom_base))
        # The path in odom is drawn in map, to show the drift of odometry alone.
        self._extend("odom/path", T_odom_base[:3, 3], ODOMETRY_COLOUR)

    def _features(self, payload: bytes) -> None:
        table = messages.decode("Features", payload)
        header = table.Header()
        if header is None:
            raise messages.MessageError("features without a header")
        self._at(header.StampNs(), header.Sweep())
        for name, colour in FEATURES.items():
            points = messages.struct_vector(table, name, messages.POINT)
            self._points(f"map/odom/base_link/lidar/features/{name}", points, colour, 0.03)

    def _sweep(self, payload: bytes) -> None:
        table = messages.decode("Cloud", payload)
        self._at(table.InstantNs())
        points = messages.struct_vector(table, "Points", messages.MAP_POINT)
        self._points("map/odom/base_link/sweep", points, (200, 200, 210), 0.02)

    def _rejected(self, payload: bytes) -> None:
        table = messages.decode("Rejected", payload)
        if (header := table.Header()) is not None:
            self._at(header.StampNs(), header.Sweep())
        points = messages.struct_vector(table, "Points", messages.POINT)
        finite = np.isfinite(points["x"]) & np.isfinite(points["y"]) & np.isfinite(points["z"])
        self._points("map/odom/base_link/lidar/rejected", points[finite], REJECTED, 0.03)

    def keep_path(self, run: int, poses: NDArray[Any]) -> None:
        """Draws the path of the run so far (messages.STAMPED_POSE)."""
        self._run = run
        for each in poses:
            self._at(int(each["instant_ns"]), int(each["sweep"]))
            at = np.array(each["pose"]["translation"].tolist())
            self._extend("map/path", at, POSE_COLOUR)

    def keep(self, tile: Tile) -> None:
        """Draws a tile of the map in place of its previous version. The first tile of another map
        ends the one before, and the paths in it: a reset begins another frame."""
        if tile.map_id != self._map_id:
            if self._map_id is not None:
                self._clear_paths()
            self._map_id = tile.map_id
            self._log(TILES, self._rr.Clear(recursive=True))
        if tile.layer in POINT_LAYERS:
            entity = f"{TILES}/{tile.layer}/{'_'.join(map(str, tile.index))}"
            self._points(entity, tile.points, LAYERS[tile.layer], 0.05)

    def _points(
        self, entity: str, points: NDArray[Any], colour: tuple[int, int, int], radius_m: float
    ) -> None:
        xyz = np.stack([points[axis] for axis in ("x", "y", "z")], axis=-1)
        self._log(entity, self._rr.Points3D(xyz, colors=[colour], radii=[radius_m]))

    def _status(self, status: StatusRecord) -> None:
        self._at(status.stamp_ns)
        for key, count in status.published.items():
            self._scalar(f"plots/published/{status.stage}/{key.rpartition('/')[2]}", float(count))
        self._scalar(f"plots/memory/{status.stage}", status.rss_mib["end"])
        dropped = sum(n for each in status.inputs for n in each.dropped.values())
        self._scalar(f"plots/dropped/{status.stage}", float(dropped))
        says = (status.health, status.reason)
        who = (status.stage, status.instance)
        if self._said.get(who) != says:
            self._said[who] = says
            text = f"{status.stage}: {status.health}{': ' * bool(status.reason)}{status.reason}"
            level = {"failed": "ERROR", "degraded": "WARN"}.get(status.health, "INFO")
            self._log("log", self._rr.TextLog(text, level=level))

    def _scalar(self, entity: str, value: float) -> None:
        self._log(entity, self._rr.Scalars(value))


def _steps_ms(pose: PoseRecord) -> Iterator[tuple[str, float]]:
    """Time of each stage, and the whole time since the sweep's last packet."""
    for step in pose.trace:
        yield step.stage, 1e-6 * (step.published_ns - step.received_ns)
    if pose.trace and pose.last_packet_ns:
        yield "whole", 1e-6 * (pose.trace[-1].published_ns - pose.last_packet_ns)


def blueprint(rr: Any) -> Any:
    """Initial layout: the scene; health, latency and log beside it."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="map", contents=["map/**", "odom/**"], name="Map"),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="plots/latency", name="Latency, ms"),
                rrb.TimeSeriesView(origin="plots/sigma", name="Sigma of the position, m"),
                rrb.TimeSeriesView(origin="plots/dropped", name="Dropped messages"),
                rrb.TextLogView(origin="log", name="What stages say"),
            ),
            column_shares=[3, 1],
        ),
        collapse_panels=True,
    )
