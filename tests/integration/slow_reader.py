"""A slow subscriber of a third party: python slow_reader.py SECONDS KEY ENDPOINT... It prints one
line per message.

A program of its own, since all sessions of a process share Zenoh's threads.
"""

import sys
import threading
import time

from zloam_monitor.link import open_session


def main() -> None:
    seconds, key, endpoints = float(sys.argv[1]), sys.argv[2], sys.argv[3:]

    def take(sample: object) -> None:
        time.sleep(seconds)
        print(len(sample.payload), flush=True)  # type: ignore[attr-defined]

    session = open_session(endpoints)
    subscriber = session.declare_subscriber(key, take)
    print("listening", subscriber.key_expr, flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()
