"""Commands for running robots: robots, status, watch, get, set, save, reset, place, handover,
doctor, metrics."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zloam_monitor import cli_common as common
from zloam_monitor.cli_common import command, examples

if TYPE_CHECKING:
    from zloam_monitor.records import ReplyRecord

Stage = Annotated[str, typer.Argument(autocompletion=common.stage_names)]


@command
def robots(connect: common.Connect = None, as_json: common.Json = False) -> int:
    """List the robots that answer."""
    from zloam_monitor import answers, discovery

    found = discovery.present(common.endpoints(connect))
    answers.give(as_json, {"robots": found}, map(str, found))
    for text in discovery.namesakes(found):
        common.said(f"robots: {text}")
    return 0


@command
def status(
    connect: common.Connect = None, robot: common.Robot = None, as_json: common.Json = False
) -> int:
    """Print pose and health of each stage once; exit code 1 if one has failed or is silent."""
    from zloam_monitor import discovery, watch

    with discovery.linked(robot, common.endpoints(connect)) as link:
        return watch.look(link, as_json)


@command
def watch(
    connect: common.Connect = None,
    robot: common.Robot = None,
    seconds: common.ForSeconds = None,
    every: Annotated[
        float, typer.Option(help="Seconds between two updates.", callback=common.positive)
    ] = 2.0,
    as_json: common.Json = False,
) -> int:
    """Print pose and health of each stage repeatedly; with --json one line per update."""
    from zloam_monitor import discovery
    from zloam_monitor import watch as watcher

    with discovery.linked(robot, common.endpoints(connect), common.NEWEST) as link:
        return watcher.watch(link, seconds, every, as_json)


@command
def get(
    stage: Annotated[
        str | None,
        typer.Argument(autocompletion=common.stage_names, help="Default: all stages."),
    ] = None,
    key: Annotated[
        str | None, typer.Argument(help="A key, or a section of keys, e.g. mapping.voxel_planes.")
    ] = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Print the configuration in force; exit code 1 if that of a stage is missing."""
    from zloam_monitor import answers, discovery, settings

    with discovery.linked(robot, common.endpoints(connect)) as link:
        found = settings.in_force(link, stage, key)
        missing = settings.unanswered(link, stage)
    answers.give(as_json, found, settings.lines(found))
    for line in missing:
        common.said(f"get: {line}")
    return 1 if missing else 0


def replied(replies: Iterable[tuple[str, ReplyRecord]], as_json: bool) -> int:
    """Prints each stage's reply when it comes, JSON when all have come; 0 if all accepted."""
    from zloam_monitor import answers

    said = {}
    for stage, reply in replies:
        said[stage] = reply
        if not as_json:
            print(f"{stage}: {reply.message}", flush=True)
    if as_json:
        print(answers.text(said))
    return 0 if all(reply.ok for reply in said.values()) else 1


@command
def set_(
    stage: Stage,
    values: Annotated[list[str] | None, typer.Argument(metavar="KEY=VALUE...")] = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Change live parameters of a stage; print the first sweep with them, or what is allowed."""
    from zloam_monitor import discovery, settings

    wanted = settings.stage_and_pairs(stage, values or [])
    with discovery.linked(robot, common.endpoints(connect)) as link:
        return replied([(stage, settings.change(link, stage, wanted))], as_json)


@command
def save(
    folder: Annotated[
        Path | None,
        typer.Argument(help="Folder below the stages' output folder. Default: the output folder."),
    ] = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Write map and trajectories now; the run continues."""
    from zloam_monitor import discovery, settings

    with discovery.linked(robot, common.endpoints(connect)) as link:
        return replied(settings.save(link, folder), as_json)


@command
def reset(
    stages: Annotated[
        list[str] | None,
        typer.Argument(metavar="[STAGE]...", help="Default: odometry and mapping."),
    ] = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Empty the map and begin a new one."""
    from zloam_monitor import discovery, settings

    with discovery.linked(robot, common.endpoints(connect)) as link:
        return replied(settings.reset(link, stages or ("odometry", "mapping")), as_json)


@command
def place(
    x: Annotated[float, typer.Option(help="x in the map, m.")],
    y: Annotated[float, typer.Option(help="y in the map, m.")],
    yaw: Annotated[float, typer.Option(help="Heading in the map, degrees, anticlockwise.")] = 0.0,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Tell mapping where a robot that was carried or is lost is in its map."""
    from zloam_monitor import discovery, settings

    with discovery.linked(robot, common.endpoints(connect)) as link:
        return replied([("mapping", settings.place(link, x, y, yaw))], as_json)


@command
def handover(
    stage: Annotated[
        str, typer.Argument(help="odometry, mapping or integration, or a stage that is silenced.")
    ],
    to: Annotated[
        str | None,
        typer.Argument(help="Standby instance. Default: the one that has stood by longest."),
    ] = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Let a standby take over a stage's work; no sweep is lost.

    A stage that a stranger's token silences (`zloam doctor` names the token) works again.
    """
    from zloam_monitor import discovery, settings

    with discovery.linked(robot, common.endpoints(connect)) as link:
        return replied([(stage, settings.hand_over(link, stage, to))], as_json)


@command
def metrics(
    port: Annotated[
        int, typer.Option(min=0, max=common.MOST_PORT, help="Port of the page; 0: a free port.")
    ] = 9464,
    address: common.Address = "127.0.0.1",
    seconds: common.ForSeconds = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
) -> int:
    """Serve a robot's metrics to Prometheus (OpenMetrics); deploy/observability has alerts."""
    from zloam_monitor import discovery
    from zloam_monitor import metrics as exporter

    with discovery.linked(robot, common.endpoints(connect), exporter.KEPT_POSES) as link:
        return exporter.serve(link, address, port, seconds)


@command
def doctor(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            help="A capture (pcap, pcapng), payload file (.bin), or recording of `zloam record`.",
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(help="Seconds to listen to a robot.", callback=common.positive)
    ] = 5.0,
    model: Annotated[str | None, typer.Option(help="Of a file: the sensor's model.")] = None,
    metadata: Annotated[Path | None, typer.Option(help="Of a file: the sensor's metadata.")] = None,
    connect: common.Connect = None,
    robot: common.Robot = None,
    preset_dir: common.PresetDir = None,
    as_json: common.Json = False,
) -> int:
    """Report what is wrong with a running robot or with a recording, and what to do.

    Exit code 0: no fault was found; 1: a fault was found.
    """
    from zloam_monitor import answers, discovery, doctor_files
    from zloam_monitor import doctor as judge

    if file is not None:
        found = doctor_files.of_file(common.kept(preset_dir), file, model, metadata)
        well = f"{file}: all well"
    else:
        with discovery.linked(robot, common.endpoints(connect)) as link:
            heard = judge.listen(link, seconds)
        found = judge.findings(heard)
        well = f"all well: {len(heard.living)} stages, {len(heard.poses)} poses in {seconds:.0f} s"
    faults = any(finding.is_fault for finding in found)
    lines = [*([] if faults else [well]), *map(str, found)]
    answers.give(as_json, {"well": not faults, "findings": found}, lines)
    return 1 if faults else 0


def add(app: typer.Typer) -> None:
    """Adds the commands under their heading."""
    listed = (
        (robots, "robots", ("zloam robots", "zloam robots --connect 192.168.1.5")),
        (status, "status", ("zloam status",)),
        (watch, "watch", ("zloam watch", "zloam watch --connect 192.168.1.5 --every 1")),
        (get, "get", ("zloam get odometry", "zloam get mapping mapping.voxel_planes")),
        (set_, "set", ("zloam set odometry odometry.kernel_m=0.2",)),
        (save, "save", ("zloam save", "zloam save maps/today")),
        (reset, "reset", ("zloam reset", "zloam reset mapping")),
        (place, "place", ("zloam place --x 12 --y -3.5 --yaw 90",)),
        (handover, "handover", ("zloam handover mapping", "zloam handover odometry odometry-2")),
        (doctor, "doctor", ("zloam doctor", "zloam doctor drive.pcap", "zloam doctor run.mcap")),
        (metrics, "metrics", ("zloam metrics", "zloam metrics --connect 192.168.1.5")),
    )
    for run, name, shown in listed:
        app.command(name, rich_help_panel=common.ROBOTS, epilog=examples(*shown))(run)
