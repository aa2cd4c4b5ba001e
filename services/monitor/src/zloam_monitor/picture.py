"""One picture of a run: map and trajectory from above, error over time, and a close-up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from zloam_monitor import files, se3
from zloam_monitor.evaluation import Compared

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

Array = NDArray[np.float64]
#: More points than this are thinned evenly, as the picture has fewer pixels.
MOST_POINTS = 600_000
#: A map with a greater width-to-height ratio is placed above the other panels.
WIDE_RATIO = 1.9
ESTIMATE_COLOUR = "#d62728"
TRUTH_COLOUR = "#111111"


@dataclass(frozen=True)
class Scene:
    """Contents of the picture; positions in m, frame map."""

    title: str
    points: NDArray[Any]  # structured: x y z intensity
    positions: Array  # (n, 3) of base_link
    seconds: Array  # (n,) since the first pose
    compared: Compared | None = None
    intensity: bool = False


def draw(path: Path, scene: Scene) -> None:
    """Writes the PNG."""
    figure, whole, close, below = _panels(_map_ratio(scene))
    _entitle(figure, scene.title)
    window = _close_window(scene.positions)
    _draw_map(figure, whole, scene)
    whole.add_patch(
        Rectangle(
            (window[0], window[2]),
            window[1] - window[0],
            window[3] - window[2],
            fill=False,
            edgecolor="#1f77b4",
            linewidth=1.5,
            label="close view",
        )
    )
    whole.legend(loc="upper right", framealpha=0.9)
    _draw_close(close, scene, window)
    if scene.compared is None:
        _draw_height(below, scene)
    else:
        _draw_error(below, scene.compared)
    _save(figure, path)


def draw_errors(path: Path, title: str, compared: Compared) -> None:
    """Writes a PNG of both paths from above, aligned, and the errors over time."""
    figure = plt.figure(figsize=(15, 8), dpi=110, layout="constrained")
    _entitle(figure, title)
    grid = figure.add_gridspec(2, 2)
    above, far, turned = (figure.add_subplot(c) for c in (grid[:, 0], grid[0, 1], grid[1, 1]))
    aligned, positions = compared.aligned[:, :3, 3], compared.truth[:, :3, 3]
    above.plot(aligned[:, 0], aligned[:, 1], "-", color=ESTIMATE_COLOUR, lw=3.0, label="trajectory")
    above.plot(positions[:, 0], positions[:, 1], "--", color=TRUTH_COLOUR, lw=1.2, label="truth")
    above.set(title="from above, aligned", xlabel="x (m)", ylabel="y (m)")
    above.set_aspect("equal", adjustable="datalim")
    above.legend(loc="best")
    above.grid(alpha=0.25)
    _draw_error(far, compared)
    _draw_rotation_error(turned, compared)
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    with files.written_whole(path, "wb") as out:
        figure.savefig(out, format="png")
    plt.close(figure)


def _entitle(figure: Figure, title: str) -> None:
    """Titles are names of files, which may contain $, and bytes that are no text."""
    text = title.encode("utf-8", "backslashreplace").decode()
    figure.suptitle(text, parse_math=False)


def _map_ratio(scene: Scene) -> float:
    """Width-to-height ratio of map and path."""
    xy = np.r_[
        np.c_[scene.points["x"], scene.points["y"]].reshape(-1, 2)[:: _step(scene.points)],
        scene.positions[:, :2],
    ]
    if len(xy) < 2:
        return 1.0
    width, height = np.maximum(np.ptp(xy, axis=0), 1.0)
    return float(np.clip(width / height, 0.6, 4.0))


def _panels(map_ratio: float) -> tuple[Figure, Axes, Axes, Axes]:
    """Map, close-up and curve: side by side, or below the map if it is wide."""
    if map_ratio > WIDE_RATIO:
        figure = plt.figure(figsize=(16, 16 / map_ratio + 6.5), dpi=110, layout="constrained")
        grid = figure.add_gridspec(
            2, 2, height_ratios=[16 / map_ratio + 0.5, 6], width_ratios=[1, 2]
        )
        cells = (grid[0, :], grid[1, 0], grid[1, 1])
    else:
        width = 9 * map_ratio + 1.5
        figure = plt.figure(figsize=(width + 5.5, 10), dpi=110, layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=[width, 5.5])
        cells = (grid[:, 0], grid[0, 1], grid[1, 1])
    whole, close, below = (figure.add_subplot(cell) for cell in cells)
    return figure, whole, close, below


def _step(points: NDArray[Any]) -> int:
    return max(1, -(-len(points) // MOST_POINTS))


def _thinned(points: NDArray[Any]) -> NDArray[Any]:
    return points[:: _step(points)]


def _truth_in_map(scene: Scene) -> Array | None:
    """Truth transformed to the map frame, in which the estimate is not aligned."""
    if scene.compared is None:
        return None
    aligned, raw = scene.compared.aligned[0], scene.compared.estimate[0]
    back = raw @ np.linalg.inv(aligned)
    moved: Array = scene.compared.truth[:, :3, 3] @ back[:3, :3].T + back[:3, 3]
    return moved


def _draw_paths(axes: Axes, scene: Scene, width: float) -> None:
    p = scene.positions
    axes.plot(p[:, 0], p[:, 1], "-", color=ESTIMATE_COLOUR, lw=width + 2.0, label="trajectory")
    truth = _truth_in_map(scene)
    if truth is not None:
        # A thin dashed line over the wide one, so that both are visible where they agree.
        axes.plot(truth[:, 0], truth[:, 1], "--", color=TRUTH_COLOUR, lw=width, label="truth")
    if len(p):
        # A ring, as a path that ends where it began would hide a disc below the mark of its end.
        axes.plot(*p[0, :2], "o", color="#2ca02c", mfc="none", mew=2.5, ms=13, label="start")
        axes.plot(*p[-1, :2], "s", color="#9467bd", ms=6, label="end")


def _draw_map(figure: Figure, axes: Axes, scene: Scene) -> None:
    points = _thinned(scene.points)
    if len(points):
        value = points["intensity"] if scene.intensity else points["z"]
        low, high = np.percentile(value, [2, 98])
        drawn = axes.scatter(
            points["x"],
            points["y"],
            c=value,
            s=0.35,
            cmap="viridis",
            vmin=low,
            vmax=max(high, low + 1e-3),
            linewidths=0,
            rasterized=True,
        )
        label = "reflectivity (0–255)" if scene.intensity else "height (m, frame map)"
        figure.colorbar(drawn, ax=axes, label=label, location="right", aspect=50, pad=0.01)
    _draw_paths(axes, scene, 1.2)
    axes.set(title=f"map from above, {len(scene.points):,} points", xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.25)


def _close_window(positions: Array) -> tuple[float, float, float, float]:
    """A square around the end of the path, where a loop may close: x0, x1, y0, y1."""
    if len(positions) == 0:
        return (-10.0, 10.0, -10.0, 10.0)
    extent = float(np.ptp(positions[:, :2], axis=0).max())
    half = float(np.clip(extent * 0.15, 10.0, 20.0))
    x, y = positions[-1, :2]
    return (x - half, x + half, y - half, y + half)


def _draw_close(axes: Axes, scene: Scene, window: tuple[float, float, float, float]) -> None:
    x0, x1, y0, y1 = window
    p = scene.points
    inside = (p["x"] > x0) & (p["x"] < x1) & (p["y"] > y0) & (p["y"] < y1)
    near = _thinned(p[inside])
    # Without the ground, walls appear as lines, and a doubled wall as two lines.
    if len(near) > 50:
        near = near[near["z"] > np.percentile(near["z"], 2) + 0.5]
    axes.scatter(near["x"], near["y"], s=1.5, c="#555555", linewidths=0, rasterized=True)
    _draw_paths(axes, scene, 1.5)
    axes.set(xlim=(x0, x1), ylim=(y0, y1), xlabel="x (m)", ylabel="y (m)")
    axes.set_title("close view at the end of the path, without the ground")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(alpha=0.25)


def _along(compared: Compared) -> tuple[Array, str]:
    """Values and label of the horizontal axis for errors."""
    seconds: Array = (compared.stamps_ns - compared.stamps_ns[0]) * 1e-9
    if seconds[-1] < 1e-3:  # The truth is known by sweep number only.
        return np.arange(len(seconds), dtype=float), "pose"
    return seconds, "time (s)"


def _draw_rotation_error(axes: Axes, compared: Compared) -> None:
    """Draws rotation errors relative to the first pose's, which depends on the frames."""
    apart = se3.inverse(compared.truth) @ compared.aligned
    error = np.degrees(se3.rotation_angle_rad(apart @ se3.inverse(apart[0])))
    seconds, label = _along(compared)
    axes.plot(seconds, error, color=ESTIMATE_COLOUR, lw=1.4)
    axes.set(title="error of the rotation since the first pose", xlabel=label, ylabel="error (deg)")
    axes.set_ylim(bottom=0, top=max(float(error.max()) * 1.1, 1e-3))
    axes.grid(alpha=0.25)


def _draw_error(axes: Axes, compared: Compared) -> None:
    seconds, label = _along(compared)
    error = compared.errors_m()
    rmse = float(np.sqrt(np.mean(error**2)))
    difference = compared.aligned[:, :3, 3] - compared.truth[:, :3, 3]
    axes.plot(seconds, error, color=ESTIMATE_COLOUR, lw=1.4, label="distance")
    for axis, name in enumerate("xyz"):
        axes.plot(seconds, np.abs(difference[:, axis]), lw=0.8, alpha=0.7, label=f"|{name}|")
    axes.axhline(rmse, color=TRUTH_COLOUR, ls="--", lw=1, label=f"rmse {rmse:.3f} m")
    axes.set(title="error after alignment", xlabel=label, ylabel="error (m)")
    axes.set_ylim(bottom=0, top=max(float(error.max()) * 1.35, 1e-3))
    axes.legend(loc="upper center", ncols=5, fontsize=8)
    axes.grid(alpha=0.25)


def _draw_height(axes: Axes, scene: Scene) -> None:
    axes.plot(scene.seconds, scene.positions[:, 2], color=ESTIMATE_COLOUR, lw=1.4)
    axes.set(title="height of the path (no truth given)", xlabel="time (s)", ylabel="z (m)")
    axes.grid(alpha=0.25)
