"""Optional stages beside the chain: the pose graph for loops, and the tile store."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from zloam_monitor.failures import Misuse

#: Longer than a tile store on a slow disk takes to start.
STORE_LINK_S = 10.0


class BesideError(Misuse):
    """The map folder cannot be used in this way; the text says why."""


def has_map(folder: Path) -> bool:
    """True if the tile store has written something to this folder. When it opens a folder, it
    creates an empty log (services/store/record_log.cpp)."""
    files = [path for path in folder.glob("[0-9]*") if path.stem.isdigit()]
    return any(path.suffix in (".base", ".log") and path.stat().st_size > 0 for path in files)


@dataclass(frozen=True)
class Beside:
    """The optional stages that the user asked for."""

    graph: bool
    map: Path | None
    localize: bool = False
    extend: bool = False
    #: Stage -> program that replaces it (methods.programs).
    programs: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if other := self.programs.get("mapping"):
            self._check_other_mapping(other)
        if self.map is None:
            if self.mode != "map":
                raise BesideError(f"--{self.mode} needs a map: --map FOLDER")
            return
        if self.localize and self.extend:
            raise BesideError("--localize leaves the map as it is, --extend maps on: choose one")
        if self.mode != "map" and not has_map(self.map):
            raise BesideError(
                f"{self.map} holds no map: name the folder of --map FOLDER (MAP=) of an earlier run"
            )
        if self.mode == "map" and has_map(self.map):
            raise BesideError(
                f"{self.map} holds a map already: name a new folder, or find the robot in it "
                "with --localize, or with --extend to map on"
            )
        if self.mode == "map" and self.map.exists() and any(self.map.iterdir()):
            raise BesideError(f"{self.map} is not empty, but holds no map: name a new folder")

    def _check_other_mapping(self, program: str) -> None:
        """Another mapping begins a map in any case, which replaces the stored one, and makes no
        submaps."""
        asked = "--graph" if self.graph else f"--{self.mode}" if self.mode != "map" else ""
        if asked:
            raise BesideError(
                f"{asked} needs mapping itself, not {program}: leave out --method, or name by it "
                "only the other stages, as in --method registration=aloam,odometry=aloam"
            )

    @property
    def mode(self) -> str:
        """Value of mapping.mode."""
        return "localize" if self.localize else "extend" if self.extend else "map"

    def stages(self) -> tuple[str, ...]:
        return (*(("graph",) if self.graph else ()), *(("store",) if self.map else ()))

    def settings(self) -> list[str]:
        """Settings for the stages; settings of the user override them."""
        if self.map is None:
            return []
        link = f"mapping.store_link_s={STORE_LINK_S}"
        return [f"store.path={self.map.resolve()}", link, f"mapping.mode={self.mode}"]
