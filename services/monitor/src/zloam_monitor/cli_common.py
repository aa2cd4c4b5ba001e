"""Shared by all commands: options, and the reporting of failures."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ParamSpec

import typer

from zloam_monitor import ending, places, terminal
from zloam_monitor.failures import Explained, FileTrouble
from zloam_monitor.stages import PORT_ORDER, STAGES

#: Headings under which `zloam --help` lists the commands.
RUNS, ROBOTS, FILES, PROGRAMS = "Run", "Running robots", "Files", "Programs (each has a --help)"
P = ParamSpec("P")
#: Number of poses that a command keeps which may run for days: ten minutes at 10 Hz.
NEWEST = 6000
#: Placeholder in an endpoint for the name of each stage.
STAGE = "<stage>"


def said(error: object) -> None:
    print(f"\n{error}", file=sys.stderr)


def command(run: Callable[P, int]) -> Callable[P, None]:
    """Makes a function a command that ends with the returned exit code. Failures that a user can
    mend are reported without a stack trace."""

    @functools.wraps(run)
    def ended(*args: P.args, **kwargs: P.kwargs) -> None:
        raise typer.Exit(_code(lambda: run(*args, **kwargs)))

    return ended


def _code(run: Callable[[], int]) -> int:
    try:
        with ending.handled(ending.raised):
            return run()
    except ending.EndAsked as asked:
        said(f"ended by {asked}")
        return ending.SIGNAL_CODE + asked.number
    except KeyboardInterrupt:
        said("interrupted")
        return 130
    except BrokenPipeError:
        terminal.silence()
        return 1
    except OSError as error:
        said(f"cannot be read or written: {error}")
        return FileTrouble.exit_code
    except Explained as error:
        said(error)
        return error.exit_code


def examples(*lines: str) -> str:
    """Text for the end of a help page."""
    return "Examples:\n\n" + "\n\n".join(f"  {line}" for line in lines)


def split(values: list[str] | None) -> list[str]:
    """The values of an option that may be repeated, or given as a list with commas."""
    return [each for value in values or [] for each in value.replace(",", " ").split() or [value]]


def endpoints(connect: list[str] | None) -> list[str]:
    """The named endpoints; `<stage>` in one stands for each stage of the chain at its port."""
    from zloam_monitor.robot_file import RobotNames  # Here, because its import is slow.

    found = []
    for each in split(connect):
        if STAGE not in each:
            found.append(each)
            continue
        # The driver last, because it may start much later than the others.
        for stage in reversed(STAGES):
            port = RobotNames().base_port + PORT_ORDER.index(stage)
            found.append(f"{each.replace(STAGE, stage)}:{port}")
    return found


def positive(value: float | None) -> float | None:
    """Refuses a time that never passes (nan), or is none."""
    if value is not None and not value > 0.0:
        raise typer.BadParameter(f"{value}: a time above 0 is expected")
    return value


def robot_names() -> list[str]:
    return sorted(path.stem for path in places.robots().glob("*.yaml"))


def stage_names() -> list[str]:
    return list(STAGES)


def robot_path(text: str) -> Path:
    """A path, or the name of a robot file."""
    return places.robot_file(text)


Connect = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ENDPOINT",
        envvar="ZLOAM_CONNECT",
        help="Address or endpoint to connect to, e.g. 192.168.1.5 or tcp/robot:7464; may be "
        "repeated. tcp/<stage>: each stage at its own host. Default: this machine.",
    ),
]
#: Highest port number.
MOST_PORT = 65535
Robot = Annotated[
    str | None, typer.Option(help="The robot's name. Default: the only one that answers.")
]
Config = Annotated[
    Path | None,
    typer.Option(
        parser=robot_path,
        metavar="FILE",
        help="The robot's file, or the name of a file in deploy/robots.",
        autocompletion=robot_names,
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override one value of the file; may be repeated."
    ),
]
#: Options for the times of a cloud's points, named by the driver's keys.
TimeField = Annotated[str, typer.Option(help="Field with the points' times: driver.time_field.")]
TimeModel = Annotated[str, typer.Option(help="Clouds without times: driver.time_model.")]
PeriodS = Annotated[float, typer.Option(help="Clouds without times: driver.scan_period_s.")]
SeamDeg = Annotated[float, typer.Option(help="Clouds without times: driver.scan_seam_deg.")]
#: Several values in one text, as the Makefile passes them.
ManySettings = Annotated[str, typer.Option("--settings", hidden=True)]
ManySettingsAt = Annotated[str, typer.Option("--settings-at", hidden=True)]
ManyFiles = Annotated[str, typer.Option("--truths", hidden=True)]
Listen = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Address that the stages listen on; 0.0.0.0 lets other machines connect. "
        "Default: zenoh.host of the robot's file, this machine only.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one line of JSON, for programs.")]
#: For commands that run a server.
Address = Annotated[
    str, typer.Option(help="Address to listen on; 0.0.0.0 lets other machines connect.")
]
ForSeconds = Annotated[
    float | None,
    typer.Option(help="Seconds after which to end. Default: at Ctrl-C.", callback=positive),
]
Record = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Record what the robot publishes to MCAP, as `zloam record` does."
    ),
]
Map = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="FOLDER",
        help="Store the map in this folder (new or empty).",
    ),
]
Localize = Annotated[
    bool,
    typer.Option(
        "--localize",
        help="Localize the robot in the map of --map without changing it. The search starts where "
        "that run ended, then covers the whole map; `zloam place` helps where places look alike.",
    ),
]
Extend = Annotated[
    bool,
    typer.Option("--extend", help="Localize the robot in the map of --map, and continue mapping."),
]
Graph = Annotated[
    bool,
    typer.Option(
        "--graph",
        help="Close loops by the pose graph: trajectory_world.tum has the optimized poses, "
        "map_world.pcd the map that fits them.",
    ),
]
Method = Annotated[
    str,
    typer.Option(
        metavar="[STAGE=]NAME[,...]",
        help="Replace stages by those of another method. aloam: registration, odometry and mapping "
        "as in A-LOAM; mapping=aloam: mapping alone.",
    ),
]
PresetDir = Annotated[
    Path | None,
    typer.Option("--preset-dir", hidden=True, help="Build folder, which contains bin/."),
]


def kept(value: Path | None) -> Path:
    """The build folder: the given one, or the default."""
    return value or places.build()


def options(**more: Any) -> dict[str, Any]:
    """Context settings of a command that passes its arguments on to another program."""
    return {"allow_extra_args": True, "ignore_unknown_options": True, **more}
