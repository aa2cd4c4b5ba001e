"""Commands loop list, add and remove: the loops of a running robot's graph."""

from __future__ import annotations

from typing import Annotated

import typer

from zloam_monitor import cli_common as common
from zloam_monitor.cli_common import command, examples
from zloam_monitor.cli_robots import replied

#: Sweeps are numbered with 64 bits.
MOST_SWEEP = 2**64 - 1
Older = Annotated[
    int, typer.Argument(metavar="FROM", min=0, max=MOST_SWEEP, help="frame_sweep of a submap.")
]
Newer = Annotated[
    int, typer.Argument(metavar="TO", min=0, max=MOST_SWEEP, help="That of the other submap.")
]

loop_app = typer.Typer(no_args_is_help=True, help="List, add and remove loops of the graph.")


@command
def loop_list(
    connect: common.Connect = None, robot: common.Robot = None, as_json: common.Json = False
) -> int:
    """Print the loops that are or were in force, or wait for another one, with their verdicts."""
    from zloam_monitor import answers, discovery, loops

    with discovery.linked(robot, common.endpoints(connect)) as link:
        found = loops.known(link)
    answers.give(as_json, {"loops": found}, loops.lines(found))
    return 0


@command
def loop_add(
    older: Older,
    newer: Newer,
    force: Annotated[
        bool, typer.Option("--force", help="Also where it contradicts other loops or the drift.")
    ] = False,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Add the loop between two submaps of the same place; exit code 1 if it is not verified."""
    from zloam_monitor import discovery, loops

    with discovery.linked(robot, common.endpoints(connect)) as link:
        return replied([("graph", loops.add(link, older, newer, force))], as_json)


@command
def loop_remove(
    older: Older,
    newer: Newer,
    connect: common.Connect = None,
    robot: common.Robot = None,
    as_json: common.Json = False,
) -> int:
    """Remove a loop: the poses are then as if it had never been."""
    from zloam_monitor import discovery, loops

    with discovery.linked(robot, common.endpoints(connect)) as link:
        return replied([("graph", loops.remove(link, older, newer))], as_json)


def add(app: typer.Typer) -> None:
    """Adds the commands under their heading."""
    loop_app.command("list", epilog=examples("zloam loop list"))(loop_list)
    loop_app.command(
        "add", epilog=examples("zloam loop add 120 870", "zloam loop add 120 870 --force")
    )(loop_add)
    loop_app.command("remove", epilog=examples("zloam loop remove 120 870"))(loop_remove)
    app.add_typer(loop_app, name="loop", rich_help_panel=common.ROBOTS)
