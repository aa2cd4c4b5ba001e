"""Uses the fixtures of the integration tests: the same real processes and drive."""

from tests.integration.conftest import build, capture, own_folder

__all__ = ["build", "capture", "own_folder"]
