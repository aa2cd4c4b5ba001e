"""Commands map, trajectory, compare and support: they work on the results of runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zloam_monitor import cli_common as common
from zloam_monitor.cli_common import command, examples
from zloam_monitor.failures import FileTrouble, Misuse

if TYPE_CHECKING:
    from zloam_monitor.maps import PointMap

Source = Annotated[Path, typer.Argument(metavar="FROM", help="PCD, PLY, LAS or LAZ file.")]
Target = Annotated[
    Path, typer.Argument(metavar="TO", help="File to write; its extension selects the format.")
]
Layer = Annotated[str | None, typer.Option(help="Use only edge, or only plane points.")]
Voxel = Annotated[float | None, typer.Option(help="Keep one point per voxel of this size, m.")]
#: Edge of the voxels of `map export`, which gets the points of all sweeps.
EXPORT_VOXEL_M = 0.2
ExportVoxel = Annotated[
    float | None,
    typer.Option(
        help="Keep one point per voxel of this size, m.", show_default=str(EXPORT_VOXEL_M)
    ),
]
Limits = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="LOW HIGH", help="Limits of the points to keep, m."),
]

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Map folder of a run with --map.")]

map_app = typer.Typer(no_args_is_help=True, help="Save, inspect, merge, convert and crop maps.")


@command
def map_info(
    file: Annotated[
        Path,
        typer.Argument(metavar="MAP", help="PCD, PLY, LAS or LAZ file, or map folder of a run."),
    ],
    preset_dir: common.PresetDir = None,
    as_json: common.Json = False,
) -> int:
    """Print number and extent of a map's points by layer; for a folder, its submaps and loops."""
    from zloam_monitor import answers, maps, sessions

    if file.is_dir():
        with sessions.opened(common.kept(preset_dir), file) as found:
            answers.give(as_json, found.report, sessions.lines(found))
            return 0 if found.complete else 1
    described = maps.described(file, maps.read(file))
    answers.give(as_json, described, maps.lines(described))
    return 0


@command
def map_save(
    to: Target,
    voxel: Voxel = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Write the map of a running robot to a file on this machine."""
    from zloam_monitor import answers, discovery, map_saving, maps

    maps.writable(to)
    if voxel is not None:
        maps.check_voxel(voxel)
    with discovery.linked(robot, common.endpoints(connect)) as link:
        saved = map_saving.save(link, to, voxel)
    answers.give(as_json, saved, saved.lines())
    return 0


@command
def map_merge(
    folders: Annotated[
        list[Path], typer.Argument(metavar="FOLDER...", help="Map folders of runs with --map.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the files; new or empty.")],
    preset_dir: common.PresetDir = None,
    as_json: common.Json = False,
) -> int:
    """Merge maps of several runs or robots into one frame, by the places that they share.

    Writes map.pcd, graph.g2o, the submaps' poses and sessions.json, in the frame of the first map,
    and the stored map: --map with --localize or --extend accepts the folder.
    Exit code 1: a map has too little in common with the others and is left out, or is damaged.
    """
    from zloam_monitor import answers, sessions

    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FileTrouble(f"{out}: exists already; name a new folder")
    merged = sessions.merge(common.kept(preset_dir), folders, out, not sys.stderr.isatty())
    answers.give(as_json, merged.report, sessions.lines(merged))
    return 0 if merged.complete else 1


@command
def map_export(
    folder: Folder,
    to: Annotated[
        Path,
        typer.Argument(
            metavar="TO",
            help="File to write. .pcd, .ply, .las, .laz: the points; .g2o: the pose graph; .tum: "
            "the poses of the submaps.",
        ),
    ],
    voxel: ExportVoxel = None,
    preset_dir: common.PresetDir = None,
) -> int:
    """Write a run's map with loops closed, for other programs."""
    from zloam_monitor import sessions

    sessions.exportable(to, voxel)
    with sessions.opened(common.kept(preset_dir), folder) as found:
        print(f"{to}: {sessions.export(found, to, EXPORT_VOXEL_M if voxel is None else voxel)}")
    # A damaged map, or loops that could not be closed, were reported by zloam-sessions.
    return 0 if found.complete else 1


@command
def map_convert(source: Source, to: Target, layer: Layer = None, voxel: Voxel = None) -> int:
    """Convert a map to another format, for CloudCompare, QGIS, Open3D, PCL."""
    return _written(source, to, {}, layer, voxel)


@command
def map_crop(
    source: Source,
    to: Target,
    x: Limits = None,
    y: Limits = None,
    z: Limits = None,
    layer: Layer = None,
    voxel: Voxel = None,
) -> int:
    """Keep the points within limits, e.g. to remove the ceiling."""
    limits = {axis: limit for axis, limit in (("x", x), ("y", y), ("z", z)) if limit is not None}
    return _written(source, to, limits, layer, voxel)


@command
def map_grid(
    source: Source,
    to: Annotated[
        Path,
        typer.Argument(metavar="TO", help="File to write, .yaml; the image is written beside it."),
    ],
    cell: Annotated[float, typer.Option(help="Edge of a cell, m.")] = 0.2,
    height: Annotated[
        tuple[float, float],
        typer.Option(metavar="LOW HIGH", help="Height range of obstacles above the ground, m."),
    ] = (0.2, 2.0),
) -> int:
    """Write an occupancy grid for Nav2: pgm and yaml."""
    from zloam_monitor import map_exports

    grid = map_exports.occupancy(_read(source), cell, height)
    image = map_exports.write_grid(to, grid)
    rows, columns = grid.cells.shape
    occupied, free = grid.count(map_exports.OCCUPIED), grid.count(map_exports.FREE)
    print(f"{to}, {image}: {columns} x {rows} cells, {occupied} occupied, {free} free")
    return 0


@command
def map_autoware(
    source: Source,
    to: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder to create.")],
    tile: Annotated[float, typer.Option(help="Edge of a tile, m.")] = 20.0,
) -> int:
    """Write a point cloud map for Autoware: tiles, their metadata, and the projection."""
    from zloam_monitor import map_exports

    found = _read(source)
    tiles = map_exports.write_autoware(to, found, tile)
    print(f"{to}: {len(found)} points in {tiles} tiles")
    return 0


def _read(source: Path) -> PointMap:
    """Reads a map, and reports what is not in the result although it is in the file."""
    from zloam_monitor import maps

    found = maps.read(source)
    if found.left_out:
        common.said(f"{source}: {maps.left_out_text(found.left_out)}")
    return found


def _written(
    source: Path,
    to: Path,
    limits: dict[str, tuple[float, float]],
    layer: str | None,
    voxel: float | None,
) -> int:
    from zloam_monitor import maps

    found = _read(source)
    kept = maps.cropped(found, limits)
    if layer is not None:
        kept = maps.of_layer(kept, layer)
    if voxel is not None:
        kept = maps.thinned(kept, voxel)
    if not len(kept):
        raise maps.MapError(f"none of the {len(found)} points of {source} is left: nothing written")
    maps.write(to, kept)
    for loss in maps.losses(to, kept):
        common.said(loss)
    print(f"{to}: {len(kept)} of {len(found)} points")
    return 0


@command
def trajectory(
    source: Annotated[Path, typer.Argument(metavar="FROM", help="TUM or KITTI file.")],
    to: Annotated[
        Path,
        typer.Argument(
            metavar="TO", help="File to write; .tum, .kitti or .csv selects the format."
        ),
    ],
) -> int:
    """Convert a trajectory to another format.

    A .csv also has health, degenerate direction and covariance of each pose, from the poses.csv
    beside a run's trajectory.
    """
    from zloam_monitor import pose_table
    from zloam_monitor import trajectory as trajectories

    written = {".tum": trajectories.write_tum, ".kitti": trajectories.write_kitti}
    ending = to.suffix.lower()
    if ending not in (*written, ".csv"):
        raise Misuse(f"{to}: {', '.join((*written, '.csv'))} is expected")
    found = trajectories.read(source)
    for remark in trajectories.remarks(source, found):
        common.said(remark)
    if ending in written:
        written[ending](to, found)
        print(f"{to}: {len(found)} poses")
        return 0
    known = pose_table.beside(source)
    trajectories.write_csv(to, found, known)
    print(f"{to}: {len(found)} poses, {pose_table.extent(source, known, found.stamps_ns)}")
    return 0


@command
def compare(
    first: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, e.g. out/demo.")],
    second: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of the other run.")],
    as_json: common.Json = False,
) -> int:
    """Compare two runs of one recording: poses, errors, latency, CPU, health."""
    from zloam_monitor import answers, comparison

    found = comparison.compared(comparison.read(first), comparison.read(second))
    answers.give(as_json, found, comparison.lines(found))
    return 0 if found.instants else 1


@command
def support(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")] = Path("out/demo"),
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("zloam-support.zip"),
    config: common.Config = None,
    connect: common.Connect = None,
) -> int:
    """Collect what is needed to analyse a fault: report, logs, configuration, machine.

    The file has no poses, maps or pictures. Statuses of robots on this machine, or at --connect,
    are included. Exit code 1: a robot could not be asked.
    """
    from zloam_monitor import support as bundle

    robots = bundle.live(common.endpoints(connect))
    names = bundle.write(out, run, config, robots)
    print(f"{out}: {len(names)} files")
    for name in names:
        print(f"  {name}")
    failures = bundle.failures(robots)
    for failure in failures:
        common.said(failure)
    return 1 if failures else 0


def add(app: typer.Typer) -> None:
    """Adds the commands under their heading."""
    map_app.command("info", epilog=examples("zloam map info out/demo/map.pcd"))(map_info)
    map_app.command(
        "save", epilog=examples("zloam map save town.laz", "zloam map save t.pcd --robot carol")
    )(map_save)
    map_app.command(
        "merge", epilog=examples("zloam map merge out/monday out/tuesday --out out/week")
    )(map_merge)
    map_app.command("export", epilog=examples("zloam map export out/town town.laz"))(map_export)
    map_app.command("convert", epilog=examples("zloam map convert out/demo/map.pcd map.laz"))(
        map_convert
    )
    map_app.command("crop", epilog=examples("zloam map crop map.pcd floor.ply --z -2 2.5"))(
        map_crop
    )
    map_app.command("grid", epilog=examples("zloam map grid out/demo/map.pcd grid.yaml"))(map_grid)
    map_app.command("autoware", epilog=examples("zloam map autoware out/demo/map.pcd town"))(
        map_autoware
    )
    app.add_typer(map_app, name="map", rich_help_panel=common.FILES)
    app.command(
        rich_help_panel=common.FILES,
        epilog=examples("zloam trajectory out/demo/trajectory.tum drive.csv"),
    )(trajectory)
    app.command(rich_help_panel=common.FILES, epilog=examples("zloam compare out/demo out/other"))(
        compare
    )
    app.command(
        rich_help_panel=common.FILES, epilog=examples("zloam support out/run --config my.yaml")
    )(support)
