"""Rough rails: random or measured irregularities with localised defects.

All of them are frames of irregularities, see `railrepro.track.irregularity`, at the same track coordinates, so they add
up. Serves the paper's outlook (known lateral track irregularities).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from railrepro import data, paths
from railrepro.data import InputError, Number, above, between, require
from railrepro.track.irregularity import (
    CHANNELS,
    FLANGEWAY,
    LARGEST,
    check,
    coordinates,
    faded,
    irregularities,
    smooth_step,
    track_centre,
)
from railrepro.track.table import read_numbers, refuse

_GAP = 1.5
"""Longest allowed step of p_m in a file over the usual one."""
_START = Annotated[Number, between(-1e6, 1e6, "m")]
_LENGTH = Annotated[Number, above(0.0, 1e6, "m")]
_HEIGHT = Annotated[Number, between(-LARGEST, LARGEST, "m")]


@data.table
class Dip:
    """Vertical dip in the shape of a versine; a negative depth is a hump."""

    start: _START
    length: _LENGTH
    depth: _HEIGHT
    rail: Literal["both", "le", "ri"] = "both"
    kind: Literal["dip"] = "dip"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """Irregularities at track coordinates p (m), shape (n,)."""
        _check_fit(self, p, self.length)
        shape = _versine(p, self.start, self.length, self.depth)
        level = {f"vertical_{side}_m": shape * (self.rail in ("both", side)) for side in ("le", "ri")}
        return track_centre({"p_m": p, "lateral_le_m": 0.0 * shape, "lateral_ri_m": 0.0 * shape, **level})


@data.table
class AlignmentFault:
    """Lateral excursion of both rails in the shape of a versine, right positive."""

    start: _START
    length: _LENGTH
    amplitude: _HEIGHT
    kind: Literal["alignment_fault"] = "alignment_fault"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """Irregularities at track coordinates p (m), shape (n,)."""
        _check_fit(self, p, self.length)
        return _lateral(p, _versine(p, self.start, self.length, self.amplitude))


@data.table
class LateralOffset:
    """Lateral step of both rails there and back, as at a switch, right positive.

    The length contains both transitions, whose second derivatives are continuous.
    """

    start: _START
    length: _LENGTH
    offset: _HEIGHT
    transition: _LENGTH
    kind: Literal["lateral_offset"] = "lateral_offset"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """Irregularities at track coordinates p (m), shape (n,)."""
        _check_fit(self, p, self.transition)
        if self.length < 2 * self.transition:
            raise InputError(
                f"{self.kind}: {self.length:g} m long, at least two transitions of {self.transition:g} m are needed"
            )
        there, back = p - self.start, self.start + self.length - p
        return _lateral(p, self.offset * smooth_step(np.minimum(there, back) / self.transition))


def _versine(p: np.ndarray, start: float, length: float, height: float) -> np.ndarray:
    return height / 2 * (1 - np.cos(2 * np.pi * np.clip((p - start) / length, 0, 1)))


def _lateral(p: np.ndarray, lateral: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"p_m": p} | {column: 0.0 for column in CHANNELS.values()} | {"lateral_m": lateral})


def _check_fit(defect: Dip | AlignmentFault | LateralOffset, p: np.ndarray, detail: float) -> None:
    """A defect has to lie on the coordinates, and its shortest part to cover at least four of their steps."""
    end, step = defect.start + defect.length, np.diff(p).max()
    if not p[0] <= defect.start < end <= p[-1]:
        raise InputError(
            f"{defect.kind}: {defect.start:g} to {end:g} m, a stretch within {p[0]:g} to {p[-1]:g} m is needed"
        )
    if detail < 4 * step:
        raise InputError(f"{defect.kind}: {detail:g} m long, at least {4 * step:g} m are needed at this sampling")


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


@data.table
class Rough:
    """Irregularities of a run: random ones (arguments of `irregularities`) or those of a file, and defects.

    `chainage` is the coordinate in the file at which p = 0 lies (m).
    """

    file: str | None = None
    chainage: Annotated[Number, between(-1e7, 1e7, "m")] = 0.0
    defects: tuple[Annotated[Dip | AlignmentFault | LateralOffset, Field(discriminator="kind")], ...] = ()
    spectrum: str | None = None
    seed: Annotated[int, between(0, 2**63)] | None = None
    shortest: _LENGTH | None = None
    longest: _LENGTH | None = None

    def __post_init__(self) -> None:
        if self.file is not None and self.random():
            raise ValueError(f"has a file and {list(self.random())}, which only random irregularities take")
        if self.file is None and self.chainage != 0.0:
            raise ValueError(f"has the chainage {self.chainage!r}, but no file that has one")

    def random(self) -> dict:
        """Arguments of `irregularities` that are given."""
        names = ("spectrum", "seed", "shortest", "longest")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def at(self, p) -> pd.DataFrame:
        """Irregularities at track coordinates p (m), shape (n,)."""
        p = coordinates(p)
        if self.file is None:
            frame = irregularities(p, **self.random())
        else:
            measured = read_irregularities(paths.source(self.file), length=float(p[-1]), chainage=self.chainage)
            channels = {c: np.interp(p, measured["p_m"], measured[c]) for c in CHANNELS.values()}
            frame = faded(pd.DataFrame({"p_m": p} | channels))
        total = superpose(frame, *(defect.at(p) for defect in self.defects))
        check(total)
        return total


def rough_track(p: np.ndarray, **arguments) -> pd.DataFrame:
    """Irregularities of a run.

    Parameters
    ----------
    p : ndarray, shape (n,)
        Track coordinates (m).
    arguments
        Fields of `Rough`; `defects` as tables with their `kind`.

    Returns
    -------
    DataFrame
        p_m and the columns of `irregularity.CHANNELS`.

    Raises
    ------
    InputError
        An argument that is not known, missing, or not of this kind; more than the flangeway takes.
    """
    return data.build(Rough, arguments, "irregular").at(p)


def read_irregularities(
    path: Path | str, length: float | None = None, shortest: float = 3.0, chainage: float = 0.0
) -> pd.DataFrame:
    """Read and check irregularities that a recording car measured; CSV with one row per sample and these columns:

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
    require("chainage", chainage, between(-1e7, 1e7, "m"))
    require("shortest", shortest, above(0.0, 1e5, "m"))
    require("length", length or 0.0, between(0.0, 1e7, "m"))
    frame = read_numbers(file, ("p_m", *CHANNELS.values()))
    frame["p_m"] -= chainage
    p = frame["p_m"].to_numpy()
    usual = float(np.median(np.diff(p)))
    _check_steps(file.name, p, _GAP * usual, f"{_GAP} times the usual step; the file has a gap")
    ranges = [(column, -LARGEST, LARGEST, " (unit?)") for column in CHANNELS.values()]
    ranges += [(column, *allowed, "; more than the flangeway takes") for column, allowed in FLANGEWAY.items()]
    for column, low, high, hint in ranges:
        outside = (frame[column] < low) | (frame[column] > high)
        refuse(file.name, frame[column], outside, f"{low:g} to {high:g} is allowed{hint}")
    if length is not None and (p[0] > 0 or p[-1] < length):
        raise InputError(
            f"{file.name}: p_m goes from {p[0]:g} to {p[-1]:g} m, the run needs 0 to {length:g} m; `chainage` shifts it"
        )
    _check_steps(file.name, p, shortest / 2, f"half of the shortest wavelength, {shortest:g} m")
    return frame


def _check_steps(where: str, p: np.ndarray, largest: float, why: str) -> None:
    """Refuse rows that are too far apart, by the first of them."""
    far = np.diff(p) > largest
    if far.any():
        row = int(np.argmax(far))
        step = f"row {row + 3}, p_m goes from {p[row]:g} to {p[row + 1]:g} m"
        raise InputError(f"{where}: {step}, steps of up to {largest:g} m are allowed ({why})")
