"""Mapping is killed in a live run. Without a tile store what it had mapped is lost: the map that
follows is another one for every reader, and mapping says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.integration.conftest import Capture, simulate
from tests.integration.live_run import IN_MAP, KILL_AT, SECONDS, SPARE_S, LiveRun, one_quick
from zloam_monitor import messages
from zloam_monitor.methods import programs

#: without a method, and A-LOAM's programs
METHODS = ("", "aloam")
IN_ITS_FRAME = "is lost: no store has it; a new one begins in its frame"


@pytest.fixture(scope="module")
def drive(build: Path, tmp_path_factory: pytest.TempPathFactory) -> Capture:
    folder, seconds = tmp_path_factory.mktemp("drive"), str(SECONDS + SPARE_S)
    return simulate(build, folder, "--world", "city", "--seed", "3", "--duration", seconds)


def programs_of(build: Path, method: str) -> dict[str, str]:
    found = programs(method) if method else {}
    if any(not (build / "bin" / f"zloam-{each}").is_file() for each in found.values()):
        pytest.skip(f"not built in {build}: {method}")
    return found


def said_of_map(run: LiveRun) -> str:
    """Mapping's reason for being degraded, if it speaks of a lost map or frame."""
    return next((reason for reason in run.reasons() if "lost: " in reason), "")


def path_ns(run: LiveRun) -> npt.NDArray[np.int64]:
    """Instants of the poses that mapping has of its map."""
    answer = next(iter(run.chain.link.get(run.chain.link.keys.path_map)))
    path = messages.decode("Path", answer)
    poses = messages.struct_vector(path, "Poses", messages.STAMPED_POSE)
    return np.asarray(poses["instant_ns"], dtype=np.int64)


def killed(run: LiveRun, *stages: str) -> tuple[str, list[int]]:
    """A whole run in which the stages are killed once; returns what mapping says of the map, and
    the ids of its maps in the order of their coming."""
    with run:
        run.until_poses(KILL_AT)
        run.restart(*stages)
        run._until(lambda: bool(said_of_map(run)))
        said, mapped = said_of_map(run), len(run.mapped)
        run._until(lambda: len(run.mapped) >= mapped + IN_MAP)
        run.end()
    return said, list(dict.fromkeys(pose.map_id for pose in run.mapped.values()))


@pytest.mark.parametrize("method", one_quick(METHODS, ""))
def test_the_next_map_has_another_name_and_the_same_frame(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, method: str
) -> None:
    """Under the same name, viewers would show tiles of the lost map in the new one."""
    of_method = programs_of(build, method)
    run = LiveRun(build, robot_file, drive, tmp_path, store=False, programs=of_method)
    said, (lost, new) = killed(run, "mapping")
    assert IN_ITS_FRAME in said
    assert new > lost


@pytest.mark.parametrize("method", one_quick(METHODS, ""))
def test_without_integration_the_frame_is_lost_too(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, method: str
) -> None:
    of_method = programs_of(build, method)
    run = LiveRun(build, robot_file, drive, tmp_path, store=False, programs=of_method)
    said, (lost, new) = killed(run, "mapping", "integration")
    assert "and its frame are lost" in said
    assert new > lost


@pytest.mark.parametrize("method", one_quick(METHODS, ""))
def test_the_store_has_map_and_frame_without_integration(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, method: str
) -> None:
    run = LiveRun(build, robot_file, drive, tmp_path, programs=programs_of(build, method))
    with run:
        run.until_poses(KILL_AT)
        run.restart("mapping", "integration")
        log = tmp_path / "mapping-again.log"
        run._until(lambda: log.is_file() and "resuming the map" in log.read_text())
        mapped = len(run.mapped)
        run._until(lambda: len(run.mapped) >= mapped + IN_MAP)
        assert said_of_map(run) == ""
        run.end()
    assert len({pose.map_id for pose in run.mapped.values()}) == 1


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_reset_ends_what_is_said_of_the_lost_map(
    build: Path, robot_file: Path, drive: Capture, tmp_path: Path, method: str
) -> None:
    """The user has begun another map: the one that was lost is no longer missed, and its poses are
    not of the new one."""
    of_method = programs_of(build, method)
    run = LiveRun(build, robot_file, drive, tmp_path, store=False, programs=of_method)
    with run:
        run.until_poses(KILL_AT)
        run.restart("mapping")
        run._until(lambda: bool(said_of_map(run)))
        before_ns = list(run.mapped.values())[-1].instant_ns
        reply = run.chain.link.command("mapping", "reset", {})
        assert reply is not None
        assert reply.ok
        run._until(lambda: not said_of_map(run))
        mapped = len(run.mapped)
        run._until(lambda: len(run.mapped) >= mapped + IN_MAP)
        assert path_ns(run).min() > before_ns
        run.end()
