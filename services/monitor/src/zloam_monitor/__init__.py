"""Remote side of zenoh-loam: runs a chain, watches it, and evaluates its results.

Uses only what any third-party subscriber can use: Zenoh keys and FlatBuffers schemas.
"""
