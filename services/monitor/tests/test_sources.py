"""The command line of a replay becomes settings of the driver."""

from __future__ import annotations

from pathlib import Path

import pytest

from zloam_monitor import cli, sources


def test_readings_go_with_any_recording(tmp_path: Path) -> None:
    readings = tmp_path / "imu.csv"
    source = sources.with_imu(sources.from_pcap(Path("drive.pcap")), readings)
    settings = source.driver_settings("max")
    assert "driver.source=pcap" in settings
    assert "driver.imu=file" in settings
    assert f"driver.imu_path={readings}" in settings


def test_a_recording_has_no_simulated_readings(capsys: pytest.CaptureFixture[str]) -> None:
    code = cli.main(["demo", "--pcap", "drive.pcap", "--imu", sources.SIMULATED_IMU])
    assert code != 0
    assert sources.SIMULATED_IMU in capsys.readouterr().err


def test_a_setting_that_is_no_number_is_named() -> None:
    with pytest.raises(sources.SourceError, match=r"driver\.scan_period_s: '10 Hz': a number"):
        sources.asked({"driver.scan_period_s": "10 Hz"})
