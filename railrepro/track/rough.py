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
from railrepro.data import InputError, Number, above, between
from railrepro.track.columns import read_numbers, refuse
from railrepro.track.irregularity import (
    CHANNELS,
    FLANGEWAY,
    LARGEST,
    WAVELENGTH,
    check,
    coordinates,
    faded,
    irregularities,
    smooth_step,
    track_centre,
)

_STEP = 1.5
"""Longest step of p_m in a file (m): half of the shortest wave."""
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


@data.table
class Rough:
    """Irregularities of a run: random ones (arguments of `irregularities`) or those of a file, and defects.

    `chainage` is the coordinate in the file at which p = 0 lies (m).
    """

    file: str | None = None
    chainage: Annotated[Number, between(-1e7, 1e7, "m")] = 0.0
    defects: tuple[Annotated[Dip | AlignmentFault | LateralOffset, Field(discriminator="kind")], ...] = ()
    spectrum: str = "erri_low"
    seed: Annotated[int, between(0, 2**63)] = 1
    shortest: Annotated[Number, WAVELENGTH] = 3.0
    longest: Annotated[Number, WAVELENGTH] = 100.0

    def __post_init__(self) -> None:
        random = self.spectrum, self.seed, self.shortest, self.longest
        if self.file is not None and random != (Rough.spectrum, Rough.seed, Rough.shortest, Rough.longest):
            raise ValueError("has a file and what only random irregularities take (spectrum, seed, shortest, longest)")
        if self.file is None and self.chainage != 0.0:
            raise ValueError(f"has the chainage {self.chainage!r}, but no file that has one")

    def at(self, p) -> pd.DataFrame:
        """Irregularities at track coordinates p (m), shape (n,)."""
        p = coordinates(p)
        if self.file is None:
            total = irregularities(p, self.spectrum, self.seed, self.shortest, self.longest)
        else:
            measured = read_irregularities(paths.source(self.file), length=float(p[-1]), chainage=self.chainage)
            channels = {c: np.interp(p, measured["p_m"], measured[c]) for c in CHANNELS.values()}
            total = faded(pd.DataFrame({"p_m": p} | channels))
        for defect in self.defects:
            total = total + defect.at(p).assign(p_m=0.0)
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


def read_irregularities(path: Path | str, length: float, chainage: float = 0.0) -> pd.DataFrame:
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
    length : float
        Length of the run from p = 0 that has to be covered (m).
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
        flangeway, shorter than the run; one sentence naming file and row.
    """
    file = data.location(path)
    frame = read_numbers(file, [[column] for column in ("p_m", *CHANNELS.values())])
    for column in CHANNELS.values():
        low, high = FLANGEWAY.get(column, (-LARGEST, LARGEST))
        refuse(file.name, frame[column], ~frame[column].between(low, high), f"{low:g} to {high:g} is allowed (unit?)")
    far = np.diff(frame["p_m"], prepend=frame["p_m"][0]) > _STEP
    refuse(file.name, frame["p_m"], far, f"which is more than {_STEP:g} m after the row before")
    frame["p_m"] -= chainage
    first, last = frame["p_m"].iloc[[0, -1]]
    if first > 0 or last < length:
        raise InputError(
            f"{file.name}: p_m goes from {first:g} to {last:g} m, the run needs 0 to {length:g} m; `chainage` shifts it"
        )
    return frame
