"""Tracks from what a survey or a line diagram states: chainage, curvature or radius, cant, gradient.

A CSV has one row per point and, between points, all of them change linearly, as along straights, clothoids, arcs and
linear cant ramps:

- chainage_m: distance along the line (m), increasing; the track begins at the first row, whatever its chainage;
- curvature_1pm (1/m) or radius_m (m; 0, inf or empty on a straight): positive in right-hand curves;
- cant_m (m) or cant_mm (mm): height of the left rail over the right one, positive in right-hand curves, optional;
- gradient_permille: rise per thousand, optional.
"""

from __future__ import annotations

import itertools
import warnings

import numpy as np
import pandas as pd

from railrepro.errors import InputError
from railrepro.track.alignment import CANT_BASE

CHAINAGE = "chainage_m"
BLANK = ("radius_m",)
COLUMNS = ("curvature_1pm", *BLANK, "cant_m", "cant_mm", "gradient_permille")
_LARGEST = {
    "curvature_1pm": (0.02, "1/m"),
    "cant_m": (0.3, "m"),
    "cant_mm": (300.0, "mm"),
    "gradient_permille": (200.0, "per mille"),
}
_STEP = 5.0
"""Longest distance of two rows of the table (m)."""
_SHARPEST = 50.0
"""Smallest radius (m)."""


def derived(points: pd.DataFrame, where: str) -> pd.DataFrame:
    """Angles and rates of a track, as `railrepro.track.table` has them, from `CHAINAGE` and columns of `COLUMNS`.

    Raises
    ------
    InputError
        Neither or both of curvature and radius, or cant twice; beyond what railways build. Names the file (`where`).
    """
    for pair, needed in ((COLUMNS[:2], True), (COLUMNS[2:4], False)):
        there = [column for column in pair if column in points]
        if len(there) > 1 or (needed and not there):
            raise InputError(f"{where}: has {there or 'neither'} of {list(pair)}, one of them is needed")
    for column, (largest, unit) in _LARGEST.items():
        if column in points:
            refuse(
                where, points[column], points[column].abs() > largest, f"up to {largest:g} {unit} is allowed (unit?)"
            )
    p = (points[CHAINAGE] - points[CHAINAGE].iloc[0]).to_numpy()
    if "radius_m" in points:
        radius = points["radius_m"]
        sharp = (radius != 0) & (radius.abs() < _SHARPEST)
        refuse(where, radius, sharp, f"at least {_SHARPEST:g} m, or 0 on a straight, is allowed (unit?)")
        kappa = np.where(radius == 0, 0.0, 1 / radius.mask(radius == 0, 1.0))
    else:
        kappa = points["curvature_1pm"].to_numpy()
    if "cant_mm" in points and 0 < points["cant_mm"].abs().max() < 1:
        said = f"{where}: cant_mm of {points['cant_mm'].abs().max():g} is unusual, above 1 mm is usual: is it in mm?"
        warnings.warn(said, stacklevel=2)
    cant = points["cant_m"] if "cant_m" in points else 1e-3 * points.get("cant_mm", 0.0 * p)
    phi = np.arcsin(np.asarray(cant) / CANT_BASE)
    eps = np.arctan(1e-3 * np.asarray(points.get("gradient_permille", 0.0 * p)))
    pieces = [np.linspace(a, b, int(np.ceil((b - a) / _STEP)), endpoint=False) for a, b in itertools.pairwise(p)]
    at, p = p, np.concatenate([*pieces, p[-1:]])
    kappa, phi, eps = (np.interp(p, at, values) for values in (kappa, phi, eps))
    step = np.diff(p)
    psi = np.concatenate([[0.0], np.cumsum(step * (kappa[:-1] + kappa[1:]) / 2)])
    rates = {name: np.append(np.diff(angle) / step, 0.0) for name, angle in (("phi", phi), ("eps", eps))}
    return pd.DataFrame(
        {
            "p_m": p,
            "psi_rad": psi,
            "dpsi_dp_1pm": kappa,
            "phi_rad": phi,
            "dphi_dp_1pm": rates["phi"],
            "eps_rad": eps,
            "deps_dp_1pm": rates["eps"],
        }
    )


def refuse(where: str, values: pd.Series, wrong: pd.Series, allowed: str) -> None:
    """Refuse a column of a CSV with the first of the rows that are wrong; InputError."""
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(f"{where}: row {row + 2}, {values.name} = {values.iloc[row]:g}, {allowed}")
