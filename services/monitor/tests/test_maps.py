"""Maps in each format contain the same points, read by this package and by other libraries;
cropping and thinning follow their definitions."""

from __future__ import annotations

import warnings
from pathlib import Path

import laspy
import numpy as np
import pytest
from pypcd4 import PointCloud

from zloam_monitor import cli, clouds, maps
from zloam_monitor.maps import MapError, PointMap
from zloam_monitor.messages import MAP_POINT

FORMATS = (".pcd", ".ply", ".las", ".laz")


@pytest.fixture
def made() -> PointMap:
    """A map far from the origin, as after a long drive."""
    random = np.random.default_rng(3)
    points = np.zeros(5000, MAP_POINT)
    for axis, centre in zip("xyz", (900.0, -1300.0, 4.0), strict=True):
        points[axis] = centre + random.normal(0.0, 30.0, len(points))
    points["intensity"] = random.integers(0, 256, len(points))
    return PointMap(points, random.integers(0, 2, len(points)).astype(np.uint8))


@pytest.mark.parametrize("suffix", FORMATS)
def test_each_format_holds_the_same_points(made: PointMap, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"map{suffix}"
    maps.write(path, made)
    again = maps.read(path)
    # LAS has a resolution of 0.1 mm.
    assert np.abs(again.xyz - made.xyz).max() <= (1e-4 if suffix in (".las", ".laz") else 0.0)
    assert (again.points["intensity"] == made.points["intensity"]).all()
    assert (again.layers == made.layers).all()


def test_other_programs_read_them(made: PointMap, tmp_path: Path) -> None:
    for suffix in FORMATS:
        maps.write(tmp_path / f"map{suffix}", made)
    pcd = PointCloud.from_path(tmp_path / "map.pcd").pc_data
    assert (pcd["layer"] == made.layers).all()
    for axis in "xyz":
        assert (pcd[axis] == made.points[axis]).all()
    for suffix in (".las", ".laz"):
        las = laspy.read(tmp_path / f"map{suffix}")
        assert str(las.header.version) == "1.4"
        for axis in "xyz":
            # LAS has a resolution of 0.1 mm.
            assert np.abs(np.asarray(las[axis]) - made.points[axis]).max() <= 1e-4
        assert (np.asarray(las["layer"]) == made.layers).all()
    assert (tmp_path / "map.laz").stat().st_size < (tmp_path / "map.las").stat().st_size


def test_points_of_a_file_without_layers_are_plane(made: PointMap, tmp_path: Path) -> None:
    """LAS files have user data for each point, which other programs leave 0 or use as they like."""
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.x, las.y, las.z = made.xyz.T
    las.user_data = np.arange(len(made)) % 3
    las.write(tmp_path / "survey.las")
    assert set(maps.read(tmp_path / "survey.las").layers) == {1}


@pytest.mark.parametrize(
    ("kind", "values"),
    [("float64", (0.0, 300.0)), ("float64", (1.0, np.nan)), ("uint16", (0, 256))],
)
def test_another_program_s_layers_are_none_of_a_map(
    made: PointMap, tmp_path: Path, kind: str, values: tuple[float, float]
) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("layer", kind))
    las = laspy.LasData(header)
    las.x, las.y, las.z = made.xyz.T
    las["layer"] = np.resize(values, las["layer"].shape)
    las.write(tmp_path / "survey.las")
    assert set(maps.read(tmp_path / "survey.las").layers) == {1}


def test_a_layer_that_came_back_as_a_float_is_the_same(made: PointMap, tmp_path: Path) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("layer", "float32"))
    las = laspy.LasData(header)
    las.x, las.y, las.z = made.xyz.T
    las["layer"] = made.layers.astype(np.float32)
    las.write(tmp_path / "edited.las")
    assert (maps.read(tmp_path / "edited.las").layers == made.layers).all()


def test_a_map_that_mapping_wrote_is_read(made: PointMap, tmp_path: Path) -> None:
    clouds.write_pcd(tmp_path / "map.pcd", made.points, made.layers)
    assert (maps.read(tmp_path / "map.pcd").points == made.points).all()


def test_cropping_keeps_both_ends(made: PointMap) -> None:
    kept = maps.cropped(made, {"x": (900.0, 930.0), "z": (float(made.points["z"].min()), 4.0)})
    x, z = made.points["x"], made.points["z"]
    assert len(kept) == int(((x >= 900.0) & (x <= 930.0) & (z <= 4.0)).sum())
    with pytest.raises(MapError, match="--z: 3 is above 2"):
        maps.cropped(made, {"z": (3.0, 2.0)})


def test_thinning_leaves_one_point_a_cube(made: PointMap) -> None:
    thin = maps.thinned(made, 10.0)
    cubes = {tuple(c) for c in np.floor(made.xyz / 10.0).astype(int)}
    left = [tuple(c) for c in np.floor(thin.xyz / 10.0).astype(int)]
    assert len(left) == len(set(left)) == len(cubes)
    # Each point is one of the map's own, and of its cube's points the nearest to their mean.
    for point, cube in zip(thin.xyz[:50], left[:50], strict=True):
        inside = made.xyz[(np.floor(made.xyz / 10.0).astype(int) == cube).all(axis=1)]
        off = np.linalg.norm(inside - inside.mean(axis=0), axis=1)
        assert np.linalg.norm(point - inside.mean(axis=0)) == pytest.approx(off.min(), abs=1e-9)


def run(*words: object) -> int:
    return cli.main([str(word) for word in words])


def test_the_commands(made: PointMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "map.pcd"
    maps.write(source, made)
    assert run("map", "info", source) == 0
    assert f"{source}: 5000 points" in capsys.readouterr().out
    assert run("map", "convert", source, tmp_path / "edges.laz", "--layer", "edge") == 0
    assert len(maps.read(tmp_path / "edges.laz")) == int((made.layers == 0).sum())
    assert run("map", "crop", source, tmp_path / "low.ply", "--z", -100, 4, "--voxel", 1) == 0
    assert (maps.read(tmp_path / "low.ply").points["z"] <= 4.0).all()


def test_mistakes_are_told(
    made: PointMap, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "map.pcd"
    maps.write(source, made)
    (tmp_path / "broken.las").write_bytes(b"no points")
    (tmp_path / "flat.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "end_header\n1 2\n"
    )
    for words, code, said in (
        (("map", "info", "none.pcd"), 3, "none.pcd: No such file"),
        (("map", "info", "map.txt"), 2, ".pcd, .ply, .las or .laz is expected"),
        (("map", "info", tmp_path / "broken.las"), 3, "broken.las: cannot be read"),
        (("map", "info", tmp_path / "flat.ply"), 3, "has no z"),
        (("map", "convert", source, tmp_path / "a.xyz"), 2, ".pcd, .ply, .las or .laz is expected"),
        (
            ("map", "convert", source, tmp_path / "a.ply", "--layer", "roof"),
            2,
            "none of edge, plane",
        ),
        (("map", "convert", source, tmp_path / "a.ply", "--voxel", 0), 2, "no edge of a cube"),
        (("map", "crop", source, tmp_path / "a.ply", "--x", 0, 1), 1, "nothing written"),
    ):
        assert run(*words) == code
        assert said in capsys.readouterr().err, words
    assert not (tmp_path / "a.ply").exists()


def float64_ply(path: Path, xyz: np.ndarray) -> Path:
    head = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz)}\n{head}end_header\n"
    path.write_bytes(head.encode() + xyz.astype("<f8").tobytes())
    return path


def test_coordinates_that_would_be_rounded_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    near = np.random.default_rng(5).normal(0.0, 50.0, (1000, 3))
    utm = float64_ply(tmp_path / "utm.ply", near + np.array([691_000.0, 5_335_000.0, 500.0]))
    huge = float64_ply(tmp_path / "huge.ply", near * 1e300)
    local = float64_ply(tmp_path / "local.ply", near)
    to = tmp_path / "to.pcd"
    for source in (utm, huge):
        for words in (("map", "info", source), ("map", "convert", source, to)):
            assert run(*words) == 3
            assert f"{source}: its coordinates reach" in (said := capsys.readouterr().err)
            assert "subtract an origin" in said
    assert not to.exists()
    assert run("map", "convert", local, to) == 0
    assert np.abs(maps.read(to).xyz - near).max() < 1e-5


def test_points_without_coordinates_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    xyz = np.random.default_rng(5).normal(0.0, 50.0, (100, 3))
    xyz[:7, 1] = np.nan
    xyz[7, 2] = np.inf
    source = float64_ply(tmp_path / "holes.ply", xyz)
    reported = "8 points without finite coordinates were left out"
    assert run("map", "info", source) == 0
    assert reported in capsys.readouterr().out.splitlines()
    for words in (("convert", source, tmp_path / "a.pcd"), ("autoware", source, tmp_path / "a")):
        assert run("map", *words) == 0
        assert f"{source}: {reported}" in capsys.readouterr().err
    assert run("map", "info", tmp_path / "a.pcd") == 0
    assert "left out" not in capsys.readouterr().out


def test_points_that_reach_too_far_for_las_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """32 bits at steps of 0.1 mm reach 214.7 km."""
    far = float64_ply(tmp_path / "far.ply", np.array([[-110_000.0, 0, 0], [110_000.0, 0, 0]]))
    near = float64_ply(tmp_path / "near.ply", np.array([[-107_000.0, 0, 0], [107_000.0, 0, 0]]))
    for suffix in (".las", ".laz"):
        to = tmp_path / f"map{suffix}"
        assert run("map", "convert", far, to) == 3
        assert f"{to}: the points reach 220000 m far" in capsys.readouterr().err
        assert not to.exists()
        assert run("map", "convert", near, to) == 0
        assert maps.read(to).points["x"].tolist() == [-107_000.0, 107_000.0]


@pytest.mark.parametrize("prefix", ["", "scalar_"])
@pytest.mark.parametrize("name", ["intensity", "Intensity", "i", "Reflectivity"])
def test_intensity_and_layer_under_the_names_of_other_programs(
    tmp_path: Path, name: str, prefix: str
) -> None:
    names = ("x", "y", "z", f"{prefix}{name}", f"{prefix}Layer")
    properties = "".join(f"property float {each}\n" for each in names)
    path = tmp_path / "a.ply"
    path.write_text(
        f"ply\nformat ascii 1.0\nelement vertex 2\n{properties}end_header\n1 2 3 7 0\n4 5 6 9 1\n"
    )
    found = maps.read(path)
    assert found.points["intensity"].tolist() == [7.0, 9.0]
    assert found.layers.tolist() == [0, 1]


def test_an_intensity_that_is_no_number_is_none(tmp_path: Path) -> None:
    """No warning of a library, and nothing undefined in LAS."""
    points = np.zeros(3, MAP_POINT)
    points["intensity"] = (np.nan, np.inf, 5.0)
    path = tmp_path / "a.pcd"
    clouds.write_pcd(path, points, np.zeros(3, np.uint8))
    found = maps.read(path)
    assert np.isfinite(found.points["intensity"]).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        maps.write(tmp_path / "a.las", found)
    assert maps.read(tmp_path / "a.las").points["intensity"].tolist() == [0.0, 65535.0, 5.0]


@pytest.mark.parametrize(
    ("intensities", "said"),
    [
        ((0.25, 1.0), "intensities of 0.25 to 1 are rounded"),
        ((-40.0, 20.0), "intensities of -40 to 20 are rounded"),
        ((0.0, 1e6), "intensities of 0 to 1e+06 are rounded"),
        ((0.0, 255.0), None),
        ((3.5, 3000.25), None),
        ((0.0, 0.0), None),
    ],
)
def test_intensities_that_las_does_not_hold_are_named(
    tmp_path: Path,
    intensities: tuple[float, ...],
    said: str | None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source = tmp_path / "a.pcd"
    points = np.zeros(2, MAP_POINT)
    points["intensity"] = intensities
    clouds.write_pcd(source, points, np.zeros(2, np.uint8))
    for name, lossy in (("a.las", True), ("a.ply", False)):
        assert cli.main(["map", "convert", str(source), str(tmp_path / name)]) == 0
        err = capsys.readouterr().err
        assert (said in err) if said and lossy else not err
