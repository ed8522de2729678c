"""Random irregularities with local defects. Both are frames of irregularities, see `railrepro.track.irregularity`.
Serves the paper's outlook (known lateral track irregularities)."""

from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from railrepro import data
from railrepro.track.irregularity import HALF_BASE, LARGEST, SEED, irregularities, smooth_step

_START = Annotated[data.Number, data.between(-1e6, 1e6, "m")]
_LENGTH = Annotated[data.Number, data.above(0.0, 1e6, "m")]
_HEIGHT = Annotated[data.Number, data.between(-LARGEST, LARGEST, "m")]


@data.table
class Dip:
    """Vertical dip of the rail "le" (left), "ri" (right) or both: depth / 2 (1 - cos(2 pi (p - start) / length)), from
    the track coordinate `start` over `length` (m). A negative `depth` (m) is a hump."""

    start: _START
    length: _LENGTH
    depth: _HEIGHT
    rail: Literal["both", "le", "ri"] = "both"
    kind: Literal["dip"] = "dip"

    def channels(self, p: np.ndarray) -> dict[str, np.ndarray]:
        """Change of irregularities by the dip at track coordinates p (m): dict of vertical_m and crosslevel_rad."""
        shape = _versine(p, self.start, self.length, self.depth)
        left, right = (shape * (self.rail in ("both", side)) for side in ("le", "ri"))
        return {"vertical_m": (right + left) / 2, "crosslevel_rad": (right - left) / (2 * HALF_BASE)}


@data.table
class AlignmentFault:
    """Lateral bulge of both rails: amplitude / 2 (1 - cos(2 pi (p - start) / length)), from the track coordinate
    `start` over `length` (m). `amplitude` (m, positive to the right) is its peak over the ideal track."""

    start: _START
    length: _LENGTH
    amplitude: _HEIGHT
    kind: Literal["alignment_fault"] = "alignment_fault"

    def channels(self, p: np.ndarray) -> dict[str, np.ndarray]:
        """Change of lateral_m, the only column of irregularities that the fault changes, at track coordinates p (m)."""
        return {"lateral_m": _versine(p, self.start, self.length, self.amplitude)}


@data.table
class LateralOffset:
    """Constant lateral `offset` of both rails (m, positive to the right), as at a switch, with the length `length` from
    the track coordinate `start` (m). This includes a smooth transition of the length `transition` (m) at each end."""

    start: _START
    length: _LENGTH
    offset: _HEIGHT
    transition: _LENGTH
    kind: Literal["lateral_offset"] = "lateral_offset"

    def __post_init__(self):
        if self.length < 2 * self.transition:
            raise ValueError(f"is {self.length:g} m long, at least two transitions of {self.transition:g} m are needed")

    def channels(self, p: np.ndarray) -> dict[str, np.ndarray]:
        """Change of lateral_m, the only column of irregularities that the offset changes, at coordinates p (m)."""
        to_nearest_end = np.minimum(p - self.start, self.start + self.length - p)
        return {"lateral_m": self.offset * smooth_step(to_nearest_end / self.transition)}


def _versine(p: np.ndarray, start: float, length: float, height: float) -> np.ndarray:
    """Wave height / 2 (1 - cos(2 pi (p - start) / length)) from `start` over `length`, 0 outside."""
    return height / 2 * (1 - np.cos(2 * np.pi * np.clip((p - start) / length, 0, 1)))


@data.table
class Rough:
    """Arguments of `rough_track`: local defects in the rails; spectrum of the random irregularities; their seed."""

    defects: tuple[Annotated[Dip | AlignmentFault | LateralOffset, Field(discriminator="kind")], ...] = ()
    spectrum: str = "erri_low"
    seed: Annotated[int, SEED] = 1


def rough_track(p: np.ndarray, **arguments) -> pd.DataFrame:
    """Make irregular rails at track coordinates p (m), shape (n,): a DataFrame with the columns p_m, lateral_m,
    vertical_m, crosslevel_rad, gauge_m, random irregularities plus local defects. `arguments` are `spectrum`
    ("erri_low", …), `seed` and `defects`, a list of dicts with the `kind` "dip", "alignment_fault" or "lateral_offset"
    and the fields of its class, as {"kind": "dip", "start": 300.0, "length": 8.0, "depth": 3e-3}. InputError unless p
    covers every defect, with at least four steps in each dip, fault and transition."""
    rough = data.build(Rough, arguments, "irregular")
    total = irregularities(p, rough.spectrum, rough.seed)
    p = total["p_m"].to_numpy()
    for defect in rough.defects:
        end, least = defect.start + defect.length, 4 * np.diff(p).max()
        if not p[0] <= defect.start < end <= p[-1] or getattr(defect, "transition", defect.length) < least:
            needed = f"a stretch within {p[0]:g} to {p[-1]:g} m with parts of at least {least:g} m is needed"
            raise data.InputError(f"{defect.kind}: {defect.start:g} to {end:g} m, {needed}")
        for column, change in defect.channels(p).items():
            total[column] += change
    return total
