"""Entry point of `python -m zloam_monitor`."""

import sys

from zloam_monitor.cli import main

sys.exit(main())
