"""Commands evaluate, config, recording, metadata, robot-files, and the stages' own programs."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from zloam_monitor import cli_common as common
from zloam_monitor.cli_common import command, examples
from zloam_monitor.failures import Explained, Misuse
from zloam_monitor.stages import ROWS

#: Programs that parse their own options.
PROGRAMS = (
    *((row.name, row.summary) for row in ROWS.values()),
    ("decode", "Decodes a capture to points, without the stages."),
    ("calibrate", "Estimates a scanner's pose on its motor from a session at rest."),
)


def _score(value: float | str | None) -> float | str:
    return "–" if value is None else value if isinstance(value, str) else round(value, 4)


def _check(mounting: tuple[float, ...], plot: Path | None) -> None:
    """Refuses values of evaluate's options before its work."""
    if plot is not None and plot.suffix.lower() != ".png":
        raise Misuse(f"--plot: {plot}: .png is expected")
    if not all(map(math.isfinite, mounting)):
        raise Misuse("--mounting: finite numbers are expected")


@command
def evaluate(
    estimate: Annotated[
        Path, typer.Argument(metavar="TRAJECTORY", help="TUM or KITTI file to evaluate.")
    ],
    truth: Annotated[Path, typer.Argument(help="TUM or KITTI file of the reference.")],
    mounting: Annotated[
        tuple[float, float, float, float, float, float],
        typer.Option(
            metavar="X Y Z ROLL PITCH YAW",
            help="Pose of the reference's sensor in the frame of the trajectory, m and deg.",
        ),
    ] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw both paths and the errors (.png).")
    ] = None,
    as_json: common.Json = False,
) -> int:
    """Compute the errors of a trajectory against a reference."""
    from zloam_monitor import answers, evaluation, se3, trajectory

    _check(mounting, plot)
    T_base_sensor = se3.from_xyz_rpy_deg(mounting[:3], mounting[3:])
    of_sensor, of_estimate = trajectory.read(truth), trajectory.read(estimate)
    for path, found in ((estimate, of_estimate), (truth, of_sensor)):
        for remark in trajectory.remarks(path, found):
            common.said(remark)
    if reason := evaluation.not_joinable(of_estimate, of_sensor):
        raise Explained(
            f"{estimate}, {truth}: a file without times (KITTI) is joined line by line, but "
            f"{reason}: give both with times (TUM)"
        )
    of_base = of_sensor.carried(se3.inverse(T_base_sensor))
    compared = evaluation.compare(of_estimate, of_base)
    scores = evaluation.scores_of(compared, of_estimate, of_base).as_dict()
    answers.give(as_json, scores, (f"{name}: {_score(value)}" for name, value in scores.items()))
    if plot is not None and compared is not None:
        from zloam_monitor import picture

        picture.draw_errors(plot, f"{estimate} against {truth}", compared)
        common.said(f"{plot}: written")
    return 0 if scores["ate_rmse_m"] is not None else 1


@command
def refresh_robot_files(
    folder: Annotated[
        Path | None, typer.Option(help="Folder of the robot files. Default: deploy/robots.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Only report what is out of date.")
    ] = False,
    preset_dir: common.PresetDir = None,
) -> int:
    """Update REFERENCE.md and schema.json of the robot files."""
    from zloam_monitor import places
    from zloam_monitor import robot_files as files

    stale = files.refresh(common.kept(preset_dir), folder or places.robots(), check)
    for path in stale:
        print(f"{path}: {'out of date' if check else 'written'}")
    return 1 if check and stale else 0


config = typer.Typer(
    no_args_is_help=True, help="Check a robot's file, or print the schema that editors use."
)


@command
def config_check(
    file: Annotated[
        Path,
        typer.Argument(
            parser=common.robot_path,
            metavar="FILE",
            help="A robot's file, or the name of a file in deploy/robots.",
            autocompletion=common.robot_names,
        ),
    ],
    settings: common.Settings = None,
    preset_dir: common.PresetDir = None,
    as_json: common.Json = False,
) -> int:
    """Let all stages check a robot's file, and list the values that are not the default."""
    from zloam_monitor import answers
    from zloam_monitor import config_check as checker
    from zloam_monitor import robot_files as files

    build = common.kept(preset_dir)
    verdict = checker.check(build, file, settings or [])
    if verdict.refusals:
        if as_json:
            print(answers.text({"accepted": False, "refusals": verdict.refusals}))
        for refusal in verdict.refusals:
            common.said(refusal)
        return 2
    said = files.described(build)
    changed = {k: v for k, v in verdict.values.items() if k in said and v != said[k]["default"]}
    lines = [
        f"  {key}: {value}   [{said[key]['allowed']}; default {said[key]['default']}]"
        for key, value in sorted(changed.items())
    ]
    head = f"{file}: accepted by all stages; {len(changed)} values are not the default"
    answers.give(as_json, {"accepted": True, "not_default": changed}, [head, *lines])
    return 0


@command
def config_schema(preset_dir: common.PresetDir = None) -> int:
    """Print the JSON Schema of robot files (deploy/robots/schema.json)."""
    from zloam_monitor import robot_files as files

    print(files.schema_text(common.kept(preset_dir)), end="")
    return 0


@command
def recording(
    file: Annotated[Path, typer.Argument(metavar="BAG", help="Bag or MCAP file.")],
    topic: Annotated[str, typer.Option(help="Topic of the clouds or packets, if several.")] = "",
    time_field: common.TimeField = "",
    time_model: common.TimeModel = "none",
    period_s: common.PeriodS = 0.1,
    seam_deg: common.SeamDeg = 180.0,
    imu: Annotated[bool, typer.Option("--imu", help="Include IMU readings.")] = False,
    imu_topic: Annotated[str, typer.Option(help="Topic of the IMU readings, if several.")] = "",
    stream: Annotated[
        bool, typer.Option("--stream", help="Write its sweeps to standard output, for the driver.")
    ] = False,
) -> int:
    """List the topics or clouds of a bag or folder, and how the driver would read them."""
    from zloam_monitor import recordings, sources
    from zloam_monitor.recordings import stream as frames
    from zloam_monitor.recordings.sweeps import Timing

    timing = Timing(time_model, period_s, seam_deg, time_field)
    try:
        if stream:
            wanted = imu_topic if imu else None
            return frames.write(file, topic, timing, sys.stdout.buffer, wanted)
        for line in frames.described(file, topic, timing):
            print(line)
    except recordings.Refused as refused:
        raise sources.SourceError(f"{file}: {refused}") from refused
    return 0


@command
def metadata(
    host: Annotated[str, typer.Argument(help="Name or address of the sensor.")],
    file: Annotated[Path, typer.Argument(help="File to write, for driver.metadata.")],
) -> int:
    """Fetch a sensor's description of its beams and packets (Ouster), for driver.metadata."""
    import json

    from zloam_monitor import files, sensor_metadata

    found = sensor_metadata.fetched(host)
    with files.written_whole(file) as out:
        json.dump(found, out, indent=1)
    info = found.get("sensor_info")
    print(f"{file}: {info.get('prod_line', 'a sensor') if isinstance(info, dict) else 'a sensor'}")
    return 0


def _program(app: typer.Typer, name: str, about: str) -> None:
    @command
    def run(context: typer.Context, preset_dir: common.PresetDir = None) -> int:
        from zloam_monitor.chain import binary

        path = binary(common.kept(preset_dir), name)
        os.execv(path, [str(path), *context.args])

    app.command(
        name,
        help=about,
        add_help_option=False,
        context_settings=common.options(),
        rich_help_panel=common.PROGRAMS,
    )(run)


def add(app: typer.Typer) -> None:
    """Adds the commands under their headings."""
    app.command(
        rich_help_panel=common.FILES,
        epilog=examples(
            "zloam evaluate out/demo/trajectory.tum out/demo/ground_truth.tum",
            "zloam evaluate drive.tum truth.tum --plot errors.png --json",
        ),
    )(evaluate)
    app.command(
        rich_help_panel=common.FILES, epilog=examples("zloam recording drive.mcap --topic /points")
    )(recording)
    app.command(
        rich_help_panel=common.FILES,
        epilog=examples("zloam metadata os-122201000998.local os.json"),
    )(metadata)
    config.command("check", epilog=examples("zloam config check my.yaml"))(config_check)
    config.command("schema", epilog=examples("zloam config schema > schema.json"))(config_schema)
    app.add_typer(config, name="config", rich_help_panel=common.FILES)
    app.command("robot-files", rich_help_panel=common.FILES, hidden=True)(refresh_robot_files)
    for name, about in PROGRAMS:
        _program(app, name, about)
