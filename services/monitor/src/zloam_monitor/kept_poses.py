"""The poses of one kind in a run. A run may take days: the newest poses are kept whole, older ones
packed, about a tenth as large."""

from __future__ import annotations

import struct
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import overload

import numpy as np

from zloam_monitor.records import PoseRecord, TraceStep

#: Poses that are kept whole if all are kept: ten minutes at 10 Hz.
WHOLE = 6000
#: Run, instant, last packet; translation, quaternion, weak translation; configuration revision,
#: health, flags; number of trace steps, the first one's; number of cells of covariance, the first;
#: map.
_ROW = struct.Struct("<Qqq3d4d3dIBBIQIQQ")
#: Number of the stage's name; received, started, published.
_STEP = struct.Struct("<Iqqq")


class PackedPoses(Sequence[PoseRecord]):
    """Poses in the order of their coming; covariances are rounded to 32 bits."""

    def __init__(self) -> None:
        self.sweeps = array("Q")
        self._rows = bytearray()
        self._steps = bytearray()
        self._covariances = array("f")
        self._stages: list[str] = []

    def append(self, pose: PoseRecord) -> None:
        self._rows += _ROW.pack(
            pose.run,
            pose.instant_ns,
            pose.last_packet_ns,
            *map(float, pose.translation),
            *map(float, pose.quaternion),
            *pose.weak_translation,
            pose.config_rev,
            pose.health,
            pose.end_of_run | pose.degenerate << 1 | pose.jump << 2,
            len(pose.trace),
            len(self._steps),
            len(pose.covariance),
            len(self._covariances),
            pose.map_id,
        )
        for step in pose.trace:
            name = self._number(step.stage)
            times_ns = (step.received_ns, step.started_ns, step.published_ns)
            self._steps += _STEP.pack(name, *times_ns)
        self._covariances.extend(pose.covariance)
        self.sweeps.append(pose.sweep)

    def _number(self, stage: str) -> int:
        if stage not in self._stages:
            self._stages.append(stage)
        return self._stages.index(stage)

    def __len__(self) -> int:
        return len(self.sweeps)

    @overload
    def __getitem__(self, row: int) -> PoseRecord: ...
    @overload
    def __getitem__(self, row: slice) -> list[PoseRecord]: ...
    def __getitem__(self, row: int | slice) -> PoseRecord | list[PoseRecord]:
        """Raises IndexError."""
        found = range(len(self))[row]
        return self.pose(found) if isinstance(found, int) else [self.pose(n) for n in found]

    def row(self, sweep: int) -> int | None:
        """Number of the sweep's row, if sweeps ascend."""
        at = bisect_left(self.sweeps, sweep)
        return at if at < len(self.sweeps) and self.sweeps[at] == sweep else None

    def pose(self, row: int) -> PoseRecord:
        run, instant_ns, last_packet_ns, *numbers = _ROW.unpack_from(self._rows, row * _ROW.size)
        config_rev, health, flags, steps, step_at, cells, cell_at, map_id = numbers[10:]
        trace = self._steps[step_at : step_at + steps * _STEP.size]
        return PoseRecord(
            run=run,
            sweep=self.sweeps[row],
            instant_ns=instant_ns,
            translation=np.array(numbers[:3]),
            quaternion=np.array(numbers[3:7]),
            health=health,
            last_packet_ns=last_packet_ns,
            end_of_run=bool(flags & 1),
            trace=tuple(
                TraceStep(self._stages[number], *times_ns)
                for number, *times_ns in _STEP.iter_unpack(trace)
            ),
            degenerate=bool(flags & 2),
            jump=bool(flags & 4),
            weak_translation=(numbers[7], numbers[8], numbers[9]),
            covariance=tuple(self._covariances[cell_at : cell_at + cells]),
            config_rev=config_rev,
            map_id=map_id,
        )


class KeptPoses(Mapping[int, PoseRecord]):
    """Poses by sweep."""

    def __init__(
        self, newest: int | None = None, needed: Callable[[PoseRecord], PoseRecord] | None = None
    ) -> None:
        """Keeps the `newest` poses; None: all. `needed` leaves out what nobody needs of an old
        pose."""
        self._newest, self._needed = newest, needed
        self.clear()

    def clear(self) -> None:
        self._whole: dict[int, PoseRecord] = {}
        self._packed = PackedPoses()
        #: Old ones that came after a later sweep had been packed.
        self._late: dict[int, PoseRecord] = {}
        self._last: int | None = None

    def add(self, pose: PoseRecord) -> bool:
        """False: there is one of this sweep already."""
        if pose.sweep in self:
            return False
        self._whole[pose.sweep] = pose
        self._last = pose.sweep if self._last is None else max(pose.sweep, self._last)
        while len(self._whole) > (WHOLE if self._newest is None else self._newest):
            old = self._whole.pop(next(iter(self._whole)))
            if self._newest is None:
                self._pack(old if self._needed is None else self._needed(old))
        return True

    def _pack(self, pose: PoseRecord) -> None:
        if self._packed.sweeps and pose.sweep < self._packed.sweeps[-1]:
            self._late[pose.sweep] = pose
        else:
            self._packed.append(pose)

    def last(self) -> PoseRecord | None:
        """The pose of the last sweep."""
        if self._last not in self:
            self._last = max(self, default=None)
        return None if self._last is None else self[self._last]

    def __getitem__(self, sweep: int) -> PoseRecord:
        for kept in (self._whole, self._late):
            if sweep in kept:
                return kept[sweep]
        row = self._packed.row(sweep)
        if row is None:
            raise KeyError(sweep)
        return self._packed.pose(row)

    def __contains__(self, sweep: object) -> bool:
        if sweep in self._whole or sweep in self._late:
            return True
        return isinstance(sweep, int) and self._packed.row(sweep) is not None

    def __iter__(self) -> Iterator[int]:
        yield from self._packed.sweeps
        yield from self._late
        yield from self._whole

    def __len__(self) -> int:
        return len(self._packed.sweeps) + len(self._late) + len(self._whole)
