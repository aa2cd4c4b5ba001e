"""The same real processes as the integration tests."""

from tests.integration.conftest import build, own_folder, robot_file

__all__ = ["build", "own_folder", "robot_file"]
