"""Sessions of a simulated scanner on a motor, with the motor's angles, IMU readings and truth."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

#: Errors of a mount and its encoder that the calibration has to find: pitch and yaw, y and z,
#: delay.
MOUNT_DEG, MOUNT_M, DELAY_MS = (0.6, -0.9), (0.015, -0.03), 7.5
#: Stamps of lines are late by the time that their transmission takes.
RECEIVED_LATE_MS = 2.0
#: The simulator's options for the errors above.
MOUNTED: tuple[object, ...] = (
    *("--scanner-rpy-deg", 0, *MOUNT_DEG, "--scanner-xyz", 0, *MOUNT_M),
    *("--encoder-delay", 1e-3 * DELAY_MS),
)


@dataclass(frozen=True)
class Session:
    """The files of a session."""

    log: Path
    truth: Path
    imu: Path

    @property
    def angles(self) -> Path:
        """The path at which the driver looks for the motor's angles."""
        return self.log.with_suffix(".csv")


def session(build: Path, stem: Path, *options: object) -> Session:
    """Simulates a session into files with this stem."""
    made = Session(*(stem.with_name(stem.name + end) for end in (".logr", ".tum", ".imu.csv")))
    command = [build / "bin" / "zloam-simulator", "--quiet", "--hokuyo", *options]
    command += ["--session", made.log, "--angles", made.angles]
    command += ["--truth", made.truth, "--imu", made.imu]
    subprocess.run([str(word) for word in command], check=True, capture_output=True)
    return made


def at_rest(build: Path, stem: Path, world: str, seed: int) -> Session:
    """A minute at rest with the mount above."""
    where = ["--world", world, "--seed", seed, "--still", "--duration", 60]
    return session(build, stem, *where, *MOUNTED)
