"""Benchmarks: `make bench`. Speed is stated as a ratio within one run, wherever there is a peer."""
