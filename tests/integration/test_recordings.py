"""Recordings of real sensors through the real processes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.integration.conftest import monitor


@pytest.mark.parametrize(
    ("source", "file", "sweeps"),
    [
        ("--bin", "vlp16_single/packets.bin", (13, 16)),  # 1.326 s at 10 Hz
        ("--bin", "vlp16_dual/packets.bin", (4, 7)),  # 0.40 s
    ],
)
def test_standing_still(
    build: Path, shared: Path, tmp_path: Path, source: str, file: str, sweeps: tuple[int, int]
) -> None:
    done = monitor("demo", "--preset-dir", build, source, shared / "data" / file, "--out", tmp_path)
    assert done.code == 0, done.said
    report = json.loads((tmp_path / "report.json").read_text())
    assert sweeps[0] <= report["identities"]["sweeps"] <= sweeps[1]
    assert report["identities"]["poses"] == report["identities"]["sweeps"]
    # The sensor stood still, so the length of the path is error.
    assert report["path_m"] < 0.5


def test_a_capture_with_the_wrong_product_byte(build: Path, shared: Path, tmp_path: Path) -> None:
    """The timing is a VLP-16's at 20 Hz, the product byte an HDL-32E's: the declared model is
    used."""
    done = monitor(
        "demo",
        "--preset-dir",
        build,
        "--out",
        tmp_path,
        "--pcap",
        shared / "data/vlp16_mislabelled/capture.pcap",
    )
    assert done.code == 0, done.said
    report = json.loads((tmp_path / "report.json").read_text())
    assert 50 <= report["identities"]["sweeps"] <= 53  # 2.52 s at 20 Hz
