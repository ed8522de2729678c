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
    """Vertical dip of one or both rails in the shape of a versine, depth / 2 (1 - cos(2 pi (p - start) / length)).

    Attributes
    ----------
    start, length : float
        Track coordinate at which the dip begins, and its whole length (m).
    depth : float
        Depth in the middle of the dip (m), down positive; negative is a hump.
    rail : "both", "le" (left) or "ri" (right)
    """

    start: _START
    length: _LENGTH
    depth: _HEIGHT
    rail: Literal["both", "le", "ri"] = "both"
    kind: Literal["dip"] = "dip"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """Irregularities due to the dip at coordinates p (m), shape (n,): DataFrame of n rows, zero off the dip.

        Columns p_m, vertical_m (m), crosslevel_rad (rad); lateral_m and gauge_m are 0. InputError unless p covers the
        dip in steps of up to length / 4.
        """
        _check_fit(self, p, self.length)
        shape = _versine(p, self.start, self.length, self.depth)
        left, right = (shape * (self.rail in ("both", side)) for side in ("le", "ri"))
        return _frame(p, vertical_m=(right + left) / 2, crosslevel_rad=(right - left) / (2 * HALF_BASE))


@data.table
class AlignmentFault:
    """Lateral excursion of both rails in the shape of a versine, amplitude / 2 (1 - cos(2 pi (p - start) / length)).

    Attributes
    ----------
    start, length : float
        Track coordinate at which the fault begins, and its whole length (m).
    amplitude : float
        Peak excursion in the middle of the fault, from the ideal track (m), right positive; no mid-chord offset.
    """

    start: _START
    length: _LENGTH
    amplitude: _HEIGHT
    kind: Literal["alignment_fault"] = "alignment_fault"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """Irregularities due to the fault at coordinates p (m), shape (n,): DataFrame of n rows, zero off the fault.

        Columns p_m, lateral_m (m); vertical_m, crosslevel_rad, gauge_m are 0. InputError unless p covers the
        fault in steps of up to length / 4.
        """
        _check_fit(self, p, self.length)
        return _frame(p, lateral_m=_versine(p, self.start, self.length, self.amplitude))


@data.table
class LateralOffset:
    """Stretch on which both rails lie aside by a constant offset, as at a switch.

    Attributes
    ----------
    start, length : float
        Track coordinate at which the first transition begins, and length including both transitions (m).
    offset : float
        Lateral offset between the transitions (m), right positive.
    transition : float
        Length of each transition, a `smooth_step` (m).
    """

    start: _START
    length: _LENGTH
    offset: _HEIGHT
    transition: _LENGTH
    kind: Literal["lateral_offset"] = "lateral_offset"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """Irregularities due to the offset at coordinates p (m), shape (n,): DataFrame of n rows, zero off the stretch.

        Columns p_m, lateral_m (m); vertical_m, crosslevel_rad, gauge_m are 0. InputError unless p covers the
        stretch in steps of up to transition / 4, or for a length below two transitions.
        """
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
    """Arguments of `rough_track`: `spectrum` (name) and random `seed` of `irregularities`, and added `defects`."""

    defects: tuple[Annotated[Dip | AlignmentFault | LateralOffset, Field(discriminator="kind")], ...] = ()
    spectrum: str = "erri_low"
    seed: Annotated[int, between(0, 2**63)] = 1


def rough_track(p: np.ndarray, **arguments) -> pd.DataFrame:
    """Random irregularities with localised defects added, at track coordinates p (m), shape (n,); see `irregularities`.

    `arguments` are fields of `Rough`; `defects` as dicts such as {"kind": "dip", "start": 300.0, "length": 8.0,
    "depth": 3e-3}. Returns a DataFrame with the columns p_m, lateral_m, vertical_m, crosslevel_rad, gauge_m.
    """
    rough = data.build(Rough, arguments, "irregular")
    total = irregularities(p, rough.spectrum, rough.seed)
    for defect in rough.defects:
        total = total + defect.at(total["p_m"].to_numpy()).assign(p_m=0.0)
    return total
