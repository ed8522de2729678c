"""Track alignments, and the entries of data/tracks.toml that describe them. Serves the paper's Table I."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from railrepro import data, paths
from railrepro.data import Number, above, between

GRAVITY = 9.81  # m/s2
CANT_BASE = 1.5  # base b of the superelevation b sin(phi) (m): the only standard value that reproduces Table I
MAX_CANT = 0.3  # largest cant angle of a track (rad), twice that of real railways
LONGEST = 1e5  # longest segment, and longest track of a CSV (m)
LENGTH, RADIUS = between(1e-6, LONGEST, "m"), above(50.0, math.inf, "m", signed=True)


@dataclass(frozen=True)
class Segment:
    """Stretch of a track with the length `length` (m), such as a straight, a clothoid with cant ramp or an arc.
    Curvature `kappa` (1/m, positive to the right), cant angle `phi` (rad, positive right side down) and inclination
    `eps` (rad, positive uphill) are pairs: value at the start, value at the end. In between they change linearly."""

    length: float
    kappa: tuple[float, float]
    phi: tuple[float, float]
    eps: tuple[float, float]


@dataclass(frozen=True)
class Alignment:
    """Track as a sequence of segments. `design_speed` (m/s) gives a curve entry its cant; other tracks have None."""

    name: str
    segments: tuple[Segment, ...]
    design_speed: float | None = None

    @property
    def length(self) -> float:
        """Total length (m)."""
        return sum(segment.length for segment in self.segments)


@data.table
class CurveEntry:
    """Curve entry in data/tracks.toml: a straight, a clothoid with cant ramp, an arc. At the design speed, the cant
    leaves the lateral acceleration `unbalanced_acceleration_mps2`. A curve to the left has a negative radius."""

    design_speed_kmh: Annotated[Number, above(0.0, 450.0, "km/h")]
    unbalanced_acceleration_mps2: Annotated[Number, between(-3.0, 3.0, "m/s2")]
    radius_m: Annotated[Number, RADIUS]
    straight_m: Annotated[Number, between(0.0, LONGEST, "m")]
    clothoid_m: Annotated[Number, LENGTH]
    arc_m: Annotated[Number, LENGTH]

    def __post_init__(self):
        if not abs(self.sine_of_cant) <= math.sin(MAX_CANT):
            found, most = CANT_BASE * self.sine_of_cant, CANT_BASE * math.sin(MAX_CANT)
            raise ValueError(f"needs a superelevation of {found:.3g} m, {-most:.3g} to {most:.3g} m is allowed")

    @property
    def sine_of_cant(self) -> float:
        """Sine of the cant angle of the arc, positive right side down. Source: footnote to Table I."""
        centrifugal = (self.design_speed_kmh / 3.6) ** 2 / abs(self.radius_m)
        return math.copysign(1.0, self.radius_m) * (centrifugal - self.unbalanced_acceleration_mps2) / GRAVITY

    def alignment(self, name: str) -> Alignment:
        """Alignment called `name`: straight, clothoid and arc."""
        kappa, phi, level = 1 / self.radius_m, math.asin(self.sine_of_cant), (0.0, 0.0)
        segments = (
            Segment(self.straight_m, level, level, level),
            Segment(self.clothoid_m, (0.0, kappa), (0.0, phi), level),
            Segment(self.arc_m, (kappa, kappa), (phi, phi), level),
        )
        return Alignment(name, segments, self.design_speed_kmh / 3.6)


@data.table
class SegmentEntry:
    """Segment in data/tracks.toml: its length, and radius, superelevation (positive right side down) and inclination
    (positive uphill) at its end. A missing value stays as in the segment before. A negative radius is a curve to the
    left, inf is straight."""

    length_m: Annotated[Number, LENGTH]
    radius_m: Annotated[Number, RADIUS] | None = None
    superelevation_m: Annotated[Number, between(-0.4, 0.4, "m")] | None = None
    inclination_rad: Annotated[Number, between(-0.2, 0.2, "rad")] | None = None


@data.table
class SegmentsEntry:
    """Entry of data/tracks.toml for a track given by its segments. The track begins straight and level."""

    segments: Annotated[tuple[SegmentEntry, ...], data.NOT_EMPTY]

    def alignment(self, name: str) -> Alignment:
        """Alignment called `name`. Each segment starts with the values at the end of the previous one."""
        made, kappa, phi, eps = [], 0.0, 0.0, 0.0
        for entry in self.segments:
            end_kappa = kappa if entry.radius_m is None else 1 / entry.radius_m
            end_phi = phi if entry.superelevation_m is None else math.asin(entry.superelevation_m / CANT_BASE)
            end_eps = eps if entry.inclination_rad is None else entry.inclination_rad
            made.append(Segment(entry.length_m, (kappa, end_kappa), (phi, end_phi), (eps, end_eps)))
            kappa, phi, eps = end_kappa, end_phi, end_eps
        return Alignment(name, tuple(made))


def alignments(path: Path | str | None = None) -> paths.Entries[Alignment]:
    """Read all tracks of a TOML file, default data/tracks.toml, as a dict by name. InputError for a wrong entry."""
    file = data.location(path, paths.source("data/tracks.toml"))
    tracks = {}
    for name, content in data.read(file).items():
        piecewise = isinstance(content, dict) and "segments" in content
        kind: Any = dict[str, SegmentsEntry] if piecewise else dict[str, CurveEntry]
        tracks[name] = data.build(kind, {name: content}, file.name)[name].alignment(name)
    return paths.Entries(tracks, "data/tracks.toml")
