"""Results of a live run: files of each run, counters that add up, saves confined to their folder
(issue 37, 12, 14 and 21)."""

from __future__ import annotations

import json
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.acceptance.live import free_udp_port
from tests.integration.conftest import PATIENCE_S, Capture, kill, monitor, simulate
from tests.integration.live_run import SPARE_S, LiveRun, one_quick
from zloam_monitor import clouds, messages, methods, report
from zloam_monitor.clouds import POINT_LAYERS, Tile
from zloam_monitor.records import PoseRecord
from zloam_monitor.report import Run
from zloam_monitor.trajectory import read

SECONDS = 12.0
BEGINS_AT = 25
#: longer than the gap (3 s) after which mapping still searches the old map
AWAY_S = 4.5
HANG_S, HANGS = 1.2, 3
TRAJECTORIES = ("trajectory.tum", "trajectory.kitti", "odometry.tum")
THEIRS = "notes of somebody"
#: without a method, and A-LOAM's programs
METHODS = ("", "aloam")


@dataclass(frozen=True)
class Left:
    """Results of a live drive during which the driver was away for a while."""

    out: Path
    #: of each run, in order of arrival
    poses: list[list[PoseRecord]]
    #: path -> reply to the command `save` with this path
    saves: dict[str, Any]
    #: names beside the output folder after all saves
    outside: set[str]
    #: mapping's tiles without their points, and those that it has later
    heads: list[Tile]
    tiles: list[Tile]


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder = tmp_path_factory.mktemp("drive")
    seconds = str(SECONDS + SPARE_S)
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", seconds)


def save(run: LiveRun, stage: str, path: str) -> Any:
    key = run.chain.link.keys.command(stage, "save")
    (answer,) = run.chain.link.session.get(key, payload=json.dumps({"path": path}), timeout=5.0)
    return messages.decode("CommandReply", answer.ok.payload.to_bytes())


def try_saves(run: LiveRun, out: Path) -> dict[str, Any]:
    """Saves below the folder, outside of it in every possible way, and over another owner's
    files."""
    (out / "theirs").mkdir()
    for name in ("map.pcd", "trajectory.tum"):
        (out / "theirs" / name).write_text(THEIRS)
    (out / "link").symlink_to(out.parent / "elsewhere")
    (out.parent / "elsewhere").mkdir()
    outside = str(out.parent / "outside")
    folders = ("saved", "theirs", "link", "../outside", outside)
    found = {f"integration {folder}": save(run, "integration", folder) for folder in folders}
    return found | {f"mapping {f}": save(run, "mapping", f"{f}/map.pcd") for f in folders}


def programs_of(build: Path, method: str) -> dict[str, str]:
    chosen = methods.programs(method)
    if not all((build / "bin" / f"zloam-{program}").is_file() for program in chosen.values()):
        pytest.skip(f"{method} is not built in {build}")
    return chosen


@pytest.fixture(scope="module", params=METHODS)
def left(
    build: Path,
    robot_file: Path,
    drive: Capture,
    tmp_path_factory: pytest.TempPathFactory,
    request: pytest.FixtureRequest,
) -> Left:
    programs = programs_of(build, request.param)
    out = tmp_path_factory.mktemp("lived") / "out"
    out.mkdir()
    run = LiveRun(
        *(build, robot_file, drive, out),
        store=False,
        slower=1.0,
        seconds=SECONDS,
        programs=programs,
    )
    with run:
        run.until_poses(BEGINS_AT)
        saves = try_saves(run, out)
        kill(run.chain, "driver")
        time.sleep(AWAY_S)
        run.chain.start("driver", "driver-again")
        run.until_runs(2)
        link = run.chain.link
        heads = [
            h for each in POINT_LAYERS for h in link.tiles_at(f"{link.keys.tiles_of(each)}?heads")
        ]
        tiles = link.query_tiles()
        run.end()
    runs = dict.fromkeys(r for r, _ in run.poses)
    poses = [[p for (r, _), p in run.poses.items() if r == each] for each in runs]
    outside = {
        str(p.relative_to(out.parent)) for p in out.parent.rglob("*") if out not in p.parents
    }
    return Left(out, poses, saves, outside, heads, tiles)


def test_each_run_has_its_own_files(left: Left) -> None:
    """Each run's trajectory is complete; the second run overwrites none of the first one's
    poses."""
    first, second = left.poses
    assert len(first) >= BEGINS_AT
    for suffix, poses in (("", first), ("_2", second)):
        written = read(left.out / f"trajectory{suffix}.tum")
        assert written.stamps_ns is not None
        assert {p.instant_ns for p in poses} <= set(written.stamps_ns.tolist())
        assert len(clouds.read_pcd(left.out / f"map{suffix}.pcd")) > 0
        assert (left.out / f"odometry{suffix}.tum").exists()
    assert not list(left.out.glob("*_3.*"))


def test_mapping_tells_its_tiles_without_their_points(left: Left) -> None:
    newest = {(tile.map_id, tile.layer, tile.index): tile for tile in left.tiles}
    assert sum(len(tile.points) for tile in left.tiles) > 1000
    assert left.heads
    for head in left.heads:
        assert not len(head.points)
        # The map goes on between the two questions.
        assert newest[head.map_id, head.layer, head.index].version >= head.version


@pytest.mark.parametrize("stage", ["integration", "mapping"])
def test_a_save_stays_below_the_folder(left: Left, stage: str) -> None:
    names = TRAJECTORIES if stage == "integration" else ("map.pcd",)
    replies = {path: reply for path, reply in left.saves.items() if path.startswith(stage)}
    answered = {path: messages.text(reply.Message()) for path, reply in replies.items()}
    refused = {path for path, reply in replies.items() if not reply.Ok()}
    assert refused == replies.keys() - {f"{stage} saved"}, answered
    assert all(answered.values())
    assert all((left.out / "saved" / name).stat().st_size > 0 for name in names)


def test_a_save_leaves_what_is_others_alone(left: Left) -> None:
    theirs = {path.name: path.read_text() for path in (left.out / "theirs").iterdir()}
    assert theirs == {"map.pcd": THEIRS, "trajectory.tum": THEIRS}
    assert left.outside == {"elsewhere", "out"}


@pytest.mark.parametrize("method", METHODS)
def test_a_lost_map_is_in_the_exit_code(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, method: str
) -> None:
    """The first run's map can't be written before the second run begins; the second one's can."""
    programs = programs_of(build, method)
    maps = tmp_path / "maps"
    maps.write_text("not a folder")
    more = (f"mapping.map_path={maps / 'map.pcd'}",)
    run = LiveRun(
        *(build, robot_file, drive, tmp_path),
        store=False,
        seconds=SECONDS,
        more=more,
        programs=programs,
    )
    with run:
        run.until_poses(BEGINS_AT)
        kill(run.chain, "driver")
        time.sleep(AWAY_S)
        run.chain.start("driver", "driver-again")
        run.until_runs(2)
        maps.unlink()
        codes = run.chain.stop()
    assert {stage: code for stage, code in codes.items() if code} == {"mapping": 3}
    assert len(clouds.read_pcd(maps / "map.pcd")) > 0


@pytest.mark.parametrize("stage", one_quick(("registration", "odometry", "mapping"), "mapping"))
def test_accounts_add_up_under_overload(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, stage: str
) -> None:
    """A stage that is repeatedly stopped: sweeps are dropped, and each is counted once."""
    run = LiveRun(build, robot_file, drive, tmp_path, store=False, slower=1.0, seconds=SECONDS)
    with run:
        run.until_poses(BEGINS_AT)
        for _ in range(HANGS):
            process = run.chain.processes.running[stage]
            process.send(signal.SIGSTOP)
            time.sleep(HANG_S)
            process.send(signal.SIGCONT)
            run.until_poses_or_end(len(run.poses) + 5)
        statuses = run.end()
    found = report.build(Run.heard(run.chain.link, 1.0, run.chain.exit_codes))
    identities = found["identities"]
    assert identities["complaints"] == []
    assert report.accounted(found)
    assert sum(i.dropped.get("queue_full", 0) + i.lost for i in statuses[stage].inputs) > 0
    # Odometry queries what it missed, and sweeps that mapping skips lose no pose.
    assert identities["given_up"] or stage != "registration"


def test_a_run_without_data_says_that_none_came(build: Path, robot_file: Path) -> None:
    port = free_udp_port()
    done = monitor(
        *("run", "--preset-dir", build, "--config", robot_file, "--out", Path.cwd() / "out"),
        *("--seconds", "2", "--set", f"driver.port={port}"),
    )
    assert done.code == 1
    assert "accounted for: NO: no sweep came: there is nothing to account for" in done.said
    assert not list((Path.cwd() / "out").glob("*.tum"))
    assert not (Path.cwd() / "out" / "map.pcd").exists()


def test_a_place_told_before_the_first_sweep_holds(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    """As in RViz, where the pose is often given before the drive begins."""
    told, place = threading.Event(), {"x_m": 12.0, "y_m": -3.5, "yaw_deg": 90.0}

    def once_told(_: float, payload: bytes) -> bytes | None:
        told.wait(PATIENCE_S)
        return payload

    run = LiveRun(build, robot_file, drive, tmp_path, store=False, change=once_told)
    with run:
        reply = run.chain.link.command("mapping", "place", place)
        told.set()
        assert reply is not None
        assert reply.ok, reply.message
        run.until_poses(5)
        run.end()
    first = run.mapped[min(run.mapped)]
    assert np.allclose(first.translation, (12.0, -3.5, 0.0), atol=0.5)
    assert np.allclose(np.abs(first.quaternion[2:]), np.sqrt(0.5), atol=0.05)
    # Both signs are the same rotation; z and w of different signs are a turn to the right.
    assert first.quaternion[2] * first.quaternion[3] > 0.0


def test_data_without_sweeps_are_told_only_while_data_come(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path
) -> None:
    said = threading.Event()

    def cut_short(seconds: float, payload: bytes) -> bytes | None:
        if said.is_set():
            return None
        return payload if seconds < 2.0 else payload[:1000]

    run = LiveRun(build, robot_file, drive, tmp_path, store=False, change=cut_short)

    def reason() -> str:
        status = run.chain.link.stage("driver")
        return status.reason if status is not None else ""

    with run:
        run._until(lambda: "but no sweep for" in reason())
        said.set()
        run._until(lambda: "no packets on" in reason() and "but no sweep for" not in reason())
