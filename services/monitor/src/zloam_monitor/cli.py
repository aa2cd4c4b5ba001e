"""The command `zloam`: LiDAR odometry and mapping over Eclipse Zenoh."""

from __future__ import annotations

import io
import sys
from typing import Annotated

import typer

from zloam_monitor import cli_files, cli_loops, cli_maps, cli_robots, cli_runs, cli_views
from zloam_monitor.version import version

EPILOG = (
    "Exit codes: 0 all well; 2 a wrong command line or configuration; 3 a file can't be read or "
    "written, or a port is taken; 1 anything else."
)

app = typer.Typer(
    name="zloam",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=EPILOG,
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"zloam {version()}")
        raise typer.Exit


@app.callback()
def zloam(
    shown: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """LiDAR odometry and mapping over Eclipse Zenoh: run it, watch it, configure it."""


cli_runs.add(app)
cli_robots.add(app)
cli_loops.add(app)
cli_views.add(app)
cli_maps.add(app)
cli_files.add(app)


def _print_anything() -> None:
    """Names of files need not be text, nor need the terminal have a character: it is escaped."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code; failures are reported on standard error without a stack trace."""
    _print_anything()
    try:
        app(args=sys.argv[1:] if arguments is None else arguments, prog_name="zloam")
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else 0
    return 0


def entry() -> None:
    """Console script of the installed package."""
    sys.exit(main())
