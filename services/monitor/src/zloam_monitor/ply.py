"""Reads vertices of PLY files (Turk, "The PLY Polygon File Format", 1994): ascii and both binary
forms.

A reader of our own, as plyfile is under the GPL and meshio does not support 16-bit numbers.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

#: Old and new names of number types -> numpy.
TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
#: Number of words in these lines of a header.
LEAST_WORDS = {"format": 2, "element": 3, "property": 3}
#: Limit on the lines of a header.
MOST_LINES = 1000


def vertices(path: Path) -> NDArray[Any]:
    """Array structured by the names of the properties; raises ValueError with the reason."""
    with path.open("rb") as file:
        form, count, properties = _header(file)
        dtype = np.dtype([(name, FORMATS[form] + TYPES[kind]) for kind, name in properties])
        if form == "ascii":
            # Lines that are there: a header may name any number of them.
            rows = [tuple(line.split()) for line in islice(file, count)]
            if len(rows) < count or any(len(row) != len(properties) for row in rows):
                raise ValueError(f"not {count} lines of {len(properties)} numbers")
            return np.array(rows, dtype)
        points = np.fromfile(file, dtype, count)
    if len(points) < count:
        raise ValueError(f"{len(points)} of {count} vertices are in it")
    return points


def _header(file: BinaryIO) -> tuple[str, int, list[tuple[str, str]]]:
    if file.readline().strip() != b"ply":
        raise ValueError("no PLY file")
    form, count, properties, element = "", -1, list[tuple[str, str]](), ""
    for _ in range(MOST_LINES):
        words = file.readline().decode("ascii", "replace").split()
        if len(words) < LEAST_WORDS.get(words[0] if words else "", 0):
            raise ValueError(f"its header has a line '{' '.join(words)}'")
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            if element == "" and words[1] != "vertex":
                raise ValueError(f"its first element is {words[1]}, not vertex")
            element = words[1]
            count = int(words[2]) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            if words[1] not in TYPES:
                raise ValueError(f"property {words[-1]} of type {words[1]} is no single number")
            properties.append((words[1], words[2]))
        elif words == ["end_header"]:
            if form not in FORMATS or count < 0:
                raise ValueError(
                    f"no vertices, or its format {form} is none of {', '.join(FORMATS)}"
                )
            return form, count, properties
    raise ValueError("its header has no end")
