"""Tables made from track alignments, and the track that interpolates in them.

Yaw psi is positive to the right, roll phi positive right side down, pitch eps positive nose up.

Serves the paper's section Train-Track Interaction (eqs. track).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.data import InputError
from railrepro.track.alignment import CANT_BASE, LONGEST, MAX_CANT, Alignment, Segment, alignments

STEP = 0.5
"""Step of generated tables (m)."""
COLUMNS = (
    *("p_m", "psi_rad", "dpsi_dp_1pm", "phi_rad", "dphi_dp_1pm", "eps_rad", "deps_dp_1pm"),
    *("x_m", "y_m", "z_m"),
)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def build_table(alignment: Alignment, step: float = STEP, heading: float = 0.0) -> pd.DataFrame:
    """Table of an alignment with the columns `COLUMNS`, a row every `step` (m), from a first heading (rad) on.

    Segment ends that are multiples of the step are met exactly.
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
        columns = {"p": "p_m", "psi": "psi_rad", "kappa": "dpsi_dp_1pm", "phi": "phi_rad", "eps": "eps_rad"}
        rows = {name: self.table[column].to_numpy() for name, column in columns.items()}
        for name in ("kappa", "phi", "eps"):
            rows["d" + name] = np.append(np.diff(rows[name]) / np.diff(self.p), 0.0)
        return rows

    def _cell(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row index and offset d of positions p."""
        index = np.clip(np.searchsorted(self.p, p, side="right") - 1, 0, len(self.p) - 1)
        return index, p - self.p[index]

    def interpolate(self, p) -> np.ndarray:
        """Track angles and rates per metre at coordinates p (m, shape (n,)), shape (6, n).

        psi (rad), dpsi_dp (rad/m), phi (rad), dphi_dp (rad/m), eps (rad), deps_dp (rad/m); rates of a cant ramp are
        right-continuous.

        Source: eq. (3) of the paper, without the factor dp/dt.
        """
        p = np.atleast_1d(np.asarray(p, dtype=float))
        index, _ = self._cell(p)
        row = {name: values[index] for name, values in self._rows.items()}
        for name in row.keys() - {"p", "psi", "phi", "eps"}:
            row[name] = np.where(p < self.p[0], 0.0, row[name])
        return np.array(track_in(row, p))

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


def track_in(cell: dict, p) -> tuple:
    """psi, dpsi_dp, phi, dphi_dp, eps, deps_dp at p inside a cell given by its columns (numbers, arrays or symbols).

    Source: eq. (3).
    """
    d = p - cell["p"]
    psi = cell["psi"] + (cell["kappa"] + cell["dkappa"] * d / 2) * d
    roll = cell["phi"] + cell["dphi"] * d, cell["dphi"]
    return psi, cell["kappa"] + cell["dkappa"] * d, *roll, cell["eps"] + cell["deps"] * d, cell["deps"]


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


_COLUMNS: dict[str, tuple[str, Callable]] = {
    "p_m": ("p", lambda p: p - p[0]),
    "chainage_m": ("p", lambda p: p - p[0]),
    "dpsi_dp_1pm": ("curvature", np.asarray),
    "curvature_1pm": ("curvature", np.asarray),
    "radius_m": ("curvature", lambda radius: np.divide(1.0, radius, out=np.zeros_like(radius), where=radius != 0)),
    "phi_rad": ("cant", np.asarray),
    "cant_m": ("cant", lambda height: np.arcsin(np.clip(height / CANT_BASE, -1.0, 1.0))),
    "cant_mm": ("cant", lambda height: np.arcsin(np.clip(height * 1e-3 / CANT_BASE, -1.0, 1.0))),
    "eps_rad": ("gradient", np.asarray),
    "gradient_permille": ("gradient", lambda rise: np.arctan(1e-3 * rise)),
}
"""Columns of a track file: the quantity that each gives, and what makes it SI."""
_LARGEST = {"p": (LONGEST, "m"), "curvature": (0.02, "1/m"), "cant": (MAX_CANT, "rad"), "gradient": (0.2, "rad")}
_SPIKE = {"p": math.inf, "curvature": 2e-3, "cant": 0.02, "gradient": 0.02}
"""By how much a single row may lie above or below both neighbours."""


def _spikes(values: np.ndarray, least: float) -> np.ndarray:
    """Rows that lie above or below both neighbours by at least so much."""
    rise = np.diff(values)
    alone = (rise[:-1] * rise[1:] < 0) & (np.minimum(np.abs(rise[:-1]), np.abs(rise[1:])) >= least)
    return np.concatenate([[False], alone, [False]])


def read_table(path: Path | str) -> pd.DataFrame:
    """Read a track from a CSV: curvature, cant and gradient at points, which change linearly in between.

    The table has the rows of `build_table`. Heading and positions follow from these columns, of which there is one row
    per point:

    - p_m or chainage_m: distance along the line (m), increasing; the track begins at its first, with coordinate 0;
    - dpsi_dp_1pm or curvature_1pm (1/m), or radius_m (m; 0, inf or empty on a straight): positive in right-hand curves;
    - phi_rad (rad), cant_m (m) or cant_mm (mm), optional: the left rail above the right one is positive;
    - eps_rad (rad) or gradient_permille, optional: a rise is positive;
    - psi_rad (rad), optional: only the first counts, the heading with which the track begins.

    Raises
    ------
    InputError
        A quantity that is missing or there twice, anything but a finite number, points that do not increase, magnitudes
        beyond what railways build (wrong unit), a single row that stands out.
    """
    file = data.location(path)
    choices = {quantity: [c for c, (of, _) in _COLUMNS.items() if of == quantity] for quantity in _LARGEST}
    numbers = read_numbers(
        file, [choices["p"], choices["curvature"]], [choices["cant"], choices["gradient"], ["psi_rad"]]
    )
    values = dict.fromkeys(_LARGEST, np.zeros(len(numbers)))
    for column in numbers.columns.drop("psi_rad", errors="ignore"):
        quantity, in_si = _COLUMNS[column]
        values[quantity] = in_si(numbers[column].to_numpy())
        largest, unit = _LARGEST[quantity]
        beyond = np.abs(values[quantity]) > largest
        refuse(file.name, numbers[column], beyond, f"up to {largest:g} {unit} of {quantity} is allowed (unit?)")
        refuse(file.name, numbers[column], _spikes(values[quantity], _SPIKE[quantity]), "which stands out alone")
    shape = (itertools.pairwise(values[quantity]) for quantity in ("curvature", "cant", "gradient"))
    segments = tuple(map(Segment, np.diff(values["p"]), *shape))
    heading = numbers["psi_rad"].iloc[0] if "psi_rad" in numbers else 0.0
    return build_table(Alignment(file.stem, segments), heading=heading)


def read_numbers(file: Path, needed: Iterable[Sequence[str]], optional: Iterable[Sequence[str]] = ()) -> pd.DataFrame:
    """Finite numbers of a CSV along the track.

    Parameters
    ----------
    file : Path
        CSV whose rows follow the first needed column.
    needed, optional : iterable of sequences of str
        Columns, each with the names that it may have; others are ignored. A column radius_m may be empty or infinite.

    Returns
    -------
    DataFrame
        At least two rows; the columns that are there, in the order asked for, with their names in the file.

    Raises
    ------
    InputError
        A column that is missing or there twice, anything but a finite number, first column not increasing.
    """
    try:
        text = pd.read_csv(file, header=None, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({str(error).strip()})") from error
    head = text.iloc[0].tolist()
    columns, must = [], list(needed)
    for names in [*must, *optional]:
        there = [name for name in head if name in names]
        if len(there) > 1 or (not there and names in must):
            raise InputError(f"{file.name}: has {there or 'none'} of {list(names)} among {head}, one of them is needed")
        columns += there
    if len(text) < 3:
        raise InputError(f"{file.name}: {len(text) - 1} rows found, at least 2 are needed")
    text = text.iloc[1:].set_axis(head, axis="columns").reset_index(drop=True)[columns]
    numbers = text.apply(pd.to_numeric, errors="coerce").astype(float)
    if "radius_m" in numbers:
        straight = (text["radius_m"] == "") | np.isinf(numbers["radius_m"])
        numbers["radius_m"] = numbers["radius_m"].mask(straight, 0.0)
    for row, column in np.argwhere(~np.isfinite(numbers.to_numpy()))[:1]:
        found = f"{columns[column]} is {text.iloc[row, column]!r}"
        raise InputError(f"{file.name}: row {row + 2}, {found}, a finite number is needed")
    along = numbers[columns[0]]
    refuse(file.name, along, np.diff(along, prepend=-np.inf) <= 0, "which does not increase")
    return numbers


def refuse(where: str, values: pd.Series, wrong, allowed: str) -> None:
    """Refuse a column of a CSV with the first of the rows that are wrong; InputError."""
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise InputError(f"{where}: row {row + 2}, {values.name} = {values.iloc[row]:g}, {allowed}")
