"""The commands: demo, run, follow, watch, set, evaluate."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

from zloam_monitor import (
    demo,
    discovery,
    ending,
    evaluation,
    follow,
    live,
    ports,
    report,
    robot_files,
    se3,
    settings,
    sources,
    trajectory,
    watch,
)
from zloam_monitor.chain import BinariesMissing, ChainError, binary
from zloam_monitor.keys import Keys
from zloam_monitor.link import LinkError
from zloam_monitor.messages import SchemasMissing
from zloam_monitor.processes import StageDied
from zloam_monitor.robot_file import RobotFileError, names
from zloam_monitor.sources import Source, SourceError
from zloam_monitor.trajectory import TrajectoryError

#: a file could not be read or written, as with the stages
FILE_MISSING = 3

#: refused for a reason that the text names; not worth a trace
EXPECTED = (
    BinariesMissing,
    ChainError,
    LinkError,
    discovery.NothingAnswers,
    RobotFileError,
    SchemasMissing,
    SourceError,
    TrajectoryError,
)


def _chain_options(parser: argparse.ArgumentParser, out: str) -> None:
    parser.add_argument(
        "--preset-dir",
        type=Path,
        default=Path("build/release"),
        help="build folder with bin/ (default: %(default)s)",
    )
    parser.add_argument("--config", type=Path, help="robot file, deploy/robots/*.yaml")
    parser.add_argument(
        "--set",
        dest="settings",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="single value of the configuration; may be repeated",
    )
    parser.add_argument("--out", type=Path, default=Path(out), help="default: %(default)s")
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        help=f"where the stages listen: {ports.ANY_HOST} for other machines "
        "(default: zenoh.host, this machine only)",
    )


def _robot_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", help="its name (default: the only one that answers)")
    parser.add_argument(
        "--connect",
        nargs="+",
        default=[],
        metavar="ENDPOINT",
        help="e.g. tcp/192.168.1.5:7464 (default: robots of this machine)",
    )


def _demo_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("demo", help="replay a recording, or a simulated city loop")
    _chain_options(parser, "out/demo")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--pcap", type=Path, help="pcap or pcapng capture")
    source.add_argument("--bin", type=Path, help="bare payloads end to end")
    source.add_argument("--kitti", type=Path, help="KITTI folder (velodyne/*.bin or .tar.xz)")
    source.add_argument("--scans", type=Path, help="folder of scans with point times")
    parser.add_argument("--world", default="city", help="what is simulated without a recording")
    parser.add_argument("--seed", type=int, default=1, help="of the simulation")
    parser.add_argument(
        "--simulate",
        dest="extra",
        action="append",
        default=[],
        metavar="OPTION",
        help="further option of zloam-simulator; may be repeated",
    )
    parser.add_argument(
        "--imu",
        metavar="FILE",
        help="inertial readings of the recording's time (CSV, see services/driver/README.md); "
        f"without a recording: {sources.SIMULATED_IMU}",
    )
    parser.add_argument(
        "--truth",
        type=Path,
        nargs="+",
        default=None,
        help="TUM or KITTI poses of the sensor; default: beside the recording",
    )
    parser.add_argument(
        "--rate", default="max", help="max (as fast as acknowledged), realtime, or a factor"
    )
    parser.add_argument(
        "--set-at",
        action="append",
        default=[],
        metavar="SWEEP:KEY=VALUE",
        help="in force from that sweep on, as commanded by `set` while running; may be repeated",
    )
    parser.set_defaults(run=_demo)


def _source(args: argparse.Namespace) -> Source:
    recorded = args.pcap or args.bin or args.kitti or args.scans
    if args.imu == sources.SIMULATED_IMU and recorded:
        raise SourceError(f"--imu {sources.SIMULATED_IMU}: the recording's own are wanted, a file")
    if args.imu and args.imu != sources.SIMULATED_IMU:
        return sources.with_imu(_recording(args), Path(args.imu))
    return _recording(args)


def _recording(args: argparse.Namespace) -> Source:
    if args.pcap:
        return sources.from_pcap(args.pcap)
    if args.bin:
        return sources.from_bin(args.bin)
    if args.kitti:
        return sources.from_kitti(args.kitti, Path("out/unpacked"))
    if args.scans:
        return sources.from_scans(args.scans)
    print(f"simulating {args.world}, seed {args.seed}", flush=True)
    simulator = binary(args.preset_dir, "simulator")
    with_imu = args.imu == sources.SIMULATED_IMU
    return sources.simulated(simulator, args.out, args.world, args.seed, args.extra, with_imu)


def _demo(args: argparse.Namespace) -> int:
    source = _source(args)
    config = args.config or source.config
    robot = names(config, args.settings)
    options = demo.DemoOptions(
        build=args.preset_dir,
        out=args.out,
        source=source,
        config=config,
        robot=robot.robot,
        sensor=robot.sensor,
        rate=args.rate,
        settings=args.settings,
        truth=source.truth if args.truth is None else args.truth,
        set_at=args.set_at,
        ports=ports.configured(robot, args.listen),
    )
    for path in options.truth:
        trajectory.read(path)  # a wrong file is said before the run, not after
    return demo.finish(demo.run(options), args.out)


def _run(args: argparse.Namespace) -> int:
    config = args.config or Path("deploy/robots/vlp16-outdoor.yaml")
    robot = names(config, args.settings)
    found = live.run(
        live.LiveOptions(
            build=args.preset_dir,
            out=args.out,
            config=config,
            robot=robot.robot,
            sensor=robot.sensor,
            settings=args.settings,
            seconds=args.seconds,
            ports=ports.configured(robot, args.listen),
        )
    )
    print(report.table(found))
    print(f"files: {args.out}/")
    return report.exit_code(found)


def _watch(args: argparse.Namespace) -> int:
    with discovery.linked(args.robot, args.connect) as link:
        return watch.watch(link, args.seconds, args.every)


def _status(args: argparse.Namespace) -> int:
    with discovery.linked(args.robot, args.connect) as link:
        return watch.look(link)


def _robots(args: argparse.Namespace) -> int:
    found = discovery.robots(args.connect)
    if not found:
        discovery.choose(None, args.connect)
    print("\n".join(map(str, found)))
    return 0


def _set(args: argparse.Namespace) -> int:
    values = settings.pairs(args.values)
    with discovery.linked(args.robot, args.connect) as link:
        return settings.set_values(link, args.stage, values)


def _get(args: argparse.Namespace) -> int:
    with discovery.linked(args.robot, args.connect) as link:
        return settings.show(link, args.stage, args.key)


def _save(args: argparse.Namespace) -> int:
    with discovery.linked(args.robot, args.connect) as link:
        return settings.save(link, args.folder)


def _reset(args: argparse.Namespace) -> int:
    with discovery.linked(args.robot, args.connect) as link:
        return settings.reset(link, args.stages or ("odometry", "mapping"))


def _set_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("set", help="change a stage's configuration while it runs")
    parser.add_argument("stage")
    parser.add_argument("values", nargs="+", metavar="KEY=VALUE")
    _robot_options(parser)
    parser.set_defaults(run=_set)
    parser = commands.add_parser("get", help="the configuration in force")
    parser.add_argument("stage", nargs="?")
    parser.add_argument("key", nargs="?", help="a key, or what several begin with")
    _robot_options(parser)
    parser.set_defaults(run=_get)
    parser = commands.add_parser("save", help="map and trajectory, while the stages go on")
    parser.add_argument("folder", nargs="?", type=Path, help="default: where they are configured")
    _robot_options(parser)
    parser.set_defaults(run=_save)
    parser = commands.add_parser("reset", help="empty the map; the trajectory goes on")
    parser.add_argument("stages", nargs="*", metavar="STAGE", help="default: odometry mapping")
    _robot_options(parser)
    parser.set_defaults(run=_reset)
    parser = commands.add_parser(
        "robots", help="robots that answer on this machine, or at endpoints"
    )
    parser.add_argument("--connect", nargs="+", default=[], metavar="ENDPOINT")
    parser.set_defaults(run=_robots)
    parser = commands.add_parser("status", help="one look; exit code 1 when a stage is missing")
    _robot_options(parser)
    parser.set_defaults(run=_status)


def _follow(args: argparse.Namespace) -> int:
    options = follow.FollowOptions(
        keys=Keys(args.robot, args.sensor),
        connect=args.connect,
        out=args.out,
        title=args.title,
        truth=args.truth,
        ready_file=args.ready_file,
    )
    found = follow.follow(options)
    return report.exit_code(found)


def _follow_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser("follow", help="one run of stages that somebody else started")
    parser.add_argument("--robot", default="robot")
    parser.add_argument("--sensor", default="lidar")
    parser.add_argument("--connect", nargs="+", required=True, metavar="ENDPOINT")
    parser.add_argument("--out", type=Path, default=Path("out"), help="default: %(default)s")
    parser.add_argument("--truth", type=Path, nargs="+", default=[], help="poses of the sensor")
    parser.add_argument("--title", default="run", help="of the picture")
    parser.add_argument(
        "--ready-file", type=Path, help="is made when all stages were heard: the source may start"
    )
    parser.set_defaults(run=_follow)


def _score(value: float | str | None) -> float | str:
    return "–" if value is None else value if isinstance(value, str) else round(value, 4)


def _evaluate(args: argparse.Namespace) -> int:
    T_base_sensor = se3.from_xyz_rpy_deg(args.mounting[:3], args.mounting[3:])
    truth = trajectory.read(args.truth).carried(se3.inverse(T_base_sensor))
    scores = evaluation.evaluate(trajectory.read(args.trajectory), truth)
    for name, value in scores.as_dict().items():
        print(f"{name}: {_score(value)}")
    return 0 if scores.ate_rmse_m is not None else 1


def _robot_files(args: argparse.Namespace) -> int:
    stale = robot_files.refresh(args.preset_dir, args.folder, args.check)
    for path in stale:
        print(f"{path}: {'out of date' if args.check else 'written'}")
    return 1 if args.check and stale else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="zloam_monitor", description=__doc__)
    commands = parser.add_subparsers(required=True)
    _demo_parser(commands)
    run = commands.add_parser("run", help="the five stages on a live sensor")
    _chain_options(run, "out/run")
    run.add_argument("--seconds", type=float, help="end after so long (default: at Ctrl-C)")
    run.set_defaults(run=_run)
    look = commands.add_parser("watch", help="statuses and pose of a robot, as any third party")
    _robot_options(look)
    look.add_argument("--seconds", type=float)
    look.add_argument("--every", type=float, default=2.0, help="s between two looks")
    look.set_defaults(run=_watch)
    _set_parser(commands)
    _follow_parser(commands)
    score = commands.add_parser("evaluate", help="a trajectory file against a truth file")
    score.add_argument("trajectory", type=Path)
    score.add_argument("truth", type=Path)
    score.add_argument(
        "--mounting",
        type=float,
        nargs=6,
        default=[0.0] * 6,
        metavar=("X", "Y", "Z", "ROLL", "PITCH", "YAW"),
        help="pose of the truth's sensor in the trajectory's frame, m and deg",
    )
    score.set_defaults(run=_evaluate)
    files = commands.add_parser("robot-files", help="bring the comments of robot files up to date")
    files.add_argument("--preset-dir", type=Path, default=Path("build/release"))
    files.add_argument("--folder", type=Path, default=sources.ROBOTS)
    files.add_argument("--check", action="store_true", help="only say what is out of date")
    files.set_defaults(run=_robot_files)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 all well, 2 and 3 as the stages have them, 1 anything else."""
    args = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = args.run
    try:
        with ending.handled(ending.raised):
            return command(args)
    except StageDied as died:
        print(f"\n{died}", file=sys.stderr)
        return died.code if died.code in (2, 3) else 1
    except ports.PortTaken as error:
        print(f"\n{error}", file=sys.stderr)
        return FILE_MISSING
    except EXPECTED as error:
        print(f"\n{error}", file=sys.stderr)
        return 1
    except ending.EndAsked as asked:
        print(f"\nended by {asked}", file=sys.stderr)
        return ending.SIGNAL_CODE + asked.number
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        print(f"\ncannot be read or written: {error}", file=sys.stderr)
        return FILE_MISSING
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return 130
