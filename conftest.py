"""For all tests: runs beside each other, and beside a robot's own, take free ports."""

import os
import signal

import pytest

# Assertions in helpers of the tests print the compared values, as those in the tests do.
pytest.register_assert_rewrite("tests")

os.environ["ZLOAM_FREE_PORTS"] = "1"

# In the background of a script, or under nohup, these are ignored, and so by all that tests start:
# what is to end at an interrupt would go on for ever.
for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT):
    if signal.getsignal(number) is signal.SIG_IGN:
        usual = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
        signal.signal(number, usual)
