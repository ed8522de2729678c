"""Track irregularities measured by a recording car, read from a CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import data
from railrepro.data import InputError
from railrepro.track.irregularity import CHANNELS, FLANGEWAY, LARGEST
from railrepro.track.table import read_numbers, refuse

_GAP = 1.5
"""Longest allowed step of p_m over the usual one."""


def read_irregularities(
    path: Path | str, length: float | None = None, shortest: float = 3.0, chainage: float = 0.0
) -> pd.DataFrame:
    """Read and check measured irregularities; CSV with one row per sample and these columns:

    - p_m: coordinate along the track (m), increasing, 0 where the run begins, or `chainage`;
    - lateral_m: alignment of the track centre (m), right positive;
    - vertical_m: longitudinal level of the track centre (m), down positive;
    - crosslevel_rad: deviation from the designed cant (rad), right rail down positive: height difference over 1.5 m;
    - gauge_m: deviation from the nominal gauge (m), wider positive.

    Rails measured one by one become a track centre by `railrepro.track.irregularity.track_centre`. The numbers are
    returned as they are; `railrepro.track.irregularity.faded` makes them begin and end on the ideal track.

    Parameters
    ----------
    path : path
    length : float, optional
        Length of the run from p = 0 that has to be covered (m).
    shortest : float
        Shortest wavelength that is wanted of the file (m); its rows may be at most half of it apart.
    chainage : float
        What p_m is where the run begins (m); coordinates are returned less this.

    Returns
    -------
    DataFrame
        The columns above.

    Raises
    ------
    InputError
        Missing column, anything but a finite number, p_m not increasing or with a gap, wrong unit, beyond the
        flangeway, shorter than the run, sampled too coarsely; one sentence naming file and row.
    """
    file = data.location(path)
    data.require("chainage", chainage, data.between(-1e7, 1e7, "m"))
    data.require("shortest", shortest, data.above(0.0, 1e5, "m"))
    data.require("length", length or 0.0, data.between(0.0, 1e7, "m"))
    frame = read_numbers(file, ("p_m", *CHANNELS.values()))
    frame["p_m"] -= chainage
    p = frame["p_m"].to_numpy()
    usual = float(np.median(np.diff(p)))
    for row in np.flatnonzero(np.diff(p) > _GAP * usual)[:1]:
        gap = f"p_m has a gap from {p[row]:g} to {p[row + 1]:g} m"
        raise InputError(f"{file.name}: row {row + 3}, {gap}, steps of up to {_GAP} times {usual:g} m are allowed")
    ranges = [(column, -LARGEST, LARGEST, " (unit?)") for column in CHANNELS.values()]
    ranges += [(column, *allowed, "; more than the flangeway takes") for column, allowed in FLANGEWAY.items()]
    for column, low, high, hint in ranges:
        outside = (frame[column] < low) | (frame[column] > high)
        refuse(file.name, frame[column], outside, f"{low:g} to {high:g} is allowed{hint}")
    if length is not None and (p[0] > 0 or p[-1] < length):
        raise InputError(
            f"{file.name}: p_m goes from {p[0]:g} to {p[-1]:g} m, the run needs 0 to {length:g} m; `chainage` shifts it"
        )
    for row in np.flatnonzero(np.diff(p) > shortest / 2)[:1]:
        step = f"p_m makes a step of {p[row + 1] - p[row]:g} m, up to {shortest / 2:g} m is allowed"
        raise InputError(f"{file.name}: row {row + 3}, {step} for wavelengths of {shortest:g} m")
    return frame
