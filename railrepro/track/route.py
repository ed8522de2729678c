"""Routes: track geometry, irregularities, lateral set point, adhesion and force demand along a track. A route is a
table of cells of uniform length. A cell holds values and derivatives at its start. Inside the cell, the geometry is a
Taylor expansion, which is exact for straight, clothoid and arc; set point and irregularities are cubics. Irregularities
have no kinks between cells, which would excite the contact springs. Plant and controllers read the same cells (paper
eq. (3), theta and y*)."""

import reprlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import casadi as ca
import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from railrepro.data import InputError, above, require
from railrepro.quantities import Scalar
from railrepro.track.irregularity import CHANNELS, LARGEST, check, coordinates, require_within
from railrepro.track.table import Track, track_in

CELL = 0.5  # length of a cell (m)
BEFORE, AFTER = 60.0, 400.0  # length of a route before and behind its track, for the rear gear and previews (m)


def _orders(name: str) -> tuple[str, ...]:
    """Columns of a cubic: its value and first three derivatives over p at the start of the cell."""
    return tuple("d" * order + name for order in range(4))


_TRACK = ("p", "psi", "kappa", "dkappa", "phi", "dphi", "eps", "deps", "x", "y", "z")
_IRREGULAR = tuple(column for channel in CHANNELS for column in _orders(channel))
_SET_POINT = _orders("y_ref")
COLUMNS = (*_TRACK, *_IRREGULAR, *_SET_POINT, "poor_le", "poor_ri", "force")
INDEX = {name: i for i, name in enumerate(COLUMNS)}
_RANGES = {"y_ref": (-LARGEST, LARGEST), "poor_le": (0.0, 1.0), "poor_ri": (0.0, 1.0), "force": (-5e5, 5e5)}
"""Permitted set points (m), shares of the poor adhesion set (-) and forces (N)."""
Profile = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Route:
    """Track geometry, irregularities, set point, adhesion and force demand in cells of 0.5 m length; made by `lay`.
    InputError for cells of another type or shape, a value that is not finite, steps of p that are not 0.5 m, and a
    length that is not positive.

    Attributes:
        cells (ndarray of float64, shape (n, len(COLUMNS))): One row per cell, values (SI) at its start; the index of a
            column is `INDEX[name]`. Track: p (coordinate), psi (yaw), kappa (curvature), phi (roll), eps (pitch), x, y,
            z (position). Irregularities: lateral, vertical, crosslevel, gauge. y_ref (set point), poor_le and poor_ri
            (share of the poor adhesion set on each rail), force (demand per gear). dkappa is the derivative of kappa
            over p, dy_ref, ddy_ref and dddy_ref are those of y_ref, and so on. Compiled code reads it; read-only.
        length (float): Track coordinate at which a run ends (m), from `lay` that of the end of the track.
    """

    cells: np.ndarray
    length: float

    def __post_init__(self) -> None:
        cells = self.cells
        plain = type(cells) is np.ndarray and cells.dtype == np.float64 and cells.ndim == 2
        if not plain or not len(cells) or cells.shape[1] != len(COLUMNS):
            shape, kind = getattr(cells, "shape", "none"), getattr(cells, "dtype", "none")
            found = f"cells is of the class {type(cells).__name__}, shape {shape}, dtype {kind}"
            raise InputError(f"route: {found}; an ndarray of shape (n, {len(COLUMNS)}), dtype float64 is needed")
        p = cells[:, INDEX["p"]]
        for row, column in np.argwhere(~np.isfinite(cells))[:1]:
            found = f"{COLUMNS[column]} at p = {p[row]} m is {cells[row, column]}"
            raise InputError(f"route: {found}, a finite number is needed")
        for row in np.flatnonzero(np.abs(p - p[0] - CELL * np.arange(p.size)) > 1e-6)[:1]:
            raise InputError(f"route: p goes from {p[row - 1]} to {p[row]} m, steps of {CELL} m are needed")
        require("route: length", self.length, above(0.0, 1e6, "m"))
        cells = np.ascontiguousarray(cells).view()
        cells.flags.writeable = False
        object.__setattr__(self, "cells", cells)

    @property
    def start(self) -> float:
        """Track coordinate at which the first cell starts (m)."""
        return float(self.cells[0, INDEX["p"]])

    def rows_at(self, p: np.ndarray) -> np.ndarray:
        """Rows of `cells` at track coordinates p (m, shape (n,)), shape (n, len(COLUMNS)). Beyond the ends of the route
        the first or the last row is used."""
        index = np.clip((np.asarray(p, dtype=float) - self.start) / CELL, 0, len(self.cells) - 1)
        return self.cells[index.astype(int)]

    def _named(self, p: np.ndarray) -> dict[str, np.ndarray]:
        """Rows at p as a dict: name in `COLUMNS` -> values."""
        return dict(zip(COLUMNS, self.rows_at(np.atleast_1d(p)).T, strict=True))

    def track_at(self, p: np.ndarray) -> np.ndarray:
        """Track angles and their derivatives at track coordinates p (m, shape (n,)), shape (6, n). The rows are psi
        (yaw, rad), dpsi_dp (rad/m), phi (roll, rad), dphi_dp (rad/m), eps (pitch, rad), deps_dp (rad/m)."""
        return np.array(track_in(self._named(p), p))

    def reference_at(self, p: np.ndarray) -> np.ndarray:
        """Set point at track coordinates p (m, shape (n,)), shape (3, n). Rows: y* (m), dy*/dp (-), d2y*/dp2 (1/m)."""
        return np.array(reference_in(self._named(p), p))


def reference_in(cell: dict, p) -> tuple:
    """Lateral set point y* (m), dy*/dp (-) and d2y*/dp2 (1/m) at the track coordinate p (m) inside a cell. `cell` is a
    row of `Route.cells` as a dict: name in `COLUMNS` -> value. `p` and the values are numbers, arrays or CasADi
    symbols. Source: eq. (34)."""
    return _cubic([cell[name] for name in _SET_POINT], p - cell["p"])


def irregularity_in(cell: dict, channel: str, p) -> tuple:
    """Value (m; rad for "crosslevel") and slope (-; rad/m) of an irregularity at the track coordinate p (m): numbers or
    CasADi symbols. `cell` is the row of `Route.cells` around p as a dict; `channel` "lateral", "vertical", …"""
    return _cubic([cell[name] for name in _orders(channel)], p - cell["p"])[:2]


def _cubic(terms, d) -> tuple:
    """Value, slope and second derivative of a cubic at a distance d from where it has the derivatives `terms`."""
    y, y1, y2, y3 = terms
    return y + d * (y1 + d * (y2 / 2 + d * y3 / 6)), y1 + d * (y2 + d * y3 / 2), y2 + d * y3


def lay(
    track: Track,
    reference: ca.Function | None = None,
    poor: tuple[Profile, Profile] | None = None,
    force: Profile | None = None,
    irregularities: pd.DataFrame | None = None,
    line: tuple[np.ndarray, np.ndarray] | None = None,
) -> Route:
    """Make a `Route` along a track. InputError for an argument of another form, and for a number that is not finite or
    out of range. Without an optional argument its quantity is 0 everywhere.

    Args:
        track (Track): Geometry of the track.
        reference (casadi.Function, optional): Lateral set point p (m) -> y* (m), such as from the function `reference`.
            The set point in all, `reference` plus `line`, must be within 0.1 m.
        poor (pair of callables, optional): For the left and the right rail, p (m), shape (n,) -> share of the poor
            adhesion set, 0 to 1, shape (n,) or one number.
        force (callable, optional): p (m), shape (n,) -> demanded longitudinal force per running gear (N), traction
            positive, up to 500 kN, shape (n,) or one number.
        irregularities (DataFrame, optional): Columns p_m (increasing), lateral_m, vertical_m, crosslevel_rad, gauge_m.
            A cubic spline joins the rows; outside of them the irregularities are 0.
        line (pair of ndarray, optional): Planned set point from `railrepro.studies.preview.plan`, added to `reference`:
            track coordinates (m), shape (m,), increasing; the set point (m) there and its first three derivatives over
            p, shape (4, m). It is cubic between the coordinates and 0 outside.
    """
    require("track", track, Track)
    p = _geometry(track)["p"]
    columns = dict.fromkeys(COLUMNS, np.zeros(p.size)) | _geometry(track)
    if irregularities is not None:
        columns |= _offsets(irregularities, p)
    if reference is not None:
        require("route: reference", reference, ca.Function)
        columns |= dict(zip(_SET_POINT, _derivatives(reference, track), strict=True))
    if line is not None:
        columns |= {name: columns[name] + values for name, values in zip(_SET_POINT, _sampled(line, p), strict=True)}
    if not (poor is None or (isinstance(poor, tuple | list) and len(poor) == 2)):
        raise InputError(f"route: poor is {reprlib.repr(poor)}, a pair of functions, left and right, is needed")
    for name, profile in zip(("poor_le", "poor_ri", "force"), (*(poor or (None, None)), force), strict=True):
        if profile is None:
            continue
        if not callable(profile):
            raise InputError(f"route: {name} is {reprlib.repr(profile)}, a function of p (m) is needed")
        columns[name] = np.broadcast_to(_array(name, profile(p.copy()), p.shape, ()), p.shape)
    require_within("route", p, columns, _RANGES)
    return Route(np.column_stack([*columns.values()]), track.length)


def _array(name: str, found: Any, *shapes: tuple) -> np.ndarray:
    """Convert `found` to an array of numbers. InputError unless it has one of the shapes."""
    try:
        values = np.asarray(found, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"route: {name} gives {reprlib.repr(found)}, an array of numbers is needed") from None
    if values.shape not in shapes:
        raise InputError(f"route: {name} has the shape {values.shape}, {' or '.join(map(str, shapes))} is needed")
    return values


@lru_cache
def _geometry(track: Track) -> dict[str, np.ndarray]:
    """Columns `_TRACK` of the cells of a track."""
    p = np.arange(-BEFORE, track.length + AFTER, CELL)
    psi, kappa, phi, _, eps, _ = track.interpolate(np.append(p, p[-1] + CELL))
    start, slope = _curvature(kappa, np.diff(psi) / CELL)
    columns = {"p": p, "psi": psi[:-1], "kappa": start, "dkappa": slope}
    columns |= {"phi": phi[:-1], "dphi": np.diff(phi) / CELL, "eps": eps[:-1], "deps": np.diff(eps) / CELL}
    return columns | dict(zip("xyz", track.position(p), strict=True))


def _curvature(ends: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Curvature at the start of n cells (1/m) and its slope (1/m2). `ends` is the curvature at the ends of the cells
    (1/m), shape (n + 1,), and `mean` its mean in each cell, shape (n,). A cell with a step or kink of curvature inside
    gets a smaller slope than between its ends, such that its mean is `mean`. So the heading has no jump."""
    rise, low, high = np.diff(ends), np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
    bent = np.abs(mean - (ends[:-1] + ends[1:]) / 2) > 1e-9
    margin = np.clip(np.minimum(mean - low, high - mean), 0, None)
    rise = np.where(bent, np.sign(rise) * np.minimum(np.abs(rise), 2 * margin), rise)
    return np.where(bent, mean - rise / 2, ends[:-1]), rise / CELL


def _offsets(irregularities: pd.DataFrame, p: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of the irregularities for cells that start at p: cubics with the values and slopes of a spline at both
    ends. Source: de Boor, A Practical Guide to Splines, ch. IV (cubic Hermite interpolation)."""
    check(irregularities)
    at = irregularities["p_m"].to_numpy()
    spline = CubicSpline(at, irregularities[list(CHANNELS.values())], bc_type="clamped")
    p = np.append(p, p[-1] + CELL)
    inside = ((p >= at[0]) & (p <= at[-1]))[:, None]
    value, slope = inside * spline(p), inside * spline(p, 1)
    secant, first, last = np.diff(value, axis=0) / CELL, slope[:-1], slope[1:]
    terms = value[:-1], first, (6 * secant - 4 * first - 2 * last) / CELL, 6 * (first + last - 2 * secant) / CELL**2
    return dict(zip(_IRREGULAR, np.moveaxis(np.array(terms), 2, 0).reshape(len(_IRREGULAR), -1), strict=True))


def _sampled(line: tuple[np.ndarray, np.ndarray], p: np.ndarray) -> np.ndarray:
    """Set point of a planned line and its first three derivatives at p, shape (4, n)."""
    if not (isinstance(line, tuple | list) and len(line) == 2):
        raise InputError(f"route: line is {reprlib.repr(line)}, a pair (p, set point) is needed")
    at = coordinates("line", line[0])
    values = _array("line", line[1], (4, at.size))
    index = np.searchsorted(at, p + 1e-9, side="right") - 1
    inside, index = (index >= 0) & (p <= at[-1]), np.clip(index, 0, None)
    return inside * [*_cubic(values[:, index], p - at[index]), values[3, index]]


@lru_cache(maxsize=32)
def _derivatives(reference: ca.Function, track: Track) -> np.ndarray:
    """Set point and its first three derivatives over p at the cells of a track, shape (4, n)."""
    one = (reference.n_in(), reference.n_out(), reference.numel_in(), reference.numel_out())
    if one != (1, 1, 1, 1):
        raise InputError(f"route: reference is {reference}, a function of one number p (m) to one number (m) is needed")
    s = ca.SX.sym("p")
    terms = [reference(s)]
    for _ in range(3):
        terms.append(ca.jacobian(terms[-1], s))
    return np.array(ca.Function("reference", [s], [ca.vertcat(*terms)])(_geometry(track)["p"][None, :]))


@dataclass(frozen=True)
class SetPoint:
    """Parameters of a lateral set point y*. `kind` is 0 for none, 1 for a sine of wavelength `period_start`, 2 for a
    sweep from `period_start` to `period_end` with a wavenumber linear in p. y* is 0 outside of the track coordinates
    `start` to `end`. The amplitude rises over the length `fade` after `start` and falls over it before `end`. Source:
    caption of Fig. 7 (sine of 150 m), Figs. 6 and 9 (sweep, parameters not printed)."""

    kind: Annotated[Scalar, "-"]
    amplitude: Annotated[Scalar, "m"]
    period_start: Annotated[Scalar, "m"]
    period_end: Annotated[Scalar, "m"]
    start: Annotated[Scalar, "m"]
    end: Annotated[Scalar, "m"]
    fade: Annotated[Scalar, "m"]


@lru_cache
def reference(of: SetPoint) -> ca.Function:
    """Make the CasADi function p (m) -> y* (m) of a lateral set point, a sine or sweep. InputError for another kind."""
    if of.kind not in (1, 2):
        raise InputError(f"set point: kind is {of.kind!r}, 1 (sine) or 2 (sweep) is needed")
    s = ca.SX.sym("p")
    inside = _fade(s - of.start, of.fade) * (1 - _fade(s - of.end + of.fade, of.fade))
    if of.kind == 1:
        phase = 2 * np.pi * (s - of.start) / of.period_start
    else:
        d, wavenumber = ca.fmin(ca.fmax(s - of.start, 0), of.end - of.start), 1 / of.period_end - 1 / of.period_start
        phase = 2 * np.pi * (d / of.period_start + wavenumber * d**2 / (2 * (of.end - of.start)))
    return ca.Function("reference", [s], [of.amplitude * inside * ca.sin(phase)])


def _fade(s: ca.SX, length: Any) -> ca.SX:
    """Smooth step from 0 to 1 over `length` (m); three derivatives vanish at both ends."""
    r = ca.fmin(ca.fmax(s / length, 0), 1)
    return r**4 * (35 + r * (-84 + r * (70 - 20 * r)))
