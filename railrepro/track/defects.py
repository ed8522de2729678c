"""Localised track defects as frames of irregularities, and their superposition.

Every function returns a frame (p_m and the columns of `irregularity.CHANNELS`) at the given coordinates, so defects,
random and measured irregularities add up with `superpose`.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from railrepro.data import InputError, between, require
from railrepro.track.irregularity import CHANNELS, LARGEST, smooth_step, track_centre

_HEIGHT = between(-LARGEST, LARGEST, "m")


def dip(p: np.ndarray, start: float, length: float, depth: float, rail: str = "both") -> pd.DataFrame:
    """Vertical dip in the shape of a versine at track coordinates p (m), shape (n,).

    Begin, length and greatest depth in m, a negative depth is a hump; `rail` is "both", "le" or "ri".
    """
    if rail not in ("both", "le", "ri"):
        raise InputError(f"dip: rail is {rail!r}, 'both', 'le' or 'ri' is allowed")
    shape = _versine("dip", p, start, length, depth)
    level = {f"vertical_{side}_m": shape * (rail in ("both", side)) for side in ("le", "ri")}
    return track_centre({"p_m": p, "lateral_le_m": 0.0 * shape, "lateral_ri_m": 0.0 * shape, **level})


def alignment_fault(p: np.ndarray, start: float, length: float, amplitude: float) -> pd.DataFrame:
    """Lateral excursion of both rails in the shape of a versine, right positive; parameters (m) as of `dip`."""
    return _lateral(p, _versine("alignment fault", p, start, length, amplitude))


def lateral_offset(p: np.ndarray, start: float, length: float, offset: float, transition: float) -> pd.DataFrame:
    """Lateral step of both rails there and back, as at a switch, at track coordinates p (m), shape (n,).

    The length contains both transitions, whose second derivatives are continuous; offset right positive (all m).
    """
    require("lateral offset: offset", offset, _HEIGHT)
    _check_place("lateral offset", p, start, length, transition)
    if length < 2 * transition:
        raise InputError(
            f"lateral offset: length is {length:g} m, at least two transitions of {transition:g} m are needed"
        )
    there, back = p - start, start + length - p
    return _lateral(p, offset * smooth_step(np.minimum(there, back) / transition))


def superpose(*frames: pd.DataFrame) -> pd.DataFrame:
    """Sum of frames of irregularities at the same coordinates."""
    first = frames[0]
    total = first[["p_m", *CHANNELS.values()]].copy()
    for frame in frames[1:]:
        if not np.array_equal(frame["p_m"], first["p_m"]):
            raise InputError("irregularities: frames at different p_m cannot be superposed")
        for column in CHANNELS.values():
            total[column] += frame[column]
    return total


def _versine(name: str, p: np.ndarray, start: float, length: float, height: float) -> np.ndarray:
    require(f"{name}: height", height, _HEIGHT)
    _check_place(name, p, start, length, length)
    return height / 2 * (1 - np.cos(2 * np.pi * np.clip((p - start) / length, 0, 1)))


def _lateral(p: np.ndarray, lateral: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"p_m": p} | {column: 0.0 for column in CHANNELS.values()} | {"lateral_m": lateral})


def _check_place(name: str, p: np.ndarray, start: float, length: float, detail: float) -> None:
    """A defect has to lie on the coordinates and to cover at least four of their steps."""
    for place in (start, length, detail):
        require(f"{name}: place", place, between(-1e6, 1e6, "m"))
    if not p[0] <= start < start + length <= p[-1]:
        raise InputError(
            f"{name}: {start:g} to {start + length:g} m, a stretch within {p[0]:g} to {p[-1]:g} m is needed"
        )
    if detail < 4 * np.diff(p).max():
        raise InputError(f"{name}: {detail:g} m long, at least {4 * np.diff(p).max():g} m are needed at this sampling")
