"""For all tests: runs beside each other, and beside a robot's own, take free ports."""

import os

os.environ["ZLOAM_FREE_PORTS"] = "1"
