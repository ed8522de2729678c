"""Track alignments and the tables made from them.

A track is a sequence of segments along which curvature, cant angle and inclination change linearly: straight, clothoid
with cant ramp, arc. Yaw psi is positive to the right, roll phi positive right side down, pitch eps positive nose up.

Serves the paper's sections Train-Track Interaction (eqs. track) and Test Tracks (Table I).
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.errors import InputError

GRAVITY = 9.81
CANT_BASE = 1.5
"""Base of the superelevation (m): the only standard value that reproduces Table I, with b sin(phi)."""
STEP = 0.5
"""Step of generated tables (m)."""
COLUMNS = (
    *("p_m", "psi_rad", "dpsi_dp_1pm", "phi_rad", "dphi_dp_1pm", "eps_rad", "deps_dp_1pm"),
    *("x_m", "y_m", "z_m"),
)
_PLAUSIBLE = {
    "dpsi_dp_1pm": (0.05, "1/m"),
    "phi_rad": (0.3, "rad"),
    "eps_rad": (0.2, "rad"),
    "dphi_dp_1pm": (0.1, "rad/m"),
    "deps_dp_1pm": (0.1, "rad/m"),
}
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


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


def build_table(alignment: Alignment, step: float = STEP) -> pd.DataFrame:
    """Table of an alignment with the contract columns.

    Parameters
    ----------
    alignment : Alignment
    step : float
        Distance of the rows (m); segment ends that are multiples of it are met exactly.

    Returns
    -------
    DataFrame
        Columns `COLUMNS`, one row per sample of p.
    """
    p = step * np.arange(math.floor(alignment.length / step + 1e-9) + 1)
    starts = np.cumsum([0.0, *(s.length for s in alignment.segments)])
    angle = np.cumsum([0.0, *(s.length * (s.kappa[0] + s.kappa[1]) / 2 for s in alignment.segments)])
    index = np.clip(np.searchsorted(starts, p + 1e-9, side="right") - 1, 0, len(alignment.segments) - 1)
    length = np.array([s.length for s in alignment.segments])[index]
    d = p - starts[index]
    value, slope = {}, {}
    for name in ("kappa", "phi", "eps"):
        ends = np.array([getattr(s, name) for s in alignment.segments])[index]
        slope[name] = (ends[:, 1] - ends[:, 0]) / length
        value[name] = ends[:, 0] + slope[name] * d
    psi = angle[index] + (value["kappa"] - slope["kappa"] * d / 2) * d
    columns = (p, psi, value["kappa"], value["phi"], slope["phi"], value["eps"], slope["eps"])
    table = pd.DataFrame(dict(zip(COLUMNS, columns, strict=False)))
    return table.assign(**dict(zip(COLUMNS[-3:], _positions(table), strict=True)))


def _positions(table: pd.DataFrame) -> np.ndarray:
    """World coordinates of the rows, shape (3, n): Gauss quadrature of the tangent cell by cell."""
    track = Track("", table)
    starts, ends = track.p[:-1], track.p[1:]
    steps = track.travel(starts, ends - starts)
    return np.concatenate([np.zeros((3, 1)), np.cumsum(steps, axis=1)], axis=1)


_PIECE = 5.0
"""Longest stretch of one quadrature (m)."""


@dataclass(frozen=True, eq=False)
class Track:
    """Tabulated track geometry with interpolation that is exact on straights, clothoids, arcs and linear cant ramps.

    Before the first row the track goes straight on, after the last row with the curvature, cant and inclination of the
    last row.
    """

    name: str
    table: pd.DataFrame
    design_speed: float | None = None

    @cached_property
    def p(self) -> np.ndarray:
        """Track coordinates of the rows (m), shape (n,)."""
        return self.table["p_m"].to_numpy()

    @property
    def length(self) -> float:
        """Track coordinate of the last row (m)."""
        return float(self.p[-1])

    @cached_property
    def _rows(self) -> dict[str, np.ndarray]:
        """Values and slopes of the cell that begins at each row."""
        columns = {c: self.table[c].to_numpy() for c in COLUMNS[1:7] if c in self.table}
        step = np.diff(self.p)
        rows = {"psi": columns["psi_rad"], "kappa": columns["dpsi_dp_1pm"], "phi": columns["phi_rad"]}
        rows["eps"] = columns["eps_rad"]
        for name in ("kappa", "phi", "eps"):
            rows["d" + name] = np.append(np.diff(rows[name]) / step, 0.0)
        return rows

    def _cell(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row index and offset d of positions p."""
        index = np.clip(np.searchsorted(self.p, p, side="right") - 1, 0, len(self.p) - 1)
        return index, p - self.p[index]

    def interpolate(self, p) -> np.ndarray:
        """Track angles and rates per metre.

        Parameters
        ----------
        p : array_like, shape (n,)
            Track coordinates (m).

        Returns
        -------
        ndarray, shape (6, n)
            psi (rad), dpsi_dp (rad/m), phi (rad), dphi_dp (rad/m), eps (rad), deps_dp (rad/m); rates of a cant ramp
            are right-continuous.

        Source: eqs. (track) of the paper, without the factor dp/dt.
        """
        p = np.atleast_1d(np.asarray(p, dtype=float))
        index, d = self._cell(p)
        row = {name: values[index] for name, values in self._rows.items()}
        for name in row.keys() - {"psi", "phi", "eps"}:
            row[name] = np.where(p < self.p[0], 0.0, row[name])
        psi = row["psi"] + (row["kappa"] + row["dkappa"] * d / 2) * d
        kappa = row["kappa"] + row["dkappa"] * d
        return np.array(
            [psi, kappa, row["phi"] + row["dphi"] * d, row["dphi"], row["eps"] + row["deps"] * d, row["deps"]]
        )

    def travel(self, start: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Displacement in the world frame along stretches within one row each, shape (3, n) (m)."""
        total = np.zeros((3, len(start)))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            psi, _, _, _, eps, _ = self.interpolate(start + length * (1 + node) / 2)
            total += weight * np.array([np.cos(eps) * np.cos(psi), np.cos(eps) * np.sin(psi), -np.sin(eps)])
        return total * length / 2

    def position(self, p) -> np.ndarray:
        """World coordinates x, y (right), z (down) of the centre line (m), shape (3, n)."""
        p = np.atleast_1d(np.asarray(p, dtype=float))
        index, d = self._cell(p)
        reached = self.table[["x_m", "y_m", "z_m"]].to_numpy()[index].T
        for k in range(int(np.ceil(np.abs(d).max() / _PIECE)) or 1):
            piece = np.clip(np.abs(d) - k * _PIECE, 0, _PIECE) * np.sign(d)
            moving = piece != 0
            start = self.p[index] + k * _PIECE * np.sign(d)
            reached[:, moving] += self.travel(start[moving], piece[moving])
        return reached


def load_track(name: Path | str) -> Track:
    """A track by its name in data/tracks.toml, or from a CSV with the contract columns.

    Raises
    ------
    InputError
        One sentence naming file, row or key, what was found and what is allowed.
    """
    if str(name).endswith(".csv"):
        return Track(Path(name).stem, read_table(name))
    return _built(str(name), paths.source("data/tracks.toml").stat().st_mtime_ns)


@lru_cache
def _built(name: str, _changed: int) -> Track:
    known = alignments()
    if name not in known:
        raise InputError(f"track {name!r} is not in tracks.toml ({sorted(known)}) and is not a CSV file")
    return Track(name, build_table(known[name]), known[name].design_speed)


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a track table so that it reads back exactly."""
    table.to_csv(path, index=False, float_format="%.17g")


def read_table(path: Path | str) -> pd.DataFrame:
    """Read and check a track table.

    Parameters
    ----------
    path : path
        CSV with the columns `COLUMNS`; x_m, y_m, z_m may be missing and are then integrated.

    Returns
    -------
    DataFrame

    Raises
    ------
    InputError
        Missing column, NaN, p not increasing, implausible magnitude (wrong unit) or angles that do not fit their rates.
    """
    file = Path(path)
    try:
        table = pd.read_csv(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({error})") from error
    for column in COLUMNS[:7]:
        if column not in table:
            raise InputError(f"{file.name}: column {column} is missing; found {list(table.columns)}")
    columns = [column for column in COLUMNS if column in table]
    numbers = table[columns].apply(pd.to_numeric, errors="coerce").astype(float)
    if len(numbers) < 2:
        raise InputError(f"{file.name}: {len(numbers)} rows found, at least 2 are needed")
    wrong = ~np.isfinite(numbers.to_numpy())
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        found = table[columns].iloc[row, column]
        found = found if isinstance(found, str) else float(found)
        raise InputError(f"{file.name}: row {row + 2}, {columns[column]} is {found!r}, a finite number is needed")
    step = np.diff(numbers["p_m"])
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 3
        raise InputError(f"{file.name}: row {row}, p_m does not increase ({numbers['p_m'].iloc[row - 2]})")
    for column, (limit, unit) in _PLAUSIBLE.items():
        if (numbers[column].abs() > limit).any():
            row = int(np.argmax(numbers[column].abs() > limit))
            found = numbers[column].iloc[row]
            raise InputError(
                f"{file.name}: row {row + 2}, {column} = {found:g}, up to {limit} {unit} is allowed (unit?)"
            )
    _check_rates(file, numbers, step)
    if len(columns) < len(COLUMNS):
        numbers = numbers.assign(**dict(zip(COLUMNS[-3:], _positions(numbers), strict=True)))
    return numbers[list(COLUMNS)]


def _check_rates(file: Path, table: pd.DataFrame, step: np.ndarray) -> None:
    """Angles must be the integrals of their rates (trapezoid or either end, so ramps may start between rows)."""
    for angle, rate in (("psi_rad", "dpsi_dp_1pm"), ("phi_rad", "dphi_dp_1pm"), ("eps_rad", "deps_dp_1pm")):
        measured = np.diff(table[angle]) / step
        values = table[rate].to_numpy()
        low, high = np.minimum(values[:-1], values[1:]), np.maximum(values[:-1], values[1:])
        tolerance = 1e-6 + 1e-3 * np.abs(values).max()
        outside = (measured < low - tolerance) | (measured > high + tolerance)
        if outside.any():
            row = int(np.argmax(outside))
            raise InputError(
                f"{file.name}: row {row + 2}, {rate} = {values[row]:g} does not fit {angle}, which changes by "
                f"{measured[row]:g} per metre"
            )


_IRREGULARITIES = {
    "erri_low": (2.119e-7, 4.032e-7),
    "erri_high": (6.125e-7, 10.80e-7),
}
_WAVE = {"c": 0.8246, "r": 0.0206, "s": 0.4380}
_HALF_BASE = 0.75


def irregularity_spectrum(spectrum: str, channel: str, wavenumber: np.ndarray) -> np.ndarray:
    """One-sided power spectral density of an irregularity channel.

    Parameters
    ----------
    spectrum : str
        "erri_low" or "erri_high".
    channel : str
        "lateral", "vertical" (m^2/(rad/m)) or "crosslevel" (rad^2/(rad/m)).
    wavenumber : ndarray
        Angular wavenumber (rad/m).

    Returns
    -------
    ndarray

    Source: ERRI B176.
    """
    if spectrum not in _IRREGULARITIES:
        raise InputError(f"spectrum {spectrum!r} is not known; there are {sorted(_IRREGULARITIES)}")
    lateral, vertical = _IRREGULARITIES[spectrum]
    w2, c2, r2, s2 = wavenumber**2, *(_WAVE[k] ** 2 for k in "crs")
    shape = c2 / ((w2 + r2) * (w2 + c2))
    if channel == "crosslevel":
        return vertical / _HALF_BASE**2 * shape * w2 / (w2 + s2)
    return {"lateral": lateral, "vertical": vertical}[channel] * shape


def irregularities(
    p: np.ndarray, spectrum: str = "erri_low", seed: int = 1, shortest: float = 3.0, longest: float = 100.0
) -> pd.DataFrame:
    """Random realisation of track irregularities, to be superposed on a route.

    Parameters
    ----------
    p : ndarray, shape (n,)
        Track coordinates (m).
    spectrum : str
    seed : int
        Each channel draws from its own generator (seed, channel).
    shortest, longest : float
        Band of wavelengths (m).

    Returns
    -------
    DataFrame
        Columns p_m, lateral_m, vertical_m, crosslevel_rad; faded in and out smoothly over 30 m.
    """
    frequency = np.linspace(1 / longest, 1 / shortest, 1200)
    step = frequency[1] - frequency[0]
    r = np.clip(np.minimum(p - p[0], p[-1] - p) / 30.0, 0, 1)
    fade = r**3 * (10 - 15 * r + 6 * r**2)
    columns = {"p_m": p}
    for i, (channel, unit) in enumerate((("lateral", "m"), ("vertical", "m"), ("crosslevel", "rad"))):
        phase = np.random.default_rng((seed, i)).uniform(0, 2 * np.pi, frequency.size)
        density = 2 * np.pi * irregularity_spectrum(spectrum, channel, 2 * np.pi * frequency)
        waves = np.cos(2 * np.pi * np.outer(p, frequency) + phase)
        columns[f"{channel}_{unit}"] = fade * (waves @ np.sqrt(2 * density * step))
    return pd.DataFrame(columns)
