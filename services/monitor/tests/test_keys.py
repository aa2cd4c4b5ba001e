"""Names that can't be part of a key are refused, as the stages do (keys_test.cpp)."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from zloam_monitor import cli, discovery, follow
from zloam_monitor.failures import Misuse
from zloam_monitor.keys import KeyNameError, Keys, name_error

BAD = ("", "a/b", "a*", "?", "a#b", "$x", "a b", "a\tb", "a\x7f", "@a")


@pytest.mark.parametrize("name", BAD)
def test_a_name_that_can_be_no_part_of_a_key_is_refused(name: str) -> None:
    with pytest.raises(KeyNameError, match="name of the robot: "):
        Keys(name)
    with pytest.raises(KeyNameError, match="name of the sensor: "):
        Keys("robot", name)
    with pytest.raises(KeyNameError, match="name of the stage: "):
        Keys("robot").command(name, "set")
    with pytest.raises(KeyNameError, match="name of the instance: "):
        Keys("robot").takeover("mapping", name)


@pytest.mark.parametrize("name", ["robot", "a-b_c.d", "Ä1", "a@b"])
def test_other_names_are_taken(name: str) -> None:
    assert name_error(name) is None
    assert Keys(name).pose == f"loam/{name}/pose"


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_name_is_a_wrong_command_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["follow", "--robot", name, "--out", str(tmp_path)]) == 2
    assert "can't be part of a key" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], ("robot", "lidar")),
        (["--config", "FILE"], ("alpha", "top")),
        (["--config", "FILE", "--settings", "mapping.mode=map robot=beta"], ("beta", "top")),
        (["--config", "FILE", "--set", "sensor.name=rear", "--robot", "gamma"], ("gamma", "rear")),
    ],
)
def test_follow_takes_the_names_of_the_robot_file(
    words: list[str], wanted: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("robot: alpha\nsensor: {name: top}\n")
    seen: list[follow.FollowOptions] = []

    def followed(options: follow.FollowOptions) -> dict[str, Any]:
        seen.append(options)
        raise Misuse("seen")

    monkeypatch.setattr(follow, "follow", followed)
    cli.main(["follow", *(str(file) if word == "FILE" else word for word in words)])
    assert seen[0].keys == Keys(*wanted)


def test_a_token_of_such_a_name_is_no_robot() -> None:
    """A stranger can declare it; a view must not end because of it."""
    keys = [f"loam/{robot}/service/odometry/odometry-1/alive" for robot in ("a b", "car")]
    replies = [SimpleNamespace(ok=SimpleNamespace(key_expr=key)) for key in keys]
    tokens = SimpleNamespace(get=lambda *_, **__: replies)
    session: Any = SimpleNamespace(liveliness=lambda: tokens)
    assert discovery._answers(session, 1.0) == {("car", "odometry", "odometry-1")}
