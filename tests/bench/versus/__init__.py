"""Our stages beside peers from PyPI on the same scans: accuracy, CPU time, memory (README.md
here)."""

from __future__ import annotations

from tests.bench.versus.rows import benchmarks

__all__ = ["benchmarks"]
