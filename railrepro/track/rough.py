"""Rough rails: random irregularities with localised defects.

All of them are frames of irregularities, see `railrepro.track.irregularity`, at the same track coordinates, so they add
up. Serves the paper's outlook (known lateral track irregularities).
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from railrepro import data
from railrepro.data import InputError, Number, above, between
from railrepro.track.irregularity import (
    CHANNELS,
    HALF_BASE,
    LARGEST,
    irregularities,
    smooth_step,
)

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
        left, right = (shape * (self.rail in ("both", side)) for side in ("le", "ri"))
        return _frame(p, vertical_m=(right + left) / 2, crosslevel_rad=(right - left) / (2 * HALF_BASE))


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
        return _frame(p, lateral_m=_versine(p, self.start, self.length, self.amplitude))


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
        return _frame(p, lateral_m=self.offset * smooth_step(np.minimum(there, back) / self.transition))


def _versine(p: np.ndarray, start: float, length: float, height: float) -> np.ndarray:
    return height / 2 * (1 - np.cos(2 * np.pi * np.clip((p - start) / length, 0, 1)))


def _frame(p: np.ndarray, **channels: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"p_m": p} | dict.fromkeys(CHANNELS.values(), 0.0) | channels)


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
    """Irregularities of a run: random ones (arguments of `irregularities`) and defects."""

    defects: tuple[Annotated[Dip | AlignmentFault | LateralOffset, Field(discriminator="kind")], ...] = ()
    spectrum: str = "erri_low"
    seed: Annotated[int, between(0, 2**63)] = 1


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
        An argument that is not known, missing, or not of this kind.
    """
    rough = data.build(Rough, arguments, "irregular")
    total = irregularities(p, rough.spectrum, rough.seed)
    for defect in rough.defects:
        total = total + defect.at(total["p_m"].to_numpy()).assign(p_m=0.0)
    return total
