"""Rough rails: random irregularities with localised defects. All of them are frames of irregularities, see
`railrepro.track.irregularity`, at the same track coordinates, so they add up. Serves the paper's outlook (known lateral
track irregularities)."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from railrepro import data
from railrepro.data import InputError, Number, above, between
from railrepro.track.irregularity import CHANNELS, HALF_BASE, LARGEST, SEED, irregularities, smooth_step

_START = Annotated[Number, between(-1e6, 1e6, "m")]
_LENGTH = Annotated[Number, above(0.0, 1e6, "m")]
_HEIGHT = Annotated[Number, between(-LARGEST, LARGEST, "m")]


@data.table
class Dip:
    """Vertical dip of one or both rails: depth / 2 (1 - cos(2 pi (p - start) / length)).

    Attributes:
        start, length (float): Track coordinate at which the dip begins, and its whole length (m).
        depth (float): Depth in the middle (m), positive downwards; negative is a hump.
        rail (str): "both", "le" (left) or "ri" (right).
    """

    start: _START
    length: _LENGTH
    depth: _HEIGHT
    rail: Literal["both", "le", "ri"] = "both"
    kind: Literal["dip"] = "dip"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """DataFrame like that of `irregularities` with this dip alone, at track coordinates p (m), shape (n,)."""
        shape = _versine(p, self.start, self.length, self.depth)
        left, right = (shape * (self.rail in ("both", side)) for side in ("le", "ri"))
        return _frame(p, vertical_m=(right + left) / 2, crosslevel_rad=(right - left) / (2 * HALF_BASE))


@data.table
class AlignmentFault:
    """Lateral excursion of both rails: amplitude / 2 (1 - cos(2 pi (p - start) / length)).

    Attributes:
        start, length (float): Track coordinate at which the fault begins, and its whole length (m).
        amplitude (float): Excursion in the middle from the ideal track (m), positive to the right; no mid-chord offset.
    """

    start: _START
    length: _LENGTH
    amplitude: _HEIGHT
    kind: Literal["alignment_fault"] = "alignment_fault"

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """DataFrame like that of `irregularities` with this fault alone, at track coordinates p (m), shape (n,)."""
        return _frame(p, lateral_m=_versine(p, self.start, self.length, self.amplitude))


@data.table
class LateralOffset:
    """Stretch on which both rails are shifted sideways by a constant offset, as at a switch.

    Attributes:
        start, length (float): Track coordinate at which it begins, and its whole length with both transitions (m).
        offset (float): Offset between the transitions (m), positive to the right.
        transition (float): Length of each transition, a `smooth_step` (m).
    """

    start: _START
    length: _LENGTH
    offset: _HEIGHT
    transition: _LENGTH
    kind: Literal["lateral_offset"] = "lateral_offset"

    def __post_init__(self):
        if self.length < 2 * self.transition:
            raise ValueError(f"is {self.length:g} m long, at least two transitions of {self.transition:g} m are needed")

    def at(self, p: np.ndarray) -> pd.DataFrame:
        """DataFrame like that of `irregularities` with this offset alone, at track coordinates p (m), shape (n,)."""
        there, back = p - self.start, self.start + self.length - p
        return _frame(p, lateral_m=self.offset * smooth_step(np.minimum(there, back) / self.transition))


def _versine(p: np.ndarray, start: float, length: float, height: float) -> np.ndarray:
    return height / 2 * (1 - np.cos(2 * np.pi * np.clip((p - start) / length, 0, 1)))


def _frame(p: np.ndarray, **channels: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"p_m": p} | dict.fromkeys(CHANNELS.values(), 0.0) | channels)


@data.table
class Rough:
    """Arguments of `rough_track`: `spectrum` and `seed` as in `irregularities`, and `defects`, a tuple of `Dip`,
    `AlignmentFault` and `LateralOffset` to add."""

    defects: tuple[Annotated[Dip | AlignmentFault | LateralOffset, Field(discriminator="kind")], ...] = ()
    spectrum: str = "erri_low"
    seed: Annotated[int, SEED] = 1


def rough_track(p: np.ndarray, **arguments) -> pd.DataFrame:
    """Random irregularities with local defects at track coordinates p (m), shape (n,): a frame like `irregularities`.

    `arguments` are fields of `Rough`. `defects` is a list of dicts, such as {"kind": "dip", "start": 300.0, "length":
    8.0, "depth": 3e-3}. InputError unless p covers every defect, with at least four steps in each dip, fault and
    transition.
    """
    rough = data.build(Rough, arguments, "irregular")
    total = irregularities(p, rough.spectrum, rough.seed)
    p = total["p_m"].to_numpy()
    for defect in rough.defects:
        end, least = defect.start + defect.length, 4 * np.diff(p).max()
        if not p[0] <= defect.start < end <= p[-1] or getattr(defect, "transition", defect.length) < least:
            needed = f"a stretch within {p[0]:g} to {p[-1]:g} m with parts of at least {least:g} m is needed"
            raise InputError(f"{defect.kind}: {defect.start:g} to {end:g} m, {needed}")
        total = total + defect.at(p).assign(p_m=0.0)
    return total
