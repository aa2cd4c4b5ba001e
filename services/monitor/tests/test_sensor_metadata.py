"""Fetches a description from simulated sensors with newer and older firmware."""

from __future__ import annotations

import json
import socket
import threading
from pathlib import Path
from typing import Any

import pytest

from fake_sensor import sensor
from zloam_monitor import cli, sensor_metadata

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
        pytest.raises(sensor_metadata.SensorError, match=why),
    ):
        sensor_metadata.fetched(host)


@pytest.mark.parametrize("host", ["os 1", "os:port", "[os", "no-scheme://os", "http://"])
def test_what_is_no_address_is_named(
    host: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["metadata", host, str(tmp_path / "a.json")]) == 1
    said = capsys.readouterr().err
    assert host in said
    assert "is it the sensor's address?" in said


@pytest.mark.parametrize("answer", [b"SSH-2.0-x\r\n", b"", b"HTTP/1.1 200 OK\r\n\r\n["])
def test_who_speaks_another_language_is_named(
    answer: bytes, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def serve(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection:
            connection.recv(1000)
            connection.sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, args=(server,))
        thread.start()
        host = f"127.0.0.1:{server.getsockname()[1]}"
        assert cli.main(["metadata", host, str(tmp_path / "a.json")]) == 1
        thread.join()
    assert host in capsys.readouterr().err


def test_a_description_of_another_form_is_refused_or_kept(tmp_path: Path) -> None:
    """Whether the sensor runs is unknown then."""
    found = {**DESCRIPTION, "sensor_info": ["1.0"]}
    with sensor({sensor_metadata.PATH: found}) as host:
        assert sensor_metadata.fetched(host) == found
        assert cli.main(["metadata", host, str(tmp_path / "os.json")]) == 0


def test_who_is_no_sensor_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with sensor({}) as host:
        assert cli.main(["metadata", host, str(tmp_path / "a.json")]) == 1
    assert cli.main(["metadata", host, str(tmp_path / "a.json")]) == 1
    assert "is it the sensor's address?" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
