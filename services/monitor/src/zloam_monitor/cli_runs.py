"""Commands demo, run, follow and ros-lidar: they start a robot, or accompany one run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zloam_monitor import cli_common as common
from zloam_monitor.cli_common import command, examples
from zloam_monitor.failures import Misuse

if TYPE_CHECKING:
    from zloam_monitor.sources import Source

SIMULATED_IMU = "simulated"
#: Options of demo that name a recording.
RECORDED = ("pcap", "bin", "kitti", "scans", "bag", "session")
#: Values of driver.source that are recordings -> the option of demo.
REPLAYED_BY = {
    **{name: name for name in ("pcap", "bin", "kitti", "scans")},
    "recording": "bag",
    "scip_log": "session",
}
#: Default worlds of the simulator, for the VLP-16 and for the Hokuyo.
CITY, INDOOR = "city", "indoor"


@dataclass(frozen=True)
class _Recorded:
    """The recording to replay, at most one; without one the simulator makes it."""

    pcap: Path | None
    bin: Path | None
    kitti: Path | None
    scans: Path | None
    bag: Path | None
    session: Path | None
    imu: str | None
    settings: list[str]
    config: Path | None

    def source(self) -> Source | None:
        from zloam_monitor import sources

        named = [name for name in RECORDED if getattr(self, name)]
        if len(named) > 1:
            raise Misuse(f"only one of --{' and --'.join(named)} can be replayed")
        if named and self.imu == SIMULATED_IMU:
            raise Misuse(f"--imu {SIMULATED_IMU}: the recording's own are wanted, a file")
        if self.pcap:
            return sources.from_pcap(self.pcap)
        if self.bin:
            return sources.from_bin(self.bin)
        if self.kitti:
            return sources.from_kitti(self.kitti, Path("out/unpacked"))
        if self.session:
            return sources.from_session(self.session)
        if self.bag:
            return sources.from_bag(self.bag, self.settings, self.config)
        return sources.from_scans(self.scans) if self.scans else None


@command
def demo(
    pcap: Annotated[Path | None, typer.Option(help="Capture, pcap or pcapng.")] = None,
    bin: Annotated[
        Path | None, typer.Option(help="File of bare packet payloads, one after the other.")
    ] = None,
    kitti: Annotated[
        Path | None, typer.Option(help="KITTI folder: velodyne/*.bin or velodyne.tar.xz.")
    ] = None,
    scans: Annotated[Path | None, typer.Option(help="Folder of scans with point times.")] = None,
    bag: Annotated[
        Path | None,
        typer.Option(
            help="Bag of ROS 1 or 2, or MCAP file, with clouds (PointCloud2) or packets; or folder "
            "of PCD, PLY, LAS or LAZ files, one per sweep."
        ),
    ] = None,
    topic: Annotated[str, typer.Option(help="Topic of a bag, if several have clouds.")] = "",
    session: Annotated[
        Path | None,
        typer.Option(
            help="Recorded session of a Hokuyo scanner on a motor: its replies as received, with "
            "the motor's angles in the .csv beside it."
        ),
    ] = None,
    hokuyo: Annotated[
        bool,
        typer.Option(
            "--hokuyo", help="Simulate a Hokuyo scanner on a motor instead of the VLP-16."
        ),
    ] = False,
    world: Annotated[
        str,
        typer.Option(
            help=f"World to simulate without a recording. Default: {CITY}; --hokuyo: {INDOOR}."
        ),
    ] = "",
    seed: Annotated[int, typer.Option(help="Seed of the simulation.")] = 1,
    simulate: Annotated[
        list[str] | None,
        typer.Option(metavar="OPTION", help="Further option of zloam-simulator; may be repeated."),
    ] = None,
    imu: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="IMU readings for the time of the recording (CSV, services/driver/README.md); "
            f"without a recording: {SIMULATED_IMU}.",
        ),
    ] = None,
    truth: Annotated[
        list[Path] | None,
        typer.Option(
            help="Reference: TUM or KITTI poses of the sensor; may be repeated. Default: the file "
            "beside the recording."
        ),
    ] = None,
    rate: Annotated[
        str,
        typer.Option(
            help="Pace: max (as fast as acknowledged), realtime, or a factor. Default: max; with "
            "--view realtime."
        ),
    ] = "",
    view: Annotated[
        bool,
        typer.Option("--view", help="Show the run on a page; write run.mcap and run.rrd, too."),
    ] = False,
    config: common.Config = None,
    settings: common.Settings = None,
    set_at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SWEEP:KEY=VALUE",
            help="Change a parameter from this sweep on, as `zloam set` does; may be repeated.",
        ),
    ] = None,
    method: common.Method = "",
    graph: common.Graph = False,
    map: common.Map = None,
    localize: common.Localize = False,
    extend: common.Extend = False,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("out/demo"),
    record: common.Record = None,
    listen: common.Listen = None,
    preset_dir: common.PresetDir = None,
    many_settings: common.ManySettings = "",
    many_settings_at: common.ManySettingsAt = "",
    truths: common.ManyFiles = "",
) -> int:
    """Replay a recording, or a simulated drive round a city block, through all stages."""
    from zloam_monitor import beside_run, methods, ports, sources, trajectory
    from zloam_monitor import demo as runner
    from zloam_monitor.beside_stages import Beside
    from zloam_monitor.chain import binary
    from zloam_monitor.robot_file import names
    from zloam_monitor.settings import existing_files, several

    beside = Beside(graph, map, localize, extend, methods.programs(method))
    settings = [*beside.settings(), *(settings or []), *several(many_settings)]
    truth = [*(truth or []), *existing_files(truths)] or None
    programs = methods.programs(method)
    if topic:
        settings.append(f"driver.topic={topic}")
    source = _Recorded(pcap, bin, kitti, scans, bag, session, imu, settings, config).source()
    if hokuyo and source is not None:
        raise Misuse("--hokuyo simulates a scanner: it goes with no recording")
    build = common.kept(preset_dir)
    binary(build, "driver")
    if source is None:
        world = world or (INDOOR if hokuyo else CITY)
        with_imu = imu == SIMULATED_IMU
        simulator = binary(build, "simulator")
        source = sources.simulated(simulator, out, world, seed, simulate or [], with_imu, hokuyo)
    if imu and imu != SIMULATED_IMU:
        source = sources.with_imu(source, Path(imu))
    robot = names(config or source.config, settings)
    options = runner.DemoOptions(
        build=build,
        out=out,
        source=source,
        config=config or source.config,
        robot=robot.robot,
        sensor=robot.sensor,
        rate=rate or ("realtime" if view else "max"),
        settings=settings,
        truth=source.truth if truth is None else truth,
        set_at=[*source.changes, *(set_at or []), *several(many_settings_at)],
        ports=ports.configured(robot, listen, beside.stages()),
        programs=programs,
        record=record or (out / beside_run.MCAP if view else None),
        view=view,
        beside=beside.stages(),
    )
    for path in source.there(options.truth):
        trajectory.read(path)  # Reports a bad file before the run instead of after it.
    return runner.finish(runner.run(options), out)


@command
def run(
    config: common.Config = None,
    settings: common.Settings = None,
    method: common.Method = "",
    graph: common.Graph = False,
    map: common.Map = None,
    localize: common.Localize = False,
    extend: common.Extend = False,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("out/run"),
    record: common.Record = None,
    standby: Annotated[
        bool,
        typer.Option(
            "--standby",
            help="Start a second instance of each stage except the driver. It takes over within "
            "half a second when the first one dies, so that every sweep has a pose.",
        ),
    ] = False,
    listen: common.Listen = None,
    seconds: common.ForSeconds = None,
    preset_dir: common.PresetDir = None,
    many_settings: common.ManySettings = "",
) -> int:
    """Run the stages on a live sensor until Ctrl-C, then write trajectory and map."""
    from zloam_monitor import live, methods, places, ports, report, terminal
    from zloam_monitor.beside_stages import Beside
    from zloam_monitor.robot_file import driver_values, names
    from zloam_monitor.settings import several

    beside = Beside(graph, map, localize, extend, methods.programs(method))
    settings = [*beside.settings(), *(settings or []), *several(many_settings)]
    file = config or places.robot_file("vlp16-outdoor")
    robot = names(file, settings)
    _check_live(driver_values(file, settings).get("driver.source", ""))
    found = live.run(
        live.LiveOptions(
            build=common.kept(preset_dir),
            out=out,
            config=file,
            robot=robot.robot,
            sensor=robot.sensor,
            settings=settings,
            seconds=seconds,
            ports=ports.configured(robot, listen, beside.stages()),
            programs=methods.programs(method),
            record=record,
            standby=standby,
            beside=beside.stages(),
        )
    )
    terminal.last_words(f"{report.table(found)}\nfiles: {out}/")
    return report.exit_code(found)


def _check_live(source: str) -> None:
    """A recording ends, and a live run would start its driver again and again."""
    if option := REPLAYED_BY.get(source):
        raise Misuse(
            f"driver.source is {source}, a recording: `zloam run` is for a live sensor, and "
            f"`zloam demo --{option} PATH` replays"
        )


@command
def follow(
    connect: common.Connect = None,
    config: common.Config = None,
    settings: common.Settings = None,
    robot: Annotated[
        str | None, typer.Option(help="The robot's name. Default: that of the robot's file.")
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(help="The lidar's name. Default: that of the robot's file.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("out"),
    truth: Annotated[
        list[Path] | None, typer.Option(help="Reference: poses of the sensor; may be repeated.")
    ] = None,
    title: Annotated[str, typer.Option(help="Title of the picture.")] = "run",
    ready_file: Annotated[
        Path | None,
        typer.Option(help="File to create when all stages answer, so that the source may start."),
    ] = None,
    ended_file: Annotated[
        Path | None,
        typer.Option(
            help="File to create at the end, which makes other processes end; the table is printed "
            "after them."
        ),
    ] = None,
    patience: Annotated[
        float | None,
        typer.Option(
            help="Longest time from then until the first pose, s. Default: no limit.",
            callback=common.positive,
        ),
    ] = None,
    many_settings: common.ManySettings = "",
) -> int:
    """Follow one run of stages that were started elsewhere, and write picture and report."""
    from zloam_monitor import discovery, places, report, robot_file
    from zloam_monitor import follow as follower
    from zloam_monitor.keys import Keys
    from zloam_monitor.settings import several

    with follower.others_end(ended_file):
        file = config or places.robot_file("vlp16-outdoor")
        names = robot_file.names(file, [*(settings or []), *several(many_settings)])
        keys = Keys(
            names.robot if robot is None else robot,
            names.sensor if sensor is None else sensor,
        )
        endpoints = [discovery.endpoint_of(each) for each in common.endpoints(connect)]
        options = follower.FollowOptions(
            keys=keys,
            connect=endpoints or discovery.candidates(),
            out=out,
            title=title,
            truth=truth or [],
            ready_file=ready_file,
            ended_file=ended_file,
            patience_s=patience,
        )
    return report.exit_code(follower.follow(options))


@command
def ros_lidar(
    topic: Annotated[
        str, typer.Argument(help="Topic of sensor_msgs/msg/PointCloud2, e.g. /points.")
    ],
    config: common.Config = None,
    connect: common.Connect = None,
    ros: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="Router of the ROS nodes (rmw_zenohd)."),
    ] = None,
    domain: Annotated[int, typer.Option(envvar="ROS_DOMAIN_ID", help="ROS_DOMAIN_ID.")] = 0,
    distro: Annotated[
        str, typer.Option(envvar="ROS_DISTRO", help="Distribution of the ROS nodes.")
    ] = "jazzy",
    time_field: common.TimeField = "",
    time_model: common.TimeModel = "none",
    period_s: common.PeriodS = 0.1,
    seam_deg: common.SeamDeg = 180.0,
) -> int:
    """Use a point cloud topic of a ROS 2 system (rmw_zenoh) as the robot's lidar, instead of the
    driver."""
    from zloam_monitor import discovery, places, recordings, robot_file, ros_lidar, sources
    from zloam_monitor.keys import Keys
    from zloam_monitor.recordings.sweeps import Timing

    if distro not in ros_lidar.DISTROS:
        raise Misuse(f"--distro {distro}: one of {', '.join(ros_lidar.DISTROS)}")
    if not topic.startswith("/"):
        raise Misuse(f"{topic}: a topic begins with '/'")
    robot = robot_file.names(config or places.robot_file("vlp16-outdoor"), [])
    stages = [discovery.endpoint_of(each) for each in common.endpoints(connect)]
    try:
        options = ros_lidar.Options(
            topic=topic,
            ros=ros or ["tcp/127.0.0.1:7447"],
            connect=stages or discovery.candidates(),
            keys=Keys(robot.robot, robot.sensor),
            timing=Timing(time_model, period_s, seam_deg, time_field),
            domain=domain,
            distro=distro,
        )
        return ros_lidar.run(options)
    except recordings.Refused as refused:
        raise sources.SourceError(f"{topic}: {refused}") from refused


def add(app: typer.Typer) -> None:
    """Adds the commands under their heading."""
    app.command(
        rich_help_panel=common.RUNS,
        epilog=examples(
            "zloam demo",
            "zloam demo --pcap drive.pcap --set driver.model=VLP-16",
            "zloam demo --bag drive.mcap --topic /points",
            "zloam demo --kitti 2011_09_26_drive_0001 --truth poses.txt",
            "zloam demo --world tunnel --imu simulated --rate realtime",
        ),
    )(demo)
    app.command(
        rich_help_panel=common.RUNS,
        epilog=examples(
            "zloam run --config vlp16-indoor", "zloam run --config my.yaml --listen 0.0.0.0"
        ),
    )(run)
    app.command(
        rich_help_panel=common.RUNS,
        epilog=examples("zloam follow --connect tcp/robot:7464 --out drive"),
    )(follow)
    app.command(
        "ros-lidar",
        rich_help_panel=common.RUNS,
        epilog=examples(
            "zloam ros-lidar /velodyne_points",
            "zloam ros-lidar /points --ros tcp/10.0.0.5:7447 --time-field t",
        ),
    )(ros_lidar)
