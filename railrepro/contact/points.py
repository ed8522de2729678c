"""Measured profiles of a wheel, a rail or both, from a CSV of points as profile gauges give them.

One row per point: `part` ("wheel" or "rail"), lateral_mm and height_mm. Laterally the field side is positive, upwards
for a rail and radially outwards for a wheel the height. The lateral origin of a wheel is its tape circle; its height
there counts as zero. A rail is given as it lies, with its inclination; its origin does not matter, for its highest
point and its gauge face are found. A part that the file lacks is S1002 or 60E1 at 1:40.

Points are smoothed by a cubic spline whose stiffness generalised cross-validation finds, because slopes of raw points
are noise: 10 micrometres from point to point of .1 mm would be 100 mrad.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline, make_smoothing_spline

from railrepro import data
from railrepro.contact import profiles
from railrepro.data import InputError

PARTS = ("wheel", "rail")
_COLUMNS = ["lateral_mm", "height_mm"]
_STEP = 1e-4
"""Step of the smoothed profile (m)."""
_NEEDED = {"wheel": (-42, 30), "rail": (-25, 15)}
"""What a profile has to cover: from the tape circle, from the highest point (mm)."""


@dataclass(frozen=True)
class Pair:
    """A wheel on a rail.

    Attributes
    ----------
    name : str
    digest : str
        Of the points; pairs are equal, and look the same, that have equal ones.
    wheel : callable
        Distances from the tape circle (m) -> height (m) and slope (-), see `profiles.s1002`.
    rail : tuple of ndarray or None
        Distances from the track centre, increasing, and depths (m); None stands for `profiles.inclined_rail`.
    """

    name: str
    digest: str = ""
    wheel: Callable = field(default=profiles.s1002, compare=False, repr=False)
    rail: tuple[np.ndarray, np.ndarray] | None = field(default=None, compare=False, repr=False)


STANDARD = Pair("s1002")


def read_pair(path: Path | str) -> Pair:
    """Profiles of a CSV of points.

    Raises
    ------
    InputError
        A column that is missing, an unknown part, anything but numbers, another unit, points that do not cover what
        touches or do not lie in order; one sentence.
    """
    file = data.location(path)
    try:
        content = file.read_bytes()
        table = pd.read_csv(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({str(error).strip()})") from error
    if not len(table) or not {"part", *_COLUMNS} <= set(table) or not set(table["part"]) <= set(PARTS):
        raise InputError(f"{file.name}: rows of part ({' or '.join(PARTS)}), {' and '.join(_COLUMNS)} are needed")
    found = {}
    for part in PARTS:
        points = 1e-3 * table.loc[table["part"] == part, _COLUMNS].apply(pd.to_numeric, errors="coerce").to_numpy()
        if len(points):
            found[part] = _smooth(f"{file.name}: {part}", points, _NEEDED[part], part == "rail")
    wheel = _as_wheel(*found["wheel"]) if "wheel" in found else profiles.s1002
    rail = _as_rail(file.name, *found["rail"]) if "rail" in found else None
    return Pair(file.name, hashlib.sha256(content).hexdigest(), wheel, rail)


def _smooth(where: str, points: np.ndarray, needed, from_top: bool) -> tuple[np.ndarray, CubicSpline]:
    """Uniform lateral coordinates and a spline of the heights (m)."""
    lateral, height = (points if points[0, 0] < points[-1, 0] else points[::-1]).T
    if not np.isfinite(points).all() or not (np.diff(lateral) > 0).all():
        raise InputError(f"{where}: numbers are needed, {_COLUMNS[0]} going one way; leave out what overhangs")
    first, last = 1e3 * (lateral[[0, -1]] - (lateral[np.argmax(height)] if from_top else 0.0))
    gap = 1e3 * np.diff(lateral).max()
    if first > needed[0] or last < needed[1] or gap > 2:
        found = f"{where} goes from {first:.3g} to {last:.3g} mm with gaps up to {gap:.2g} mm"
        origin = "top" if from_top else "tape circle"
        raise InputError(f"{found}, {needed[0]} to {needed[1]} mm of its {origin} and up to 2 mm are needed (unit?)")
    # in millimetres, where coordinates and heights are of a size that suits the cross-validation
    spline = make_smoothing_spline(1e3 * lateral, 1e3 * height)
    uniform = np.arange(np.ceil(lateral[0] / _STEP), np.floor(lateral[-1] / _STEP) + 1) * _STEP
    return uniform, CubicSpline(uniform, 1e-3 * spline(1e3 * uniform))


def _as_wheel(lateral: np.ndarray, height: CubicSpline) -> Callable:
    """Wheel profile as a function; beyond its ends it is far from any rail."""
    slope, first, last, zero = height.derivative(), lateral[0], lateral[-1], float(height(0.0))

    def wheel(s):
        s = np.asarray(s, dtype=float)
        inside = (s >= first) & (s <= last)
        held = np.clip(s, first, last)
        return np.where(inside, height(held) - zero, -1.0), np.where(inside, slope(held), 0.0)

    return wheel


def _as_rail(name: str, lateral: np.ndarray, height: CubicSpline) -> tuple[np.ndarray, np.ndarray]:
    """Rail as laid: gauge face at half the gauge, depth below the highest point."""
    depth = height(lateral).max() - height(lateral)
    gauge_side = lateral < lateral[np.argmin(depth)]
    if depth[gauge_side].max() < profiles.GAUGE_DEPTH:
        raise InputError(
            f"{name}: rail reaches {1e3 * depth[gauge_side].max():.1f} mm below its top on the gauge side (negative), "
            f"{1e3 * profiles.GAUGE_DEPTH:g} mm are needed"
        )
    face = np.interp(profiles.GAUGE_DEPTH, depth[gauge_side][::-1], lateral[gauge_side][::-1])
    return lateral - face + profiles.GAUGE / 2, depth
