"""Texts for --method become programs; wrong ones are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from zloam_monitor import cli
from zloam_monitor.methods import MethodError, programs


def test_a_method_stands_for_all_its_stages_or_for_those_named() -> None:
    whole = {s: f"aloam-{s}" for s in ("registration", "odometry", "mapping")}
    assert programs("") == {}
    assert programs("aloam") == whole
    assert programs("mapping=aloam") == {"mapping": "aloam-mapping"}
    assert programs("odometry=aloam, registration=aloam") == {
        "odometry": "aloam-odometry",
        "registration": "aloam-registration",
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [("floam", "aloam"), ("mapping=floam", "aloam"), ("integration=aloam", "registration")],
)
def test_what_is_not_there_is_refused_with_what_is(text: str, said: str) -> None:
    with pytest.raises(MethodError, match=said):
        programs(text)


def test_a_wrong_method_ends_the_command_before_it_simulates(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["demo", "--method", "floam"]) == 2
    assert "no method 'floam'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["demo", "run"])
@pytest.mark.parametrize("option", ["--localize", "--extend", "--graph"])
@pytest.mark.parametrize("method", ["aloam", "mapping=aloam"])
def test_another_mapping_leaves_a_map_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str, option: str, method: str
) -> None:
    """It would begin a map in the store, which deletes the one that is there."""
    there = ["--map", str(tmp_path)] if option != "--graph" else []
    (tmp_path / "00000001.log").write_text("a map")
    assert cli.main([command, option, *there, "--method", method]) == 2
    assert f"{option} needs mapping itself, not aloam-mapping" in capsys.readouterr().err
    assert [path.read_text() for path in tmp_path.iterdir()] == ["a map"]
