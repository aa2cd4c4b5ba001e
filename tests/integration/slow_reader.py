"""A slow subscriber of a third party: python slow_reader.py SECONDS KEY ENDPOINT... It prints one
line per message: its topic, its number, and how many of the topic have not arrived.

A program of its own, since all sessions of a process share Zenoh's threads.
"""

import sys
import threading
import time
from typing import Any

from zloam_monitor.gaps import Gaps, number_of
from zloam_monitor.keys import topic_of
from zloam_monitor.link import open_session


def main() -> None:
    seconds, key, endpoints = float(sys.argv[1]), sys.argv[2], sys.argv[3:]

    gaps = Gaps()

    def take(sample: Any) -> None:
        time.sleep(seconds)
        topic, number = topic_of(str(sample.key_expr)), number_of(sample.payload.to_bytes())
        if number is not None:
            gaps.take(topic, number)
        print(topic, number.seq if number else "-", gaps.lost()[topic], flush=True)

    session = open_session(endpoints, shared_memory=False)
    subscriber = session.declare_subscriber(key, take)
    print("listening", subscriber.key_expr, flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()
