"""Commands web, view, foxglove, record and replay: they show a robot, or record it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zloam_monitor import cli_common as common
from zloam_monitor.cli_common import command, examples


@command
def record(
    file: Annotated[Path, typer.Argument(help="MCAP file to write; it must not exist yet.")],
    seconds: common.ForSeconds = None,
    everything: Annotated[
        bool,
        typer.Option(
            "--everything", help="Also record what the stages can compute again from the sweeps."
        ),
    ] = False,
    scene: Annotated[bool, typer.Option(help="Also record the topics that Foxglove shows.")] = True,
    split_mib: Annotated[
        int, typer.Option(min=1, help="Begin another file after this many MiB.")
    ] = 2048,
    connect: common.Connect = None,
    robot: common.Robot = None,
) -> int:
    """Record a robot to MCAP: for `zloam demo --bag`, `zloam replay`, Foxglove.

    The file can be opened at any time, also after the recorder was killed. Exit code 1: messages
    are missing, or nothing came in the last five seconds although no stage announced its end.
    """
    from zloam_monitor import discovery, recorder
    from zloam_monitor.intake import MIB

    with discovery.linked(robot, common.endpoints(connect), newest=0) as link:
        options = recorder.Options(file, everything, scene, split_mib * MIB)
        return recorder.record(link, options, seconds)


@command
def replay(
    file: Annotated[Path, typer.Argument(help="Recording made by `zloam record`.")],
    rate: Annotated[
        float, typer.Option(min=1e-3, help="Speed; 1: as recorded; 2: twice as fast.")
    ] = 1.0,
    begin_s: Annotated[
        float, typer.Option("--from", min=0.0, help="Start, in seconds of the recording.")
    ] = 0.0,
    end_s: Annotated[
        float | None,
        typer.Option("--to", help="End, in seconds of the recording. Default: its end."),
    ] = None,
    robot: Annotated[str, typer.Option(help="Another name for the robot.")] = "",
    listen: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="Endpoint to listen on.")
    ] = "127.0.0.1:7464",
    connect: common.Connect = None,
) -> int:
    """Publish a recording again, for `zloam watch`, `zloam foxglove` and other subscribers.

    Nothing is computed again: `zloam demo --bag` does that.
    """
    from zloam_monitor import discovery, recordings, replayer, sources

    endpoints = tuple(discovery.endpoint_of(each) for each in common.endpoints(connect))
    options = replayer.Options(
        path=file,
        rate=rate,
        begin_s=begin_s,
        end_s=end_s,
        robot=robot,
        connect=endpoints,
        listen=discovery.endpoint_of(listen),
    )
    try:
        return replayer.replay(options)
    except recordings.Refused as refused:
        raise sources.SourceError(f"{file}: {refused}") from refused


@command
def foxglove(
    port: Annotated[
        int, typer.Option(min=0, max=common.MOST_PORT, help="Port of the server; 0: a free port.")
    ] = 8765,
    address: common.Address = "127.0.0.1",
    seconds: common.ForSeconds = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
) -> int:
    """Show a robot live in Foxglove or Lichtblick."""
    from zloam_monitor import discovery, foxglove_server

    with discovery.linked(robot, common.endpoints(connect), newest=0) as link:
        return foxglove_server.serve(link, address, port, seconds)


Thin = Annotated[
    bool,
    typer.Option(
        "--thin",
        help="For a thin link: use only the robot's preview (`zloam preview`) and statuses, "
        "some 50 kB/s.",
    ),
]


@command
def view(
    web: Annotated[
        bool, typer.Option("--web", help="Show it in the browser instead of a window.")
    ] = False,
    port: Annotated[
        int,
        typer.Option(
            min=1, max=common.MOST_PORT - 1, help="Port of the page; the data use the next port."
        ),
    ] = 9090,
    address: common.Address = "127.0.0.1",
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write to a new file (.rrd) instead of showing it."),
    ] = None,
    points: Annotated[bool, typer.Option(help="Show sweeps, features and rejected points.")] = True,
    thin: Thin = False,
    seconds: common.ForSeconds = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
) -> int:
    """Show a robot live in Rerun: sweeps, features, map, path, latency."""
    from zloam_monitor import discovery, rerun_view

    with discovery.linked(robot, common.endpoints(connect), newest=0, thin=thin) as link:
        options = rerun_view.Options(web, port, address, save, points)
        return rerun_view.view(link, options, seconds)


@command
def web(
    port: Annotated[
        int, typer.Option(min=0, max=common.MOST_PORT, help="Port of the page; 0: a free port.")
    ] = 8080,
    address: common.Address = "127.0.0.1",
    thin: Thin = False,
    seconds: common.ForSeconds = None,
    connect: common.Connect = None,
) -> int:
    """Serve a page for a browser: health, path, map and latency of all robots that answer."""
    from zloam_monitor.web import server

    return server.serve(common.endpoints(connect), address, port, seconds, thin)


def add(app: typer.Typer) -> None:
    """Adds the commands under their heading."""
    listed = (
        (web, "web", ("zloam web", "zloam web --address 0.0.0.0 --connect 192.168.1.5")),
        (view, "view", ("zloam view", "zloam view --web", "zloam view --save drive.rrd")),
        (foxglove, "foxglove", ("zloam foxglove", "zloam foxglove --connect 192.168.1.5")),
        (record, "record", ("zloam record drive.mcap", "zloam record drive.mcap --seconds 60")),
        (
            replay,
            "replay",
            ("zloam replay drive.mcap", "zloam replay drive.mcap --from 30 --rate 4"),
        ),
    )
    for run, name, shown in listed:
        app.command(name, rich_help_panel=common.ROBOTS, epilog=examples(*shown))(run)
