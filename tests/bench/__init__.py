"""Benchmarks: `make bench`. Where there is a peer, speed is a ratio to it within the same run."""
