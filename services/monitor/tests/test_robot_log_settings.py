"""The configuration of a robot's own recording, as `zloam demo --bag` takes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fake_session import needs_schemas, revision
from zloam_monitor import compose, messages, sources
from zloam_monitor.mcap_file import McapFile
from zloam_monitor.recorded_keys import schema_of

ABOUT = {"robot": "r", "sensor": "lidar", "recording": "a", "version": "0.1.0", "part": "1"}


def test_what_a_stranger_publishes_as_configuration_is_left_out_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    needs_schemas()
    file = McapFile(tmp_path / "run.mcap", ABOUT)
    config, change = compose.config("mapping", {"mapping.a": 1}), revision("mapping", 1, {"x": 2})
    sent = (
        (
            "lidar/lidar/sweep",
            compose.sweep(compose.HeaderValues(1, 0, 0), np.zeros(1, messages.POINT)),
        ),
        ("service/odd/odd-1/config", config[:8] + b"\xff" * 20),
        ("service/mapping/mapping-1/config", config),
        ("config/odd", change[:8] + b"\xff" * 20),
        ("config/mapping", change),
    )
    for n, (topic, payload) in enumerate(sent):
        file.put(f"loam/r/{topic}", schema_of(payload[4:8]), n, 0, payload)
    file.close()
    found = sources._from_robot_log(file.path, [], own_config=False)
    assert (found.settings, found.changes) == (["mapping.a=1"], ["0:x=2"])
    said = "run.mcap: messages of loam/r/config/odd, loam/r/service/odd/odd-1/config can't be read"
    assert said in capsys.readouterr().out
