"""Reads the values of a robot's file that a third party needs to find the robot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from zloam_monitor import places
from zloam_monitor.failures import FileTrouble, Misuse


class RobotFileError(Misuse):
    """The file is no YAML, or a name in it is none. The stages check all else."""


#: Range of zenoh.base_port (services/common/runtime/config.cpp).
BASE_PORTS = range(65001)


@dataclass(frozen=True)
class RobotNames:
    """Names in the robot's keys, and addresses on which the stages listen."""

    robot: str = "robot"
    sensor: str = "lidar"
    base_port: int = 7460
    host: str = "127.0.0.1"


def _value(tree: Any, settings: list[str], key: str, default: Any) -> Any:
    """The value of a key: that of --set, else of the file, else the default."""
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
    """Endpoints of zenoh.connect; values of other forms are kept for the stages to refuse."""
    found = _value(_tree(path), settings, "zenoh.connect", [])
    try:
        listed = yaml.load(found, Loader=yaml.BaseLoader) if isinstance(found, str) else found
    except yaml.YAMLError:
        listed = found
    return [str(each) for each in listed] if isinstance(listed, list) else [str(listed)]


def _refusal(path: Path, error: yaml.YAMLError) -> str:
    """A key that is a list or a section is no error of YAML's, but PyYAML's own."""
    mark = getattr(error, "problem_mark", None)
    if getattr(error, "problem", None) == "found unhashable key" and mark is not None:
        return f"{path}:{mark.line + 1}: a name is expected as key, not\n{mark.get_snippet()}"
    return f"{path}: {error}"


def _tree(path: Path) -> Any:
    try:
        # The stages read values as texts, so `01` is a name and not a number.
        return yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.BaseLoader) or {}
    except FileNotFoundError as error:
        # A bare name is one of a robot that comes with zloam, or is mistyped.
        named = sorted(each.stem for each in places.robots().glob("*.yaml"))
        others = f"; robots by name: {', '.join(named)}" if path.name == str(path) else ""
        raise FileTrouble(f"{path}: {error.strerror}{others}") from error
    except OSError as error:
        raise FileTrouble(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise RobotFileError(f"{path}: is not UTF-8 text, as which it must be saved") from error
    except yaml.YAMLError as error:
        raise RobotFileError(_refusal(path, error)) from error
    except RecursionError as error:
        raise RobotFileError(f"{path}: nested too deeply") from error


def names(path: Path, settings: list[str]) -> RobotNames:
    """Reads the names; other errors in the file are reported by the stages."""
    tree = _tree(path)
    plain = RobotNames()
    port = _value(tree, settings, "zenoh.base_port", plain.base_port)
    try:
        if int(port) not in BASE_PORTS:
            raise RobotFileError(
                f"{path}: zenoh.base_port {port}: 0 to {BASE_PORTS[-1]} is expected"
            )
        return RobotNames(
            robot=str(_value(tree, settings, "robot", plain.robot)),
            sensor=str(_value(tree, settings, "sensor.name", plain.sensor)),
            base_port=int(port),
            host=str(_value(tree, settings, "zenoh.host", plain.host)),
        )
    except (ValueError, TypeError) as error:
        raise RobotFileError(f"{path}: zenoh.base_port {port!r} is no number") from error


def driver_values(path: Path, settings: Iterable[str]) -> dict[str, str]:
    """Full key -> value of all keys driver.* in the file, and in --set, which has priority."""
    tree = _tree(path)
    driver = tree.get("driver") if isinstance(tree, dict) else None
    given = driver.items() if isinstance(driver, dict) else ()
    found = {f"driver.{key}": str(value) for key, value in given}
    named = (setting.split("=", 1) for setting in settings if "=" in setting)
    return found | {key: value for key, value in named if key.startswith("driver.")}
