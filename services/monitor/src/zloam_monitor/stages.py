"""The stages of a robot, from services/stages.json (docs/add-a-stage.md)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAME = "stages.json"
#: written by the stages whose progress paces a replay
ACK = "flow/<sink>/ack"


@dataclass(frozen=True)
class Row:
    """One stage."""

    name: str
    summary: str
    #: from the sensor to the pose or the map: started, waited for and shown
    in_chain: bool
    #: whether any number of instances may work at once
    replicas: bool
    #: key patterns; what it has no sweep without, first
    reads: tuple[str, ...]
    #: key patterns; what it has one of for each sweep, first
    writes: tuple[str, ...]


def _file() -> Path:
    """Beside this module where it was installed, else in the checkout."""
    here = Path(__file__).resolve()
    installed = here.with_name(NAME)
    return installed if installed.is_file() else here.parents[3] / NAME


def _rows() -> dict[str, Row]:
    rows: list[dict[str, Any]] = json.loads(_file().read_text())
    for row in rows:
        row.update(reads=tuple(row["reads"]), writes=tuple(row["writes"]))
    return {row["name"]: Row(**row) for row in rows}


def _pose_path() -> tuple[str, ...]:
    """From the source to who gives out the pose, along what each has no sweep without."""
    writers = {pattern: row for row in ROWS.values() for pattern in row.writes}
    path = [writers["pose"]]
    while path[-1].reads:
        path.append(writers[path[-1].reads[0]])
    return tuple(row.name for row in reversed(path))


#: name -> row, in the order of the data
ROWS = _rows()
#: order of the ports: stage i listens on base port + i
PORT_ORDER = tuple(ROWS)
#: the chain from the sensor to pose and map
STAGES = tuple(name for name, row in ROWS.items() if row.in_chain)
#: stages on the way of a pose; what mapping skips costs no pose
POSE_PATH = _pose_path()
