"""Uses the fixtures of the integration tests: the same real processes."""

from tests.integration.conftest import build, own_folder, robot_file

__all__ = ["build", "own_folder", "robot_file"]
