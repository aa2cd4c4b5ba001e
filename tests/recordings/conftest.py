"""The same real processes and drive as the integration tests."""

from tests.integration.conftest import build, capture, own_folder

__all__ = ["build", "capture", "own_folder"]
