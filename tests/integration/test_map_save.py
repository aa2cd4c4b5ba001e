"""The monitor writes the map of a running robot: the same map as mapping itself writes, in every
format."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.integration.conftest import Capture, monitor
from tests.integration.replay_run import chain_of
from zloam_monitor import maps


@pytest.fixture(scope="module")
def driven(
    build: Path, robot_file: Path, capture: Capture, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, Path]]:
    """Endpoint of a robot at the end of its drive, and the folder of its own files."""
    out = tmp_path_factory.mktemp("driven")
    with chain_of(build, robot_file, capture.pcap, out) as chain:
        while not (chain.finished() and (out / "map.pcd").exists()):
            chain.link.poll(0.2)
            chain.check()
        yield f"127.0.0.1:{chain._own_port}", out


@pytest.mark.parametrize("suffix", sorted(maps.WRITERS))
def test_each_format_is_the_map_that_mapping_writes(
    driven: tuple[str, Path], tmp_path: Path, suffix: str
) -> None:
    endpoint, out = driven
    to = tmp_path / f"town{suffix}"
    done = monitor("map", "save", to, "--connect", endpoint)
    assert done.code == 0, done.said
    saved, own = maps.read(to), maps.read(out / "map.pcd")
    assert len(saved) == len(own) > 1000
    assert f"{len(own)} points of" in done.said
    assert np.bincount(saved.layers).tolist() == np.bincount(own.layers).tolist()
    for layer in np.unique(own.layers):
        found, wanted = saved.xyz[saved.layers == layer], own.xyz[own.layers == layer]
        # The tiles may come in another order. Largest difference along an axis, both ways.
        for these, those in ((found, wanted), (wanted, found)):
            off_m, _ = cKDTree(those).query(these, p=np.inf)
            assert off_m.max() <= maps.LAS_STEP_M


def test_its_header_says_what_it_is(driven: tuple[str, Path], tmp_path: Path) -> None:
    endpoint, _ = driven
    to = tmp_path / "town"
    for suffix in (".pcd", ".laz"):
        done = monitor("map", "save", to.with_suffix(suffix), "--connect", endpoint)
        assert done.code == 0, done.said
    (record,) = laspy.read(to.with_suffix(".laz")).header.vlrs.get_by_id(maps.LAS_USER)
    notes = record.record_data.decode().splitlines()
    assert "robot: robot" in notes
    assert "mapping.leaf_plane_m: 0.4" in notes
    head = to.with_suffix(".pcd").read_bytes().partition(b"DATA binary")[0].decode()
    assert [f"# {note}" in head.splitlines() for note in notes] == [True] * len(notes)


def test_thinned_and_as_json(driven: tuple[str, Path], tmp_path: Path) -> None:
    endpoint, _ = driven
    to = tmp_path / "thin.pcd"
    done = monitor("map", "save", to, "--voxel", 2.0, "--connect", endpoint, "--json")
    assert done.code == 0, done.said
    said = json.loads(done.said.splitlines()[-1])
    assert said["file"] == str(to)
    assert said["points"] == len(maps.read(to)) < 3000
    assert said["tiles"] > 4


def test_what_can_not_be_is_said(driven: tuple[str, Path], tmp_path: Path) -> None:
    endpoint, _ = driven
    no_format = monitor("map", "save", tmp_path / "town.xyz", "--connect", endpoint)
    assert no_format.code == 2
    assert ".laz is expected" in no_format.said
    nobody = monitor("map", "save", tmp_path / "town.pcd", "--connect", "127.0.0.1:1")
    assert nobody.code == 1
    assert "127.0.0.1:1" in nobody.said
    assert not list(tmp_path.glob("town*"))
