"""Tables made from track alignments, and the track that interpolates in them. Yaw psi is positive to the right, roll
phi positive right side down, pitch eps positive nose up. Serves the paper's section Train-Track Interaction (eqs.
track)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.data import InputError
from railrepro.track.alignment import LONGEST, MAX_CANT, Alignment, Segment, alignments

STEP = 0.5
"""Step of generated tables (m)."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def build_table(alignment: Alignment, step: float = STEP, heading: float = 0.0) -> pd.DataFrame:
    """Tabulate an alignment with a row every `step` (m) from p = 0 on. InputError if it is shorter than a step.

    The columns are p_m, psi_rad, dpsi_dp_1pm, phi_rad, dphi_dp_1pm, eps_rad, deps_dp_1pm, x_m, y_m, z_m. The track
    begins at the origin with the yaw angle `heading` (rad). Ends of segments at multiples of the step are met exactly.
    """
    if not alignment.length >= step:
        raise InputError(f"track {alignment.name}: is {alignment.length:g} m long, at least {step:g} m are needed")
    p = step * np.arange(math.floor(alignment.length / step + 1e-9) + 1)
    starts = np.cumsum([0.0, *(s.length for s in alignment.segments)])
    angle = heading + np.cumsum([0.0, *(s.length * (s.kappa[0] + s.kappa[1]) / 2 for s in alignment.segments)])
    index = np.clip(np.searchsorted(starts, p + 1e-9, side="right") - 1, 0, len(alignment.segments) - 1)
    length = np.array([s.length for s in alignment.segments])[index]
    d = p - starts[index]
    value, slope = {}, {}
    for name in ("kappa", "phi", "eps"):
        ends = np.array([getattr(s, name) for s in alignment.segments])[index]
        slope[name] = (ends[:, 1] - ends[:, 0]) / length
        value[name] = ends[:, 0] + slope[name] * d
    psi = angle[index] + (value["kappa"] - slope["kappa"] * d / 2) * d
    columns = {"p_m": p, "psi_rad": psi, "dpsi_dp_1pm": value["kappa"], "phi_rad": value["phi"]}
    columns |= {"dphi_dp_1pm": slope["phi"], "eps_rad": value["eps"], "deps_dp_1pm": slope["eps"]}
    steps = Track("", pd.DataFrame(columns)).travel(p[:-1], np.diff(p))
    for name, step_along in zip(("x_m", "y_m", "z_m"), steps, strict=True):
        columns[name] = np.append(0.0, np.cumsum(step_along))
    return pd.DataFrame(columns)


@dataclass(frozen=True, eq=False)
class Track:
    """Tabulated track that is interpolated exactly on straights, clothoids, arcs and linear cant ramps.

    Before the first row the track is straight. After the last row it keeps curvature, cant and inclination of that row.

    Attributes:
        name (str): Name of the track.
        table (DataFrame): Table as from `build_table`.
        design_speed (float or None): Design speed (m/s); None if unknown.
    """

    name: str
    table: pd.DataFrame
    design_speed: float | None = None

    @property
    def length(self) -> float:
        """Track coordinate of the last row (m)."""
        return float(self._rows["p"][-1])

    @cached_property
    def _rows(self) -> dict[str, np.ndarray]:
        """Values and slopes of the cell that begins at each row."""
        columns = {"p": "p_m", "psi": "psi_rad", "kappa": "dpsi_dp_1pm", "phi": "phi_rad", "eps": "eps_rad"}
        rows = {name: self.table[column].to_numpy() for name, column in columns.items()}
        for name in ("kappa", "phi", "eps"):
            rows["d" + name] = np.append(np.diff(rows[name]) / np.diff(rows["p"]), 0.0)
        return rows

    def _index(self, p: np.ndarray) -> np.ndarray:
        """Rows at which the cells of positions p begin."""
        return np.clip(np.searchsorted(self._rows["p"], p, side="right") - 1, 0, len(self.table) - 1)

    def interpolate(self, p) -> np.ndarray:
        """Track angles and their derivatives at track coordinates p (m, shape (n,)), shape (6, n).

        The rows are psi (yaw, rad), dpsi_dp (rad/m), phi (roll, rad), dphi_dp (rad/m), eps (pitch, rad), deps_dp
        (rad/m). At the start or end of a cant ramp, dphi_dp is the slope behind that point. Source: eq. (3), without
        the factor dp/dt.
        """
        p, first = np.atleast_1d(np.asarray(p, dtype=float)), self._rows["p"][0]
        index = self._index(p)
        row = {name: values[index] for name, values in self._rows.items()}
        for name in ("kappa", "dkappa", "dphi", "deps"):
            row[name] = np.where(p < first, 0.0, row[name])
        return np.array(track_in(row, p))

    def travel(self, start: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Displacement along n stretches of the track (m), shape (3, n), in fixed axes x, y (right), z (down).

        Stretch i begins at `start` (m, shape (n,)) and has the signed `length` (m, shape (n,)). It has to lie within
        one row of the table.
        """
        total = np.zeros((3, len(start)))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            psi, _, _, _, eps, _ = self.interpolate(start + length * (1 + node) / 2)
            total += weight * np.array([np.cos(eps) * np.cos(psi), np.cos(eps) * np.sin(psi), -np.sin(eps)])
        return total * length / 2

    def position(self, p) -> np.ndarray:
        """Centre line of the track at p (m, shape (n,)): x, y (right), z (down) in fixed axes (m), shape (3, n)."""
        p = np.atleast_1d(np.asarray(p, dtype=float))
        index = self._index(p)
        begin = self._rows["p"][index]
        d, reached = p - begin, self.table[["x_m", "y_m", "z_m"]].to_numpy()[index].T
        longest = 5.0  # stretch of one quadrature (m)
        for k in range(int(np.ceil(np.abs(d).max() / longest)) or 1):
            piece = np.clip(np.abs(d) - k * longest, 0, longest) * np.sign(d)
            moving = piece != 0
            start = begin + k * longest * np.sign(d)
            reached[:, moving] += self.travel(start[moving], piece[moving])
        return reached


def track_in(cell: dict, p) -> tuple:
    """Track angles and their derivatives at a coordinate p (m) inside a cell. Source: eq. (3).

    Returns the tuple psi (yaw), dpsi_dp, phi (roll), dphi_dp, eps (pitch), deps_dp (rad, rad/m). `cell` is a dict of
    the values at the start of the cell (SI): numbers, arrays or CasADi symbols with the keys p, psi, kappa, dkappa,
    phi, dphi, eps, deps.
    """
    d = p - cell["p"]
    psi = cell["psi"] + (cell["kappa"] + cell["dkappa"] * d / 2) * d
    roll = cell["phi"] + cell["dphi"] * d, cell["dphi"]
    return psi, cell["kappa"] + cell["dkappa"] * d, *roll, cell["eps"] + cell["deps"] * d, cell["deps"]


def load_track(name: Path | str) -> Track:
    """`Track` of a name in data/tracks.toml. A name that ends in .csv is the path of a file for `read_table`.
    InputError for an unknown name."""
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
    """Write a table of `build_table` as CSV with 17 digits, so that reading gives the same numbers."""
    table.to_csv(path, index=False, float_format="%.17g")


_LARGEST = {"p_m": (LONGEST, "m"), "dpsi_dp_1pm": (0.02, "1/m"), "phi_rad": (MAX_CANT, "rad"), "eps_rad": (0.2, "rad")}
_LARGEST |= {"psi_rad": (1e3, "rad")}
"""Columns of a track file that are read, and magnitudes beyond which the unit is wrong."""


def read_table(path: Path | str) -> pd.DataFrame:
    """Read a track from a CSV and return a table as of `build_table`, with heading and positions integrated.

    The file has one row per point; curvature, cant and inclination change linearly in between. Yaw is positive to the
    right, roll right side down, pitch nose up. Columns (others are ignored):
    - p_m: distance along the line (m), increasing; the first point becomes the coordinate 0;
    - dpsi_dp_1pm: curvature (1/m);
    - phi_rad, eps_rad: cant angle and inclination (rad), optional, default 0;
    - psi_rad: optional; its first value is the initial heading (rad), default 0.

    InputError for a missing column, a number that is not finite, points that do not increase, and magnitudes beyond
    what railways build (wrong unit).
    """
    file = data.location(path)
    try:
        text = pd.read_csv(file, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({str(error).strip()})") from error
    missing = [column for column in ("p_m", "dpsi_dp_1pm") if column not in text]
    if missing:
        raise InputError(f"{file.name}: the column {missing[0]} is missing among {list(text)}")
    if len(text) < 2:
        raise InputError(f"{file.name}: {len(text)} rows found, at least 2 are needed")
    values = {}
    for column, (largest, unit) in _LARGEST.items():
        numbers = pd.to_numeric(text.get(column, pd.Series(0.0, text.index)), errors="coerce").to_numpy(dtype=float)
        wrong = ~(np.abs(numbers) <= largest)
        if column == "p_m":
            wrong |= np.diff(numbers, prepend=-np.inf) <= 0
        if wrong.any():
            row = int(np.argmax(wrong))
            needed = f"a{'n increasing' * (column == 'p_m')} number up to {largest:g} {unit} is needed (unit?)"
            raise InputError(f"{file.name}: row {row + 2}, {column} is {text[column].iloc[row]!r}, {needed}")
        values[column] = numbers
    p, *shape, heading = values.values()
    segments = tuple(map(Segment, np.diff(p), *map(itertools.pairwise, shape)))
    return build_table(Alignment(file.stem, segments), heading=heading[0])
