"""Remote eyes of zenoh-loam: runs a chain, watches it, and says how good it was.

Uses only what any third-party subscriber can use: Zenoh keys and FlatBuffers schemas.
"""
