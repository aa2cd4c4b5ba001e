"""Fetches a description from simulated sensors with newer and older firmware."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fake_sensor import sensor
from zloam_monitor import cli, sensor_metadata, sources

DESCRIPTION = {
    "sensor_info": {"prod_line": "OS-1-128", "status": "RUNNING"},
    "beam_intrinsics": {"beam_altitude_angles": [1.0]},
    "imu_intrinsics": {},
    "lidar_intrinsics": {},
    "lidar_data_format": {"pixels_per_column": 128},
    "config_params": {"lidar_mode": "1024x10"},
}


def test_one_document_of_newer_firmware(tmp_path: Path) -> None:
    file = tmp_path / "os.json"
    with sensor({sensor_metadata.PATH: DESCRIPTION}) as host:
        assert cli.main(["metadata", host, str(file)]) == 0
    assert json.loads(file.read_text()) == DESCRIPTION


def test_parts_of_older_firmware() -> None:
    pages = {f"{sensor_metadata.PATH}/{name}": DESCRIPTION[name] for name in sensor_metadata.PARTS}
    pages[sensor_metadata.CONFIGURATION] = DESCRIPTION["config_params"]
    with sensor(pages) as host:
        assert sensor_metadata.fetched(host) == DESCRIPTION


@pytest.mark.parametrize(
    ("page", "why"),
    [
        (b"<html>", "is no JSON"),
        ([1], "no JSON object"),
        ({"beam_intrinsics": {}}, "says nothing of lidar_data_format"),
        ({**DESCRIPTION, "sensor_info": {"status": "WARMUP"}}, "WARMUP"),
        (b" " * (sensor_metadata.MOST_BYTES + 1), "more than 1 MiB"),
    ],
)
def test_what_is_no_description_is_refused(page: Any, why: str) -> None:
    with (
        sensor({sensor_metadata.PATH: page}) as host,
        pytest.raises(sources.SourceError, match=why),
    ):
        sensor_metadata.fetched(host)


def test_who_is_no_sensor_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with sensor({}) as host:
        assert cli.main(["metadata", host, str(tmp_path / "a.json")]) == 1
    assert cli.main(["metadata", host, str(tmp_path / "a.json")]) == 1
    assert "is it the sensor's address?" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
