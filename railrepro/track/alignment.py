"""Track alignments and how data/tracks.toml describes them.

A track is a sequence of segments along which curvature, cant angle and inclination change linearly: straight, clothoid
with cant ramp, arc.

Serves the paper's section Test Tracks (Table I).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from railrepro import data, paths
from railrepro.data import InputError, Number, above, between
from railrepro.paths import Entries

GRAVITY = 9.81
CANT_BASE = 1.5
"""Base of the superelevation (m): the only standard value that reproduces Table I, with b sin(phi)."""
MAX_CANT = 0.3
"""Largest cant angle of a track (rad), 0.44 m on the standard base: twice what railways build."""
LONGEST = 1e5
"""Longest segment, and longest track of a CSV (m)."""
LENGTH, RADIUS = above(0.0, LONGEST, "m"), above(50.0, math.inf, "m", signed=True)


@dataclass(frozen=True)
class Segment:
    """Stretch of a track, `length` in m, with pairs (value at its start, at its end), linear in between.

    Curvature kappa (1/m, to the right), cant angle phi (rad, right side down), inclination eps (rad, uphill) positive.
    """

    length: float
    kappa: tuple[float, float]
    phi: tuple[float, float]
    eps: tuple[float, float]


@dataclass(frozen=True)
class Alignment:
    """Track as a named sequence of segments; `design_speed` (m/s) is that of a curve entry, else None."""

    name: str
    segments: tuple[Segment, ...]
    design_speed: float | None = None

    @property
    def length(self) -> float:
        """Total length (m)."""
        return sum(segment.length for segment in self.segments)


def superelevation_angle(speed: float, radius: float, unbalanced_acceleration: float) -> float:
    """Cant angle phi_Tr (rad, with the sign of the radius) that leaves an unbalanced lateral acceleration (m/s2).

    Speed in m/s, radius in m (negative: left-hand curve); InputError where no angle does.

    Source: paper, footnote to Table I.
    """
    sine = (speed**2 / abs(radius) - unbalanced_acceleration) / GRAVITY
    if not -1 < sine < 1:
        raise InputError(f"no cant angle gives {unbalanced_acceleration} m/s2 at {speed:.1f} m/s on radius {radius} m")
    return math.copysign(math.asin(sine), radius)


@data.table
class CurveEntry:
    """Curve entry of data/tracks.toml: straight, clothoid with cant ramp, and arc (negative radius: to the left).

    The cant of the arc leaves the given unbalanced lateral acceleration at the design speed.
    """

    design_speed_kmh: Annotated[Number, above(0.0, 450.0, "km/h")]
    unbalanced_acceleration_mps2: Annotated[Number, between(-3.0, 3.0, "m/s2")]
    radius_m: Annotated[Number, RADIUS]
    straight_m: Annotated[Number, between(0.0, LONGEST, "m")]
    clothoid_m: Annotated[Number, LENGTH]
    arc_m: Annotated[Number, LENGTH]

    def __post_init__(self):
        if not abs(self.cant) <= MAX_CANT:
            raise ValueError(f"needs a cant angle of {self.cant:.3g} rad, up to {MAX_CANT} rad either side is allowed")

    @property
    def cant(self) -> float:
        """Cant angle of the arc (rad)."""
        return superelevation_angle(self.design_speed_kmh / 3.6, self.radius_m, self.unbalanced_acceleration_mps2)

    def alignment(self, name: str) -> Alignment:
        """Alignment with this name and the segments straight, clothoid and arc."""
        kappa, phi, level = 1 / self.radius_m, self.cant, (0.0, 0.0)
        segments = (
            Segment(self.straight_m, level, level, level),
            Segment(self.clothoid_m, (0.0, kappa), (0.0, phi), level),
            Segment(self.arc_m, (kappa, kappa), (phi, phi), level),
        )
        return Alignment(name, segments, self.design_speed_kmh / 3.6)


@data.table
class SegmentEntry:
    """Segment of data/tracks.toml: length, and radius (negative: left), superelevation and inclination at its end.

    A missing key keeps the value at the end of the previous segment; a track begins straight and level. `radius_m` of
    a straight is inf.
    """

    length_m: Annotated[Number, LENGTH]
    radius_m: Annotated[Number, RADIUS] | None = None
    superelevation_m: Annotated[Number, between(-0.4, 0.4, "m")] | None = None
    inclination_rad: Annotated[Number, between(-0.2, 0.2, "rad")] | None = None


@data.table
class SegmentsEntry:
    """Track of data/tracks.toml that is given as a list of segments."""

    segments: Annotated[tuple[SegmentEntry, ...], data.NOT_EMPTY]

    def alignment(self, name: str) -> Alignment:
        """Alignment with this name and these segments, each starting with the end values of the previous one."""
        made, kappa, phi, eps = [], 0.0, 0.0, 0.0
        for entry in self.segments:
            end_kappa = kappa if entry.radius_m is None else 1 / entry.radius_m
            end_phi = phi if entry.superelevation_m is None else math.asin(entry.superelevation_m / CANT_BASE)
            end_eps = eps if entry.inclination_rad is None else entry.inclination_rad
            made.append(Segment(entry.length_m, (kappa, end_kappa), (phi, end_phi), (eps, end_eps)))
            kappa, phi, eps = end_kappa, end_phi, end_eps
        return Alignment(name, tuple(made))


def alignments(path: Path | str | None = None) -> Entries[Alignment]:
    """Alignments of a TOML file (default data/tracks.toml) by name; InputError for a wrong entry."""
    file = data.location(path, paths.source("data/tracks.toml"))
    found: dict = {}
    for name, entry in data.read(file).items():
        piecewise = isinstance(entry, dict) and "segments" in entry
        kind: Any = dict[str, SegmentsEntry] if piecewise else dict[str, CurveEntry]
        found |= data.build(kind, {name: entry}, file.name)
    return Entries({name: entry.alignment(name) for name, entry in found.items()}, "data/tracks.toml")
