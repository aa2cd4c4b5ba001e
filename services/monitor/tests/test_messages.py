"""The numpy dtypes agree with the structs of the schemas, and written messages can be read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import flatbuffers
import numpy as np
import pytest

from zloam_monitor import messages, records


@pytest.fixture(autouse=True)
def _needs_generated_code() -> None:
    try:
        messages.schemas_path()
    except messages.SchemasMissing as missing:
        pytest.skip(str(missing))


#: Fields of structs that contain a Pose.
POSES = ("pose", "map", "world")


def generated_value(struct: Any, path: tuple[str, ...]) -> Any:
    """Reads a path such as x or translation.x with the generated accessors."""
    for name in path[:-1]:
        accessor = "".join(part.capitalize() for part in name.split("_"))
        inner = messages.STRUCTS["Pose"] if name in POSES else None
        type_name = "Pose" if inner is not None else ("Quat" if name == "rotation" else "Vec3")
        child = getattr(messages.module(type_name), type_name)()
        struct = getattr(struct, accessor)(child)
    return getattr(struct, "".join(part.capitalize() for part in path[-1].split("_")))()


def leaves(dtype: np.dtype[Any], prefix: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name in dtype.names:
        field = dtype.fields[name][0]
        if field.names:
            yield from leaves(field, (*prefix, name))
        else:
            yield (*prefix, name)


@pytest.mark.parametrize("name", sorted(messages.STRUCTS))
def test_dtype_equals_the_struct_of_the_schema(name: str) -> None:
    dtype = messages.STRUCTS[name]
    generated = getattr(messages.module(name), name)
    assert dtype.itemsize == generated.SizeOf()
    # Each byte differs from those near it: a wrong offset or type of a field gives another value.
    raw = bytes((i * 37 + 11) % 120 + 1 for i in range(dtype.itemsize))
    struct = generated()
    struct.Init(bytearray(raw), 0)
    row = np.frombuffer(raw, dtype, 1)[0]
    for path in leaves(dtype):
        value = row
        for part in path:
            value = value[part]
        assert generated_value(struct, path) == value, path


def test_every_schema_has_its_kind_here() -> None:
    root = Path(__file__).resolve().parents[3]
    declared = set()
    for schema in sorted((root / "schemas").glob("*.fbs")):
        identifier = re.search(r'file_identifier "(\w{4})"', schema.read_text())
        if identifier:
            declared.add((schema.stem, identifier[1].encode()))
    assert declared == set(messages.KINDS.values())


def test_struct_vector_round_trip() -> None:
    tile = messages.module("MapTile")
    points = np.zeros(5, messages.MAP_POINT)
    points["x"] = np.arange(5) + 0.5
    points["intensity"] = 7
    builder = flatbuffers.Builder(0)
    vector = messages.put_struct_vector(builder, points)
    tile.MapTileStart(builder)
    tile.MapTileAddPoints(builder, vector)
    tile.MapTileAddI(builder, -3)
    builder.Finish(tile.MapTileEnd(builder), b"ZLTI")
    decoded = messages.decode("MapTile", bytes(builder.Output()))
    assert decoded.I() == -3
    np.testing.assert_array_equal(
        messages.struct_vector(decoded, "Points", messages.MAP_POINT), points
    )


def test_a_foreign_or_short_message_is_refused() -> None:
    with pytest.raises(messages.MessageError):
        messages.decode("MapPose", b"\x08\0\0\0ZLTI" + bytes(64))
    with pytest.raises(messages.MessageError):
        messages.decode("MapPose", b"")


# Found by tests/fuzz/readers.py.
def test_json_nested_deeper_than_the_stack_is_refused() -> None:
    b = flatbuffers.Builder(256)
    stage, nested = b.CreateString("mapping"), b.CreateString("[" * 100_000)
    code = messages.module("EffectiveConfig")
    code.Start(b)
    code.AddStage(b, stage)
    code.AddValuesJson(b, nested)
    b.Finish(code.End(b), messages.KINDS["EffectiveConfig"].identifier)
    with pytest.raises(messages.DECODE_ERRORS):
        records.effective_config(bytes(b.Output()))
