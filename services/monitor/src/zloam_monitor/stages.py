"""The stages of a robot, from services/stages.json (docs/add-a-stage.md)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAME = "stages.json"
#: Key written by the stages whose progress paces a replay.
ACK = "flow/<sink>/ack"


@dataclass(frozen=True)
class Row:
    """Description of one stage."""

    name: str
    summary: str
    #: Part of the chain from the sensor to pose and map: started, waited for and shown.
    in_chain: bool
    #: Any number of instances may work at the same time.
    replicas: bool
    #: Key patterns; the first is the main input, which the stage has no sweep without.
    reads: tuple[str, ...]
    #: Key patterns; the first is the main output, with one message per sweep.
    writes: tuple[str, ...]


def _file() -> Path:
    """The copy beside this module if installed, else the file of the checkout."""
    here = Path(__file__).resolve()
    installed = here.with_name(NAME)
    return installed if installed.is_file() else here.parents[3] / NAME


def _rows() -> dict[str, Row]:
    rows: list[dict[str, Any]] = json.loads(_file().read_text())
    for row in rows:
        row.update(reads=tuple(row["reads"]), writes=tuple(row["writes"]))
    return {row["name"]: Row(**row) for row in rows}


def _pose_path() -> tuple[str, ...]:
    """The stages from the source to the publisher of poses, along their main inputs."""
    writers = {pattern: row for row in ROWS.values() for pattern in row.writes}
    path = [writers["pose"]]
    while path[-1].reads:
        path.append(writers[path[-1].reads[0]])
    return tuple(row.name for row in reversed(path))


def standby_of(stage: str) -> str:
    """Name of the process that `zloam run --standby` starts as a standby; its instance has the time
    of its start in addition."""
    return f"{stage}-standby"


#: Name -> row, in the order of the data flow.
ROWS = _rows()
#: Order of the ports: stage i listens on base port + i.
PORT_ORDER = tuple(ROWS)
#: The chain from the sensor to pose and map.
STAGES = tuple(name for name, row in ROWS.items() if row.in_chain)
#: Stages that read a robot's file: the chain, and those beside it. The simulator does not.
CONFIGURED = tuple(name for name, row in ROWS.items() if row.in_chain or row.reads)
#: Stages that each pose passes. Mapping is not among them: sweeps that it skips have poses, too.
POSE_PATH = _pose_path()
