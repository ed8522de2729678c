"""Tables made from track alignments, and the track that interpolates in them.

Yaw psi is positive to the right, roll phi positive right side down, pitch eps positive nose up.

Serves the paper's section Train-Track Interaction (eqs. track).
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.data import InputError
from railrepro.track.alignment import CANT_BASE, Alignment, alignments

STEP = 0.5
"""Step of generated tables (m)."""
COLUMNS = (
    *("p_m", "psi_rad", "dpsi_dp_1pm", "phi_rad", "dphi_dp_1pm", "eps_rad", "deps_dp_1pm"),
    *("x_m", "y_m", "z_m"),
)
_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*")
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def build_table(alignment: Alignment, step: float = STEP) -> pd.DataFrame:
    """Table of an alignment with the columns `COLUMNS`, a row every `step` (m).

    Segment ends that are multiples of the step are met exactly.
    """
    if not alignment.length >= step:
        raise InputError(f"track {alignment.name}: is {alignment.length:g} m long, at least {step:g} m are needed")
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
        """Track angles and rates per metre at coordinates p (m, shape (n,)), shape (6, n).

        psi (rad), dpsi_dp (rad/m), phi (rad), dphi_dp (rad/m), eps (rad), deps_dp (rad/m); rates of a cant ramp are
        right-continuous.

        Source: eq. (3) of the paper, without the factor dp/dt.
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


_QUANTITIES = {
    "p": ("p_m", "chainage_m"),
    "curvature": ("dpsi_dp_1pm", "curvature_1pm", "radius_m"),
    "cant": ("phi_rad", "cant_m", "cant_mm"),
    "gradient": ("eps_rad", "gradient_permille"),
}
"""Columns of a track file by the independent quantity that they give: one of each, cant and gradient optional."""
_LARGEST = {
    **dict.fromkeys(("p_m", "chainage_m"), (1e6, "m")),
    **dict.fromkeys(("dpsi_dp_1pm", "curvature_1pm"), (0.02, "1/m")),
    **{"phi_rad": (0.2, "rad"), "cant_m": (0.3, "m"), "cant_mm": (300.0, "mm")},
    **{"eps_rad": (0.2, "rad"), "gradient_permille": (200.0, "per mille")},
}
_SHARPEST = 50.0
"""Smallest radius (m)."""
_SPIKE = {"curvature": 2e-3, "cant": 0.02, "gradient": 0.02}
"""Least height of a single row above both neighbours that is no track (1/m, rad, rad)."""
_ROW = 5.0
"""Longest distance of two rows of a table that is read (m)."""


def read_table(path: Path | str) -> pd.DataFrame:
    """Read a track from a CSV: curvature, cant and gradient at points, which change linearly in between.

    Heading and positions follow from these columns, of which there is one row per point:

    - p_m, or chainage_m, which may begin anywhere: distance along the line (m), increasing;
    - dpsi_dp_1pm or curvature_1pm (1/m), or radius_m (m; 0, inf or empty on a straight): positive in right-hand curves;
    - phi_rad (rad), cant_m (m) or cant_mm (mm), optional: the left rail above the right one is positive;
    - eps_rad (rad) or gradient_permille, optional: a rise is positive.

    Others are ignored, but for a heading psi_rad (rad), which must fit the curvature: the track begins with its first.

    Raises
    ------
    InputError
        A quantity that is missing or there twice, anything but a finite number, points that do not increase, magnitudes
        beyond what railways build (wrong unit), and single rows that stand out.
    """
    file = data.location(path)
    there = set(head(file))
    columns = {quantity: [c for c in names if c in there] for quantity, names in _QUANTITIES.items()}
    for quantity, found in columns.items():
        if len(found) > 1 or (not found and quantity in ("p", "curvature")):
            names = list(_QUANTITIES[quantity])
            raise InputError(f"{file.name}: has {found or 'none'} of {names}, one of them is needed")
    used = {quantity: found[0] for quantity, found in columns.items() if found}
    numbers = read_numbers(file, tuple(used.values()), ("psi_rad",), blank=("radius_m",))
    for column, (largest, unit) in _LARGEST.items():
        if column in numbers:
            beyond = numbers[column].abs() > largest
            refuse(file.name, numbers[column], beyond, f"up to {largest:g} {unit} is allowed (unit?)")
    if "cant_mm" in numbers and 0 < numbers["cant_mm"].abs().max() < 1:
        most = numbers["cant_mm"].abs().max()
        warnings.warn(f"{file.name}: cant_mm of {most:g} is unusual: is it in mm?", stacklevel=2)
    values = {quantity: _in_si(file.name, numbers[column]) for quantity, column in used.items()}
    for quantity, least in _SPIKE.items():
        if quantity in values:
            refuse(file.name, numbers[used[quantity]], _spikes(values[quantity], least), "which stands out alone")
    zero = np.zeros(len(numbers))
    shape = values["curvature"], values.get("cant", zero), values.get("gradient", zero)
    table = _integrated(values["p"], *shape, heading=numbers["psi_rad"].iloc[0] if "psi_rad" in numbers else 0.0)
    if "psi_rad" in numbers:
        _check_heading(file.name, numbers["psi_rad"], values["p"], values["curvature"], table)
    return table


def _check_heading(where: str, heading: pd.Series, p: np.ndarray, curvature: np.ndarray, table: pd.DataFrame) -> None:
    """Refuse a heading that does not follow from the curvature: one of them, or the distance, has another unit or sign.

    A jump of curvature may lie beside its row.
    """
    turned = np.interp(p, table["p_m"], table["psi_rad"])
    allowed = 1e-3 + 0.01 * np.abs(turned - turned[0]).max() + np.max(np.diff(p) * np.abs(np.diff(curvature)))
    apart = np.abs(heading - turned)
    refuse(where, heading, apart > allowed, "which does not fit the curvature up to there")


def _in_si(where: str, column: pd.Series) -> np.ndarray:
    """Coordinate (m), curvature (1/m) or angle (rad) from a column of a track file."""
    values = column.to_numpy()
    if column.name == "chainage_m":
        return values - values[0]
    if column.name == "radius_m":
        sharp = (column != 0) & (column.abs() < _SHARPEST)
        refuse(where, column, sharp, f"at least {_SHARPEST:g} m, or 0 on a straight, is allowed (unit?)")
        return np.where(values == 0, 0.0, 1 / np.where(values == 0, 1.0, values))
    if column.name in ("cant_m", "cant_mm"):
        return np.arcsin(values * (1e-3 if column.name == "cant_mm" else 1.0) / CANT_BASE)
    return np.arctan(1e-3 * values) if column.name == "gradient_permille" else values


def _spikes(values: np.ndarray, least: float) -> np.ndarray:
    """Rows that lie above or below both neighbours by at least so much."""
    rise = np.diff(values)
    alone = (rise[:-1] * rise[1:] < 0) & (np.minimum(np.abs(rise[:-1]), np.abs(rise[1:])) >= least)
    return np.concatenate([[False], alone, [False]])


def refuse(where: str, values: pd.Series, wrong, allowed: str) -> None:
    """Refuse a column of a CSV with the first of the rows that are wrong; InputError."""
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise InputError(f"{where}: row {row + 2}, {values.name} = {values.iloc[row]:g}, {allowed}")


def _integrated(points: np.ndarray, *values: np.ndarray, heading: float) -> pd.DataFrame:
    """Table of a track from curvature (1/m), cant angle and gradient (rad) at its points (m), and its first heading."""
    pieces = [
        np.linspace(a, b, math.ceil((b - a) / _ROW), endpoint=False) for a, b in zip(points, points[1:], strict=False)
    ]
    p = np.concatenate([*pieces, points[-1:]])
    kappa, phi, eps = (np.interp(p, points, value) for value in values)
    step = np.diff(p)
    psi = heading + np.concatenate([[0.0], np.cumsum(step * (kappa[:-1] + kappa[1:]) / 2)])
    dphi, deps = (np.append(np.diff(angle) / step, 0.0) for angle in (phi, eps))
    table = pd.DataFrame(dict(zip(COLUMNS, (p, psi, kappa, phi, dphi, eps, deps), strict=False)))
    return table.assign(**dict(zip(COLUMNS[-3:], _positions(table), strict=True)))


def head(file: Path) -> list[str]:
    """Names in the first line of a CSV; InputError when it cannot be read or has one of them twice."""
    try:
        names = [str(name) for name in pd.read_csv(file, header=None, nrows=1).iloc[0]]
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({str(error).strip()})") from error
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{file.name}: column {name} is there {names.count(name)} times, once is needed")
        if ";" in name:
            raise InputError(f"{file.name}: columns are separated by ';', commas and decimal points are needed")
    return names


def read_numbers(
    file: Path, needed: Sequence[str], optional: Sequence[str] = (), blank: Sequence[str] = ()
) -> pd.DataFrame:
    """Finite numbers of a CSV along the track.

    Parameters
    ----------
    file : Path
        CSV whose rows follow the first needed column.
    needed, optional : sequence of str
        Columns; others are ignored.
    blank : sequence of str
        Columns in which an empty or infinite entry counts as 0.

    Returns
    -------
    DataFrame
        At least two rows; the columns that are there, in the order asked for.

    Raises
    ------
    InputError
        Missing or repeated column, anything but a finite number, first column not increasing.
    """
    head(file)
    try:
        table = pd.read_csv(file)
        table = table.astype(dict.fromkeys(table.select_dtypes(bool).columns, str))  # truth values are no numbers
        columns = [column for column in (*needed, *optional) if column in table]
        numbers = table[columns].apply(pd.to_numeric, errors="coerce").astype(float)
        for column in set(blank) & set(columns):
            numbers[column] = numbers[column].mask(table[column].isna() | np.isinf(numbers[column]), 0.0)
    except (OSError, ValueError, OverflowError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({str(error).strip()})") from error
    if not table.index.equals(pd.RangeIndex(len(table))):
        raise InputError(
            f"{file.name}: the rows have more fields than the head, which has {list(table.columns)} (decimal commas?)"
        )
    for column in needed:
        if column not in table:
            raise InputError(f"{file.name}: column {column} is missing; found {list(table.columns)}")
    if len(numbers) < 2:
        raise InputError(f"{file.name}: {len(numbers)} rows found, at least 2 are needed")
    wrong = ~np.isfinite(numbers.to_numpy())
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        found = table[columns].iloc[row, column]
        found = found if isinstance(found, str) else float(found)
        raise InputError(
            f"{file.name}: row {row + 2}, {columns[column]} is {found!r}, a finite number is needed"
            + (" (decimal comma? points are needed)" if _DECIMAL_COMMA.fullmatch(str(found)) else "")
        )
    along = numbers[needed[0]]
    step = np.diff(along)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 3
        raise InputError(f"{file.name}: row {row}, {needed[0]} does not increase ({along.iloc[row - 2]})")
    return numbers
