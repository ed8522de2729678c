"""Track alignments and how data/tracks.toml describes them.

A track is a sequence of segments along which curvature, cant angle and inclination change linearly: straight, clothoid
with cant ramp, arc.

Serves the paper's section Test Tracks (Table I).
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

from railrepro import paths
from railrepro.errors import InputError

GRAVITY = 9.81
CANT_BASE = 1.5
"""Base of the superelevation (m): the only standard value that reproduces Table I, with b sin(phi)."""


@dataclass(frozen=True)
class Segment:
    """Stretch with linear curvature kappa (1/m), cant angle phi (rad) and inclination eps (rad), start to end."""

    length: float
    kappa: tuple[float, float]
    phi: tuple[float, float]
    eps: tuple[float, float]


@dataclass(frozen=True)
class Alignment:
    """Named sequence of segments; `design_speed` in m/s or None."""

    name: str
    segments: tuple[Segment, ...]
    design_speed: float | None = None

    @property
    def length(self) -> float:
        """Total length (m)."""
        return sum(segment.length for segment in self.segments)


def superelevation_angle(speed: float, radius: float, unbalanced_acceleration: float) -> float:
    """Cant angle that leaves an unbalanced lateral acceleration.

    Parameters
    ----------
    speed, radius, unbalanced_acceleration : float
        m/s, m (negative: left-hand curve), m/s2.

    Returns
    -------
    float
        phi_Tr (rad), with the sign of the radius.

    Source: paper, footnote to Table I.
    """
    sine = (speed**2 / abs(radius) - unbalanced_acceleration) / GRAVITY
    if not -1 < sine < 1:
        raise InputError(f"no cant angle gives {unbalanced_acceleration} m/s2 at {speed:.1f} m/s on radius {radius} m")
    return math.copysign(math.asin(sine), radius)


def superelevation(angle: float) -> float:
    """Height difference of the rails b sin(phi) (m) for a cant angle (rad)."""
    return CANT_BASE * math.sin(angle)


def alignments(path: Path | str | None = None) -> dict[str, Alignment]:
    """Alignments of a TOML file (default data/tracks.toml) by name; InputError with one sentence on wrong entries."""
    file = Path(path) if path else paths.source("data/tracks.toml")
    try:
        content = tomllib.loads(file.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{file.name}: cannot be read as TOML ({error})") from error
    return {name: _alignment(file, name, entry) for name, entry in content.items()}


_CURVE = {
    *("design_speed_kmh", "unbalanced_acceleration_mps2", "radius_m"),
    *("straight_m", "clothoid_m", "arc_m"),
}
_SEGMENT = {"length_m", "radius_m", "superelevation_m", "inclination_rad"}


def _alignment(file: Path, name: str, entry: dict) -> Alignment:
    where = f"{file.name}: [{name}]"
    if "segments" in entry:
        _check_keys(where, entry, {"segments"}, {"segments", "design_speed_kmh"})
        speed = entry.get("design_speed_kmh")
        return Alignment(name, _segments(where, entry["segments"]), None if speed is None else speed / 3.6)
    _check_keys(where, entry, _CURVE, _CURVE)
    for key in _CURVE - {"radius_m", "unbalanced_acceleration_mps2", "straight_m"}:
        _check_number(where, key, entry[key], 0.0)
    speed, radius = entry["design_speed_kmh"] / 3.6, entry["radius_m"]
    _check_number(where, "radius_m", abs(radius), 50.0)
    phi = superelevation_angle(speed, radius, entry["unbalanced_acceleration_mps2"])
    kappa, level = 1 / radius, (0.0, 0.0)
    segments = (
        Segment(entry["straight_m"], level, level, level),
        Segment(entry["clothoid_m"], (0.0, kappa), (0.0, phi), level),
        Segment(entry["arc_m"], (kappa, kappa), (phi, phi), level),
    )
    return Alignment(name, segments, speed)


def _segments(where: str, entries: list[dict]) -> tuple[Segment, ...]:
    kappa = phi = eps = 0.0
    segments = []
    for i, entry in enumerate(entries):
        place = f"{where} segment {i + 1}"
        _check_keys(place, entry, {"length_m"}, _SEGMENT)
        _check_number(place, "length_m", entry["length_m"], 0.0)
        end = kappa, phi, eps
        if "radius_m" in entry:
            _check_number(place, "radius_m", abs(entry["radius_m"]), 50.0)
            end = 1 / entry["radius_m"], *end[1:]
        if "superelevation_m" in entry:
            _check_number(place, "superelevation_m", abs(entry["superelevation_m"]), -1.0, 0.4)
            end = end[0], math.asin(entry["superelevation_m"] / CANT_BASE), end[2]
        if "inclination_rad" in entry:
            _check_number(place, "inclination_rad", abs(entry["inclination_rad"]), -1.0, 0.2)
            end = *end[:2], entry["inclination_rad"]
        segments.append(Segment(entry["length_m"], (kappa, end[0]), (phi, end[1]), (eps, end[2])))
        kappa, phi, eps = end
    if not segments:
        raise InputError(f"{where} has no segments, at least one is needed")
    return tuple(segments)


def _check_keys(where: str, entry: dict, needed: set[str], allowed: set[str]) -> None:
    for key in sorted(set(entry) - allowed):
        raise InputError(f"{where} has the unknown key {key!r}; allowed are {sorted(allowed)}")
    for key in sorted(needed - set(entry)):
        raise InputError(f"{where} lacks the key {key!r}")


def _check_number(where: str, key: str, value, low: float, high: float = math.inf) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low < value <= high:
        raise InputError(f"{where}: {key} is {value!r}, a number above {low:g} and up to {high:g} is needed")
