"""Tables made from track alignments, and the track that interpolates in them.

Yaw psi is positive to the right, roll phi positive right side down, pitch eps positive nose up.

Serves the paper's section Train-Track Interaction (eqs. track).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths, schema
from railrepro.errors import InputError
from railrepro.track import survey
from railrepro.track.alignment import Alignment, alignments

STEP = 0.5
"""Step of generated tables (m)."""
COLUMNS = (
    *("p_m", "psi_rad", "dpsi_dp_1pm", "phi_rad", "dphi_dp_1pm", "eps_rad", "deps_dp_1pm"),
    *("x_m", "y_m", "z_m"),
)
_PLAUSIBLE = {
    "p_m": (1e6, "m"),
    "psi_rad": (1e3, "rad"),
    "dpsi_dp_1pm": (0.05, "1/m"),
    "phi_rad": (0.3, "rad"),
    "eps_rad": (0.2, "rad"),
    "dphi_dp_1pm": (0.1, "rad/m"),
    "deps_dp_1pm": (0.1, "rad/m"),
    **dict.fromkeys(COLUMNS[-3:], (1e8, "m")),
}
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
        CSV with the columns `COLUMNS`; x_m, y_m, z_m may be missing and are then integrated. Or one with chainage,
        curvature or radius, and cant, see `railrepro.track.survey`; all else is then derived.

    Raises
    ------
    InputError
        Missing column, NaN, p not increasing, implausible magnitude (wrong unit), angles that do not fit their rates or
        positions that do not fit the angles.
    """
    file = schema.location(path)
    if survey.CHAINAGE in head(file):
        numbers = read_numbers(file, (survey.CHAINAGE,), survey.COLUMNS, survey.BLANK)
        numbers = survey.derived(numbers, file.name)
    else:
        numbers = read_numbers(file, COLUMNS[:7], COLUMNS[7:])
    step = np.diff(numbers["p_m"])
    for column, (limit, unit) in _PLAUSIBLE.items():
        if column in numbers:
            allowed = f"up to {limit:g} {unit} is allowed (unit?)"
            survey.refuse(file.name, numbers[column], numbers[column].abs() > limit, allowed)
    _check_rates(file, numbers, step)
    if len(numbers.columns) == len(COLUMNS):
        _check_positions(file, numbers, step)
    else:
        numbers = numbers.assign(**dict(zip(COLUMNS[-3:], _positions(numbers), strict=True)))
    return numbers[list(COLUMNS)]


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
        # A ramp may begin or end beside a row, but a peak that the angle follows on neither side is a spike.
        rise, missed = np.diff(values) / 2, (values[:-1] + values[1:]) / 2 - measured
        ignored = np.where(np.abs(missed) > np.abs(rise) / 2 + tolerance, np.sign(missed), 0)
        spike = (ignored[:-1] * ignored[1:] > 0) & (rise[:-1] * ignored[:-1] > 0) & (rise[1:] * ignored[1:] < 0)
        if spike.any():
            row = int(np.argmax(spike)) + 1
            raise InputError(
                f"{file.name}: row {row + 2}, {rate} = {values[row]:g} is a spike beside {values[row - 1]:g} and "
                f"{values[row + 1]:g} that {angle} does not follow"
            )


def _check_positions(file: Path, table: pd.DataFrame, step: np.ndarray) -> None:
    """Rows must lie apart as their angles say, up to millimetres and what the track turns between them."""
    given = np.diff(table[list(COLUMNS[-3:])].to_numpy(), axis=0).T
    expected = Track("", table).travel(table["p_m"].to_numpy()[:-1], step)
    turned = np.abs(np.diff(table["psi_rad"])) + np.abs(np.diff(table["eps_rad"]))
    apart = np.linalg.norm(given - expected, axis=0)
    wrong = apart > 2e-3 + step * (1e-3 + turned)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{file.name}: row {row + 3}, x_m, y_m, z_m lie {apart[row]:.3g} m from where p_m, psi_rad and eps_rad "
            "lead from the row before"
        )
