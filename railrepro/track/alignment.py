"""Track alignments and how data/tracks.toml describes them. A track is a sequence of segments along which curvature,
cant angle and inclination change linearly: straight, clothoid with cant ramp, arc. Serves the paper's section Test
Tracks (Table I)."""

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
LENGTH, RADIUS = between(1e-6, LONGEST, "m"), above(50.0, math.inf, "m", signed=True)


@dataclass(frozen=True)
class Segment:
    """Stretch of a track with the length `length` (m).

    `kappa`, `phi` and `eps` are pairs (value at the start, value at the end), linear in between: curvature (1/m,
    positive to the right), cant angle (rad, positive right side down), inclination (rad, positive uphill).
    """

    length: float
    kappa: tuple[float, float]
    phi: tuple[float, float]
    eps: tuple[float, float]


@dataclass(frozen=True)
class Alignment:
    """Track as a sequence of segments.

    Attributes:
        name (str), segments (tuple of Segment): Name of the track; its segments in order.
        design_speed (float or None): Design speed of a curve entry (m/s); None for a track given by segments.
    """

    name: str
    segments: tuple[Segment, ...]
    design_speed: float | None = None

    @property
    def length(self) -> float:
        """Total length (m)."""
        return sum(segment.length for segment in self.segments)


def superelevation_angle(speed: float, radius: float, unbalanced_acceleration: float) -> float:
    """Cant angle of a curve (rad), with the sign of the radius. InputError if no angle fits.

    `speed` in m/s; `radius` in m, negative for a curve to the left; `unbalanced_acceleration`: lateral acceleration
    that the cant leaves (m/s2). Source: paper, footnote to Table I.
    """
    sine = (speed**2 / abs(radius) - unbalanced_acceleration) / GRAVITY
    if not -1 < sine < 1:
        raise InputError(f"no cant angle gives {unbalanced_acceleration} m/s2 at {speed:.1f} m/s on radius {radius} m")
    return math.copysign(math.asin(sine), radius)


@data.table
class CurveEntry:
    """Entry of data/tracks.toml for a curve entry: a straight, a clothoid with cant ramp, an arc. The cant is chosen so
    that `unbalanced_acceleration_mps2` remains at the design speed. A negative radius is a curve to the left."""

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
        """`Alignment` called `name` with the three segments straight, clothoid and arc."""
        kappa, phi, level = 1 / self.radius_m, self.cant, (0.0, 0.0)
        segments = (
            Segment(self.straight_m, level, level, level),
            Segment(self.clothoid_m, (0.0, kappa), (0.0, phi), level),
            Segment(self.arc_m, (kappa, kappa), (phi, phi), level),
        )
        return Alignment(name, segments, self.design_speed_kmh / 3.6)


@data.table
class SegmentEntry:
    """One segment in data/tracks.toml: its length, and radius, superelevation and inclination at its end.

    Without a key the value is that at the end of the previous segment; a track begins straight and level. A negative
    radius is a curve to the left, inf is straight.
    """

    length_m: Annotated[Number, LENGTH]
    radius_m: Annotated[Number, RADIUS] | None = None
    superelevation_m: Annotated[Number, between(-0.4, 0.4, "m")] | None = None
    inclination_rad: Annotated[Number, between(-0.2, 0.2, "rad")] | None = None


@data.table
class SegmentsEntry:
    """Entry of data/tracks.toml for a track as a tuple of `SegmentEntry`; the first begins straight and level."""

    segments: Annotated[tuple[SegmentEntry, ...], data.NOT_EMPTY]

    def alignment(self, name: str) -> Alignment:
        """`Alignment` called `name`. Each segment starts with the values at the end of the previous one."""
        made, kappa, phi, eps = [], 0.0, 0.0, 0.0
        for entry in self.segments:
            end_kappa = kappa if entry.radius_m is None else 1 / entry.radius_m
            end_phi = phi if entry.superelevation_m is None else math.asin(entry.superelevation_m / CANT_BASE)
            end_eps = eps if entry.inclination_rad is None else entry.inclination_rad
            made.append(Segment(entry.length_m, (kappa, end_kappa), (phi, end_phi), (eps, end_eps)))
            kappa, phi, eps = end_kappa, end_phi, end_eps
        return Alignment(name, tuple(made))


def alignments(path: Path | str | None = None) -> Entries[Alignment]:
    """Dict: name -> `Alignment` of a track in a TOML file, default data/tracks.toml. InputError for a wrong entry."""
    file = data.location(path, paths.source("data/tracks.toml"))
    found: dict = {}
    for name, entry in data.read(file).items():
        piecewise = isinstance(entry, dict) and "segments" in entry
        kind: Any = dict[str, SegmentsEntry] if piecewise else dict[str, CurveEntry]
        found |= data.build(kind, {name: entry}, file.name)
    return Entries({name: entry.alignment(name) for name, entry in found.items()}, "data/tracks.toml")
