"""Random drives: some platform in some world with some lidar, drawn from a seed.

Drives have the speeds, corners, gaits, swings and bumps of real platforms, and the properties of
lidars on the market. motion.hpp refuses only what is physically impossible; no drive is left out
for being hard. zloam-offline reads the description and casts the scans (drive_file.hpp).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Rng = np.random.Generator
Description = dict[str, Any]

#: rays of a whole drive; bounds the duration of a search
RAYS = 5_000_000
FEWEST_SWEEPS, MOST_SWEEPS, LONGEST_S = 80, 250, 80.0
LOWEST_HZ = 2.0
OPEN_WORLDS = ("city", "flat", "field", "park", "tunnel_weak")
#: World whose own drive is taken if the drawn one is too fast for its corners or its traffic.
OWN_DRIVE = "moving"
#: worlds without any surface that faces along them
OPEN_DIRECTION = ("tunnel",)


@dataclass(frozen=True)
class Kind:
    """A kind of platform: its worlds and speeds, and how it shakes."""

    name: str
    worlds: tuple[str, ...]
    speed_mps: tuple[float, float]
    lateral_mps2: tuple[float, float]
    acceleration_mps2: tuple[float, float]
    height_m: tuple[float, float]
    shake: Callable[[Rng], list[Description]]
    #: carried by a person, or walking: takes the preset for that
    carried: bool


def _between(rng: Rng, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 4)


def _even_in_ratio(rng: Rng, low: float, high: float) -> float:
    return round(float(np.exp(rng.uniform(math.log(low), math.log(high)))), 4)


def wave(rng: Rng, axis: str, amplitude: float, hz: float) -> Description:
    """A sine wave; the amplitude is in degrees for rotations, in metres for translations."""
    unit = "deg" if axis in ("roll", "pitch", "yaw") else "m"
    phase = _between(rng, 0.0, 2.0 * math.pi)
    return {"axis": axis, f"amplitude_{unit}": round(amplitude, 5), "hz": hz, "phase_rad": phase}


def bounded_wave(rng: Rng, axis: str, most: float, rate: float, acceleration: float) -> Description:
    """A wave of any frequency with an amplitude of at most `most` that respects the limits of both
    derivatives (deg or m, per s and s²)."""
    hz = _even_in_ratio(rng, 0.2, 5.0)
    turn = 2.0 * math.pi * hz
    largest = min(most, rate / turn, acceleration / turn**2)
    return wave(rng, axis, largest * _even_in_ratio(rng, 0.15, 1.0), hz)


def _mixture(rng: Rng, turns: dict[str, float], lengths: dict[str, float], rate_deg: float) -> Any:
    """Waves on randomly chosen axes, at least one; several waves of one axis share its limits."""
    axes = [*turns, *lengths]
    picked = [axis for axis in axes if rng.random() < 0.55] or [axes[int(rng.integers(len(axes)))]]
    waves = []
    for axis in picked:
        count = int(rng.integers(1, 3))
        for _ in range(count):
            if axis in turns:
                limits = (turns[axis] / count, rate_deg / count, 3000.0 / count)
            else:
                limits = (lengths[axis] / count, 1.0 / count, 12.0 / count)
            waves.append(bounded_wave(rng, axis, *limits))
    return waves


def _shake_vehicle(rng: Rng) -> list[Description]:
    found: list[Description] = _mixture(
        rng, {"roll": 4.0, "pitch": 4.0, "yaw": 2.0}, {"up": 0.06}, 40.0
    )
    return found


def _shake_hand(rng: Rng) -> list[Description]:
    found: list[Description] = _mixture(
        rng,
        {"roll": 20.0, "pitch": 20.0, "yaw": 60.0},
        {"up": 0.08, "side": 0.08, "ahead": 0.05},
        180.0,
    )
    return found


def _shake_head(rng: Rng) -> list[Description]:
    hz = _even_in_ratio(rng, 0.3, 1.2)
    swing = min(_between(rng, 20.0, 80.0), 440.0 / (2.0 * math.pi * hz))
    nod = bounded_wave(rng, "pitch", 12.0, 60.0, 1500.0)
    return [wave(rng, "yaw", swing, hz), nod, wave(rng, "up", 0.03, _between(rng, 1.6, 2.1))]


def _gait(rng: Rng, hz: float, bounce_m: float, tilt_deg: float, yaw_deg: float) -> Any:
    """A gait: up, down and pitch with each step, sideways with each pair of steps."""
    return [
        wave(rng, "up", bounce_m, hz),
        wave(rng, "up", 0.2 * bounce_m, round(2.0 * hz, 4)),
        wave(rng, "pitch", tilt_deg, hz),
        wave(rng, "roll", tilt_deg, round(0.5 * hz, 4)),
        wave(rng, "yaw", yaw_deg, round(0.5 * hz, 4)),
        wave(rng, "side", 0.4 * bounce_m, round(0.5 * hz, 4)),
    ]


def _shake_legs(rng: Rng) -> list[Description]:
    hz, bounce_m = _between(rng, 1.6, 3.0), _between(rng, 0.01, 0.04)
    found: list[Description] = _gait(rng, hz, bounce_m, _between(rng, 1.0, 4.0), 1.5)
    return found


def _shake_runner(rng: Rng) -> list[Description]:
    hz, bounce_m = _between(rng, 2.4, 3.1), _between(rng, 0.03, 0.05)
    tilt_deg, yaw_deg = _between(rng, 1.5, 4.0), _between(rng, 2.0, 8.0)
    found: list[Description] = _gait(rng, hz, bounce_m, tilt_deg, yaw_deg)
    return found


def _shake_drone(rng: Rng) -> list[Description]:
    waves = [
        wave(rng, axis, _between(rng, 3.0, 15.0), _even_in_ratio(rng, 0.2, 0.9))
        for axis in ("roll", "pitch")
    ]
    waves.append(wave(rng, "yaw", _between(rng, 5.0, 60.0), _even_in_ratio(rng, 0.1, 0.4)))
    waves.append(wave(rng, "up", _between(rng, 0.1, 0.8), _even_in_ratio(rng, 0.1, 0.35)))
    waves.append(wave(rng, "pitch", _between(rng, 0.05, 0.25), _between(rng, 5.0, 9.0)))
    return waves


WALKED = ("indoor", "handheld", *OPEN_WORLDS)
KINDS = (
    Kind(
        name="vehicle",
        worlds=(*OPEN_WORLDS, OWN_DRIVE, "tunnel"),
        speed_mps=(3.0, 30.0),
        lateral_mps2=(1.0, 6.0),
        acceleration_mps2=(1.0, 5.0),
        height_m=(1.2, 2.2),
        shake=_shake_vehicle,
        carried=False,
    ),
    Kind(
        name="hand",
        worlds=WALKED,
        speed_mps=(0.5, 2.0),
        lateral_mps2=(0.5, 1.5),
        acceleration_mps2=(0.5, 1.5),
        height_m=(1.0, 1.6),
        shake=_shake_hand,
        carried=True,
    ),
    Kind(
        name="head",
        worlds=WALKED,
        speed_mps=(0.5, 1.8),
        lateral_mps2=(0.5, 1.2),
        acceleration_mps2=(0.5, 1.2),
        height_m=(1.4, 1.8),
        shake=_shake_head,
        carried=True,
    ),
    Kind(
        name="legged",
        worlds=WALKED,
        speed_mps=(0.4, 2.5),
        lateral_mps2=(0.5, 2.0),
        acceleration_mps2=(0.5, 2.0),
        height_m=(0.5, 0.9),
        shake=_shake_legs,
        carried=True,
    ),
    Kind(
        name="runner",
        worlds=("indoor", *OPEN_WORLDS),
        speed_mps=(2.5, 6.0),
        lateral_mps2=(1.5, 3.0),
        acceleration_mps2=(1.5, 3.0),
        height_m=(1.3, 1.7),
        shake=_shake_runner,
        carried=True,
    ),
    Kind(
        name="drone",
        worlds=("city", "flat", "field", "park"),
        speed_mps=(2.0, 12.0),
        lateral_mps2=(2.0, 6.0),
        acceleration_mps2=(2.0, 5.0),
        height_m=(2.5, 6.0),
        shake=_shake_drone,
        carried=True,
    ),
)

#: lowest and highest beam of lidars on the market, by number of beams
FANS = {
    16: ((-15.0, 15.0),),
    32: ((-25.0, 15.0), (-22.5, 22.5), (-45.0, 45.0)),
    64: ((-24.8, 2.0), (-22.5, 22.5), (-45.0, 45.0)),
    128: ((-22.5, 22.5), (-45.0, 45.0), (-25.0, 15.0)),
}


def _lidar(rng: Rng) -> Description:
    rings = int(rng.choice(list(FANS), p=(0.45, 0.25, 0.2, 0.1)))
    low_deg, high_deg = FANS[rings][int(rng.integers(len(FANS[rings])))]
    hz = float(rng.choice((5.0, 10.0, 20.0, 0.0), p=(0.3, 0.4, 0.2, 0.1)))
    hz = hz or _between(rng, LOWEST_HZ, 5.0)
    columns = int(np.clip(18000.0 / hz, 900, 3600)) if rings == 16 else 1024
    view = _between(rng, 90.0, 180.0) if rng.random() < 0.3 else 360.0
    return {
        "rings": rings,
        "low_deg": low_deg,
        "high_deg": high_deg,
        "columns": columns,
        "hz": hz,
        "view_deg": view,
        "view_towards_deg": _between(rng, -180.0, 180.0),
        "noise_m": _between(rng, 0.005, 0.03),
    }


def _dropped(rng: Rng, turns: int, every: int) -> list[int]:
    """Revolutions that do not arrive: all but every n-th, some single ones, some in bursts."""
    lost = {t for t in range(turns) if t % every}
    if rng.random() < 0.4:
        lost |= set(np.flatnonzero(rng.random(turns) < rng.uniform(0.02, 0.2)).tolist())
    if rng.random() < 0.3:
        for _ in range(int(rng.integers(1, 4))):
            first = int(rng.integers(turns))
            lost |= set(range(first, min(turns, first + int(rng.integers(3, 16)))))
    return sorted(lost - {0})


def _stops(rng: Rng, duration_s: float, speed_mps: float, brake_mps2: float) -> list[Description]:
    """Stops, as hard as the platform can brake: the steepest part of a smooth ramp has 1.875 times
    its mean slope."""
    ramp_s = round(max(0.5, 1.875 * speed_mps / brake_mps2), 3)
    stops: list[Description] = []
    at_s = _between(rng, 3.0, 8.0)
    while at_s + 2.0 * ramp_s < duration_s and len(stops) < 4:
        stand_s = _between(rng, 0.2, 3.0)
        stops.append({"at_s": round(at_s, 3), "stand_s": stand_s, "ramp_s": ramp_s})
        at_s += 2.0 * ramp_s + stand_s + _between(rng, 1.0, 6.0)
    return stops


def _bumps(rng: Rng, duration_s: float) -> list[Description]:
    """Speed bumps and kerbs, as the suspension passes them on."""
    return [
        {
            "at_s": _between(rng, 2.0, max(2.5, duration_s)),
            "width_s": width_s,
            "height_m": round(min(_between(rng, 0.02, 0.1), 0.35 * width_s**2 + 0.01), 4),
            "pitch_deg": round(min(_between(rng, 0.5, 5.0), 12.0 * width_s), 3),
        }
        for width_s in (_between(rng, 0.25, 0.8) for _ in range(int(rng.integers(1, 6))))
    ]


def draw(seed: int, number: int) -> tuple[Description, Kind]:
    """The n-th drive of a search; always the same for the same seed."""
    rng = np.random.default_rng([seed, number])
    kind = KINDS[int(rng.choice(len(KINDS), p=(0.35, 0.2, 0.12, 0.13, 0.1, 0.1)))]
    world = str(rng.choice(kind.worlds))
    lidar = _lidar(rng)
    every = int(rng.choice((1, 2, 3, 4, 5), p=(0.6, 0.15, 0.1, 0.05, 0.1)))
    every = max(1, min(every, int(lidar["hz"] / LOWEST_HZ)))
    rays = lidar["rings"] * lidar["columns"] * lidar["view_deg"] / 360.0
    sweeps = int(np.clip(RAYS / rays, FEWEST_SWEEPS, MOST_SWEEPS))
    duration_s = round(min(LONGEST_S, sweeps * every / lidar["hz"]), 3)
    speed_mps = _even_in_ratio(rng, *kind.speed_mps)
    acceleration_mps2 = _between(rng, *kind.acceleration_mps2)
    drive: Description = {
        "seed": 1000 * seed + number,
        "world": world,
        "world_seed": int(rng.integers(1, 10_000)),
        "heading_deg": _between(rng, -180.0, 180.0) if rng.random() < 0.5 else 0.0,
        "speed_mps": speed_mps,
        "acceleration_mps2": acceleration_mps2,
        "lateral_mps2": _between(rng, *kind.lateral_mps2),
        "height_m": _between(rng, *kind.height_m),
        "start_share": _between(rng, 0.0, 0.3 if world.startswith("tunnel") else 1.0),
        "start_s": _between(rng, 2.5, 7.0) if rng.random() < 0.3 else 0.0,
        "duration_s": duration_s,
        "waves": kind.shake(rng),
        "lidar": lidar,
    }
    if rng.random() < 0.35:
        drive["stops"] = _stops(rng, drive["start_s"] + duration_s, speed_mps, acceleration_mps2)
    if kind.name == "vehicle" and rng.random() < 0.5:
        drive["bumps"] = _bumps(rng, drive["start_s"] + duration_s)
    if world == OWN_DRIVE:
        # The world's traffic keeps its distance only to the world's own drive.
        drive["speed_mps"] = 0.0
        drive["heading_deg"] = drive["start_share"] = 0.0
        drive.pop("stops", None)
    drive["dropped"] = _dropped(rng, int(duration_s * lidar["hz"]), every)
    return drive, kind


def in_words(drive: Description, kind: Kind) -> str:
    """The drive in one line, for a report."""
    lidar = drive["lidar"]
    turns = int(drive["duration_s"] * lidar["hz"])
    arrived = 1.0 - len(drive["dropped"]) / max(1, turns)
    waves = [
        f"{w['axis']} {w.get('amplitude_deg', w.get('amplitude_m')):g}"
        f"{'°' if 'amplitude_deg' in w else ' m'} at {w['hz']:.2g} Hz"
        for w in drive["waves"]
    ]
    speed = f"up to {drive['speed_mps']:.1f} m/s" if drive["speed_mps"] else "own drive"
    parts = [
        f"{kind.name} in {drive['world']}, {speed}",
        f"{lidar['rings']} beams at {lidar['hz']:g} Hz, {arrived:.0%} of turns arrive",
        f"noise {1e3 * lidar['noise_m']:.0f} mm",
        *([f"view {lidar['view_deg']:.0f}°"] if lidar["view_deg"] < 360 else []),
        *(["begins in motion"] if drive["start_s"] else []),
        *([f"{len(drive['stops'])} stops"] if drive.get("stops") else []),
        *([f"{len(drive['bumps'])} bumps"] if drive.get("bumps") else []),
        ", ".join(waves),
    ]
    return "; ".join(parts)
