"""The few values of a robot's file that a third party needs to find the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml


class RobotFileError(RuntimeError):
    """The file can't be read; the stages themselves check what stands in it."""


@dataclass(frozen=True)
class RobotNames:
    """Names below which the keys lie, and where the stages listen."""

    robot: str = "robot"
    sensor: str = "lidar"
    base_port: int = 7460
    host: str = "127.0.0.1"


def _value(tree: Any, settings: list[str], key: str, default: Any) -> Any:
    """A --set beats the file, the file the default."""
    for setting in reversed(settings):
        name, _, value = setting.partition("=")
        if name == key:
            return value
    for chunk in key.split("."):
        if not isinstance(tree, dict) or chunk not in tree:
            return default
        tree = tree[chunk]
    return tree


def connects(path: Path, settings: list[str]) -> list[str]:
    """zenoh.connect; what is no list of endpoints is left to the stages to refuse."""
    found = _value(_tree(path), settings, "zenoh.connect", [])
    try:
        listed = yaml.load(found, Loader=yaml.BaseLoader) if isinstance(found, str) else found
    except yaml.YAMLError:
        listed = found
    return [str(each) for each in listed] if isinstance(listed, list) else [str(listed)]


def _tree(path: Path) -> Any:
    try:
        # the stages take a value's text, so `01` is a name and no number
        return yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.BaseLoader) or {}
    except OSError as error:
        raise RobotFileError(f"{path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RobotFileError(f"{path}: {error}") from error
    except RecursionError as error:
        raise RobotFileError(f"{path}: nested too deeply") from error


def names(path: Path, settings: list[str]) -> RobotNames:
    """Reads the names; what is wrong elsewhere in the file is the stages' to refuse."""
    tree = _tree(path)
    plain = RobotNames()
    port = _value(tree, settings, "zenoh.base_port", plain.base_port)
    try:
        return RobotNames(
            robot=str(_value(tree, settings, "robot", plain.robot)),
            sensor=str(_value(tree, settings, "sensor.name", plain.sensor)),
            base_port=int(port),
            host=str(_value(tree, settings, "zenoh.host", plain.host)),
        )
    except (ValueError, TypeError) as error:
        raise RobotFileError(f"{path}: zenoh.base_port {port!r} is no number") from error
