"""Tables of tracks, made from alignments or read from CSV, and the track that interpolates in them. Yaw psi is positive
to the right, roll phi right side down, pitch eps nose up. Serves the paper's section Train-Track Interaction."""

import itertools
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.data import InputError
from railrepro.track.alignment import CANT_BASE, LONGEST, MAX_CANT, Alignment, Segment, alignments

STEP = 0.5  # step of generated tables (m)
SHORTEST = 20.0  # shortest track, the length of a car (m)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def build_table(alignment: Alignment, step: float = STEP, heading: float = 0.0) -> pd.DataFrame:
    """Tabulate an alignment with a row every `step` (m) and at each end of a segment. InputError if it is shorter than
    `SHORTEST`. The columns are p_m, psi_rad, dpsi_dp_1pm, phi_rad, dphi_dp_1pm, eps_rad, deps_dp_1pm, x_m, y_m, z_m.
    The track begins at p = 0 in the origin with the yaw angle `heading` (rad). p_m is rounded to micrometres."""
    if not alignment.length >= SHORTEST:
        needed = f"at least {SHORTEST:g} m are needed (unit?)"
        raise InputError(f"track {alignment.name}: is {alignment.length:g} m long, {needed}")
    starts = np.cumsum([0.0, *(s.length for s in alignment.segments)]).round(6)
    p = np.union1d((step * np.arange(starts[-1] // step + 1)).round(6), starts)
    angle = heading + np.cumsum([0.0, *(s.length * (s.kappa[0] + s.kappa[1]) / 2 for s in alignment.segments)])
    index = np.clip(np.searchsorted(starts, p, side="right") - 1, 0, len(alignment.segments) - 1)
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
    """Track that interpolates in a table from `build_table`, exactly on straights, clothoids, arcs and cant ramps.
    Before the first row the track is straight, after the last one it keeps the curvature; cant and inclination stay as
    in that row. `design_speed` is in m/s, None if unknown."""

    name: str
    table: pd.DataFrame
    design_speed: float | None = None

    @property
    def length(self) -> float:
        """Track coordinate of the last row (m)."""
        return float(self._rows["p"][-1])

    @property
    def chainage(self) -> float:
        """Value of p_m in the first row of the CSV (m); 0 without CSV. Add it to front.p of a run."""
        return self.table.attrs.get(_CHAINAGE, 0.0)

    @cached_property
    def _rows(self) -> dict[str, np.ndarray]:
        """Columns of the table, and slopes of curvature and angles from each row to the next."""
        columns = {"p": "p_m", "psi": "psi_rad", "kappa": "dpsi_dp_1pm", "phi": "phi_rad", "eps": "eps_rad"}
        rows = {name: self.table[column].to_numpy() for name, column in columns.items()}
        for name in ("kappa", "phi", "eps"):
            rows["d" + name] = np.append(np.diff(rows[name]) / np.diff(rows["p"]), 0.0)
        return rows

    def _index(self, p: np.ndarray) -> np.ndarray:
        """Index of the last row at or before each p; 0 where there is none."""
        return np.clip(np.searchsorted(self._rows["p"], p, side="right") - 1, 0, len(self.table) - 1)

    def interpolate(self, p) -> np.ndarray:
        """Track angles and their derivatives at track coordinates p (m, shape (n,)), shape (6, n). The rows are psi
        (yaw, rad), dpsi_dp (rad/m), phi (roll, rad), dphi_dp (rad/m), eps (pitch, rad), deps_dp (rad/m). At a jump the
        derivative is the one towards larger p. Source: eq. (3), without dp/dt."""
        p, first = np.atleast_1d(np.asarray(p, dtype=float)), self._rows["p"][0]
        index = self._index(p)
        row = {name: values[index] for name, values in self._rows.items()}
        for name in ("kappa", "dkappa", "dphi", "deps"):
            row[name] = np.where(p < first, 0.0, row[name])
        return np.array(track_in(row, p))

    def travel(self, start: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Displacement along n stretches of the track (m), shape (3, n), in fixed axes x, y (right), z (down). Each has
        a `start` and a signed `length` (m, both of shape (n,)); none may cross a row of the table."""
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
        for done in np.arange(0.0, np.abs(d).max(), longest):
            going = np.abs(d) > done
            start, piece = begin + done * np.sign(d), np.clip(np.abs(d) - done, 0, longest) * np.sign(d)
            reached[:, going] += self.travel(start[going], piece[going])
        return reached


def track_in(cell: dict, p) -> tuple:
    """Track angles and their derivatives psi (yaw), dpsi_dp, phi (roll), dphi_dp, eps (pitch), deps_dp (rad, rad/m) at
    a coordinate p (m) inside a cell. `cell` maps p, psi, kappa, dkappa, phi, dphi, eps and deps to their values at the
    start of the cell (SI): numbers, arrays or CasADi symbols. Source: eq. (3)."""
    d = p - cell["p"]
    psi = cell["psi"] + (cell["kappa"] + cell["dkappa"] * d / 2) * d
    roll = cell["phi"] + cell["dphi"] * d, cell["dphi"]
    return psi, cell["kappa"] + cell["dkappa"] * d, *roll, cell["eps"] + cell["deps"] * d, cell["deps"]


def load_track(name: Path | str) -> Track:
    """Load a track by its name in data/tracks.toml, or from a file for `read_table` by a path that ends in .csv.
    InputError for an unknown name. Warns if the cant lowers the outer rail of a curve by more than 15 mm."""
    if str(name).endswith(".csv"):
        track = Track(Path(name).stem, read_table(name))
    else:
        track = _built(str(name), paths.source("data/tracks.toml").stat().st_mtime_ns)
    p, kappa, phi = (track._rows[name] for name in ("p", "kappa", "phi"))
    lowered = (np.abs(kappa) > 1e-4) & (-np.sign(kappa) * phi > 0.01)
    if lowered.any():
        needed = "in a right-hand curve curvature and cant are both positive, in a left-hand curve negative"
        found = f"track {track.name}: the cant lowers the outer rail at p = {p[np.argmax(lowered)]:g} m"
        warnings.warn(f"{found}; {needed}", stacklevel=2)
    return track


@lru_cache
def _built(name: str, _changed: int) -> Track:
    """Track of data/tracks.toml. The time of the file's last change is an argument so that the cache notices it."""
    known = alignments()
    if name not in known:
        raise InputError(f"track {name!r} is not in tracks.toml ({sorted(known)}) and is not a CSV file")
    return Track(name, build_table(known[name]), known[name].design_speed)


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table from `build_table` to a CSV with 17 digits, from which the same numbers are read again."""
    table.to_csv(path, index=False, float_format="%.17g")


_ALLOWED = {  # columns of a track file: smallest and largest magnitude, unit
    "p_m": (0.0, 1e7, "m"),
    "dpsi_dp_1pm": (0.0, 0.02, "1/m"),
    "radius_m": (50.0, math.inf, "m"),
    "phi_rad": (0.0, MAX_CANT, "rad"),
    "cant_mm": (0.0, 1e3 * CANT_BASE * math.sin(MAX_CANT), "mm"),
    "eps_rad": (0.0, 0.2, "rad"),
    "psi_rad": (0.0, 1e3, "rad"),
    **dict.fromkeys(("dphi_dp_1pm", "deps_dp_1pm"), (0.0, 1e3, "rad/m")),
    **dict.fromkeys(("x_m", "y_m", "z_m"), (0.0, 1e8, "m")),
}
_INSTEAD = {"dpsi_dp_1pm": "radius_m", "phi_rad": "cant_mm"}  # what a file may have in place of a column of a table
_CHAINAGE = "chainage_m"  # key of `Track.chainage` in the `attrs` of a table
_SPIKE = 5.0  # longest peak of curvature, cant or inclination that is refused as an error in a file (m)


def read_table(path: Path | str) -> pd.DataFrame:
    """Read a track from a CSV into a table like that from `build_table`, with integrated heading and positions.

    The file has one row per point; curvature, cant and inclination change linearly in between. A step of curvature is
    two points 1 mm apart. Columns are separated by commas. Blank lines and lines that begin with # are skipped:

    - p_m: distance along the line, such as the chainage (m), increasing. `Track.chainage` is its first value, at which
      the track coordinate is 0;
    - dpsi_dp_1pm: curvature (1/m), or radius_m: radius (m), inf on a straight; positive in a right-hand curve;
    - phi_rad: cant angle (rad), or cant_mm: height of the left rail above the right one (mm) on a base of 1.5 m;
      positive if the left rail is higher, as in a right-hand curve; default 0;
    - eps_rad: inclination (rad), positive uphill, default 0;
    - psi_rad: heading (rad), growing to the right, of which the first value is the initial heading, default 0;
    - x_m (forward at heading 0), y_m (right), z_m (down), dphi_dp_1pm, deps_dp_1pm: optional.

    Headings, positions and derivatives in the file are not used, but have to agree with the other columns: headings
    within 0.02 rad; positions relative to the first one within 0.1 m plus 2 % of the distance; derivatives within 1e-4
    rad/m of the slope before the point, behind it or between the two.

    InputError for a missing, unknown or doubled column, a cell that is no number, points that do not increase, columns
    that disagree, and values that point to a wrong unit: a track below 20 m or above 100 km, a curvature above 0.02
    1/m, a cant above 0.3 rad or an inclination above 0.2 rad; a peak, whose magnitude exceeds those 2.5 m before and
    behind by more than half of this limit.
    """
    file = data.location(path)
    text = _cells(file)
    refuse = partial(_refuse, file.name, text)
    values = _numbers(text, refuse)
    shape = (values[column] for column in ("dpsi_dp_1pm", "phi_rad", "eps_rad"))
    segments = tuple(map(Segment, np.diff(values["p_m"]), *map(itertools.pairwise, shape)))
    table = build_table(Alignment(file.name, segments), heading=values.get("psi_rad", [0.0])[0])
    _compare(values, table, refuse)
    table.attrs[_CHAINAGE] = float(values["p_m"][0])
    return table


def _cells(file: Path) -> pd.DataFrame:
    """Read the cells of a track file as text, indexed by line number. InputError for wrong columns."""
    lines = data.text(file).removeprefix("\ufeff").splitlines()
    used = {n: line for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")}
    rows = {n: [cell.strip(' "') for cell in line.split(",")] for n, line in used.items()}
    if len(rows) < 3:
        raise InputError(f"{file.name}: {len(rows)} lines found, names of columns and at least 2 rows are needed")
    (_, head), *body = rows.items()
    if set(";\t") & set("".join(head)):
        raise InputError(f"{file.name}: has semicolons or tabs, commas between columns and decimal points are needed")
    for column in head:
        if column not in _ALLOWED or head.count(column) > 1:
            fault = "twice" if column in _ALLOWED else "that is not known"
            raise InputError(f"{file.name}: has a column {column!r} {fault}; allowed are {[*_ALLOWED]}, each once")
    for forms, least in ((("p_m",), 1), (("dpsi_dp_1pm", "radius_m"), 1), (("phi_rad", "cant_mm"), 0)):
        given = [column for column in forms if column in head]
        if not least <= len(given) <= 1:
            raise InputError(f"{file.name}: one column {' or '.join(forms)} is needed, there are {given or head}")
    for n, cells in body:
        if len(cells) != len(head):
            needed = f"{len(head)} are needed, one per column (decimal commas?)"
            raise InputError(f"{file.name}: line {n} has {len(cells)} cells, {needed}")
    return pd.DataFrame([cells for _, cells in body], columns=head, index=[n for n, _ in body])


def _refuse(file: str, text: pd.DataFrame, column: str, wrong: np.ndarray, reason: str) -> None:
    """Raise InputError with the first line in which `column`, or the column in its place, is `wrong`; if any is."""
    if wrong.any():
        cells = text[column if column in text else _INSTEAD[column]][wrong]
        name, line = cells.name, cells.index[0]
        raise InputError(f"{file}: line {line}, {name} is {cells.iloc[0]!r}, {reason}")


def _numbers(text: pd.DataFrame, refuse: Callable) -> dict[str, np.ndarray]:
    """Convert the columns of a track file to numbers, and add curvature, cant angle and inclination if they lack."""
    values = dict.fromkeys(("phi_rad", "eps_rad"), np.zeros(len(text)))
    for column in text:
        values[column] = number = pd.to_numeric(text[column], errors="coerce").to_numpy(dtype=float)
        low, high, unit = _ALLOWED[column]
        bounds = f"up to {high:g}" if math.isfinite(high) else f"of at least {low:g}"
        inside = (np.abs(number) >= low) & (np.abs(number) <= high)
        refuse(column, ~inside, f"a number {bounds} {unit} is needed (unit?)")
    p = values["p_m"]
    refuse("p_m", np.diff(p, prepend=-math.inf).round(6) <= 0, "increasing numbers are needed")
    refuse("p_m", p - p[0] > LONGEST, f"at most {LONGEST:g} m after the first point are needed (unit?)")
    if "radius_m" in values:
        values["dpsi_dp_1pm"] = 1 / values["radius_m"]
    if "cant_mm" in values:
        values["phi_rad"], size = np.arcsin(values["cant_mm"] / (1e3 * CANT_BASE)), np.abs(values["cant_mm"])
        refuse("cant_mm", (size > 0.01) & (size.max() < 1.0), "and none reaches 1 mm (unit?)")
    for column in ("dpsi_dp_1pm", "phi_rad", "eps_rad"):
        size, half = np.abs(values[column]), _ALLOWED[column][1] / 2
        around = np.maximum(np.interp(p - _SPIKE / 2, p, size), np.interp(p + _SPIKE / 2, p, size))
        refuse(column, size - around > half, f"a spike shorter than {_SPIKE:g} m (unit?)")
    return values


def _compare(values: dict[str, np.ndarray], table: pd.DataFrame, refuse: Callable) -> None:
    """Refuse columns of a track file that disagree with the table made from the others."""
    distance = values["p_m"] - values["p_m"][0]
    rows = table.iloc[np.searchsorted(table["p_m"], distance - 6e-7)]
    for column in ("psi_rad", "x_m", "y_m", "z_m", "dphi_dp_1pm", "deps_dp_1pm"):
        if column not in values:
            continue
        expected, tolerance = rows[column].to_numpy(), np.full(len(rows), 0.02)
        if column.endswith("_m"):
            expected, tolerance = values[column][0] + expected, 0.1 + 0.02 * distance
        if column.endswith("_1pm"):
            ends = np.sort([np.append(0.0, expected[:-1]), np.append(expected[:-1], 0.0)], axis=0)
            expected, tolerance = np.clip(values[column], *ends), np.full(len(rows), 1e-4)
        off = values[column] - expected
        if column == "psi_rad":
            off = np.remainder(off + np.pi, 2 * np.pi) - np.pi
        wrong = np.abs(off) > tolerance
        refuse(column, wrong, f"{expected[np.argmax(wrong)]:.4g} follows from the other columns (unit, sign?)")
