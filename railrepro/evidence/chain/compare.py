"""Comparison of the products of two runs: numbers of tables, pixels of images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib.image
import numpy as np
import pandas as pd

from railrepro import data
from railrepro.data import Number, between

VALUE, KINDS = "value", ("metric", "quantity")
"""The column of a tidy table that holds metrics of different size, and the columns that may name them."""
_SHARE = Annotated[Number, between(0.0, 1.0)]


@data.table
class Own:
    """Entry [[verify.own]] of notebooks/chain.toml: tolerance of a column of a table, in the rows of a query or all."""

    table: str
    column: str
    relative: _SHARE
    why: str
    rows: str = ""


@data.table
class Tolerance:
    """Table [verify] of notebooks/chain.toml, see there."""

    relative: _SHARE = 0.0
    image_rms: Annotated[Number, between(0.0, 255.0, "grey levels")] = 0.0
    not_compared: tuple[str, ...] = ()
    own: tuple[Own, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """How many entries of a table (or images) are the same, within tolerance or different.

    Attributes
    ----------
    same, near, different : int
    largest : float
        Largest difference of numbers relative to the largest of their column, or of their metric in it (-).
    where : str
        Column and metric of it, or what else differs.
    """

    same: int = 0
    near: int = 0
    different: int = 0
    largest: float = 0.0
    where: str = ""

    def __add__(self, other: Comparison) -> Comparison:
        worst = max(self, other, key=lambda c: (c.largest, c.different, bool(c.where)))
        same, near, different = self.same + other.same, self.near + other.near, self.different + other.different
        return Comparison(same, near, different, worst.largest, worst.where)

    def __str__(self) -> str:
        text = f"{self.same} same, {self.near} within tolerance, {self.different} different"
        return text + (f"; largest difference {self.largest:.1e} in {self.where}" if self.where else "")


def compare(committed: Path, rerun: Path, tolerance: Tolerance) -> Comparison:
    """Compare two tables (csv) or two images (png) under the table [verify] of notebooks/chain.toml."""
    for path in (committed, rerun):
        if not path.exists():
            return Comparison(different=1, where=f"{path.name}, which is missing")
    kind = _images if committed.suffix == ".png" else _tables
    return kind(committed, rerun, tolerance)


def _tables(committed: Path, rerun: Path, tolerance: Tolerance) -> Comparison:
    old, new = pd.read_csv(committed), pd.read_csv(rerun)
    if list(old.columns) != list(new.columns) or len(old) != len(new):
        return Comparison(different=max(old.size, new.size), where="its rows or columns")
    total = Comparison()
    for column in old.columns:
        limit = limits(old, committed.name, column, tolerance)
        if column in tolerance.not_compared:
            total += Comparison(same=len(old))
            continue
        for name, rows in _scales(old, column).items():
            total += _columns(old[column].iloc[rows], new[column].iloc[rows], limit[rows], name)
    return total


def limits(table: pd.DataFrame, name: str, column: str, tolerance: Tolerance) -> np.ndarray:
    """What each row of a column may be off by, over the size of the column (-), shape (n,)."""
    found = np.full(len(table), tolerance.relative)
    for own in tolerance.own:
        if (own.table, own.column) == (name, column):
            chosen = table.eval(own.rows, engine="python").to_numpy() if own.rows else slice(None)
            found[chosen] = own.relative
    return found


def _scales(table: pd.DataFrame, column: str) -> dict[str, np.ndarray]:
    """Rows of a column that are of one size: those of one metric where the column holds several, else all."""
    kind = next((name for name in KINDS if column == VALUE and name in table), None)
    if kind is None:
        return {column: np.arange(len(table))}
    return {f"{column} of {name}": rows for name, rows in table.groupby(kind).indices.items()}


def _columns(a: pd.Series, b: pd.Series, limit: np.ndarray, name: str) -> Comparison:
    same = (a == b) | (a.isna() & b.isna())
    numeric = pd.api.types.is_numeric_dtype(a) and pd.api.types.is_numeric_dtype(b)
    if same.all() or not numeric:
        return Comparison(same=int(same.sum()), different=int((~same).sum()), where="" if same.all() else name)
    a, b = a.to_numpy(dtype=float), b.to_numpy(dtype=float)
    apart = np.where(same, 0.0, np.abs(a - b) / np.nanmax(np.abs(a), initial=np.finfo(float).tiny))
    near = apart <= limit  # false where only one of both is a number
    largest = float(np.nan_to_num(apart, nan=np.inf).max())
    return Comparison(int(same.sum()), int((near & ~same).sum()), int((~near).sum()), largest, name)


def _images(committed: Path, rerun: Path, tolerance: Tolerance) -> Comparison:
    old, new = matplotlib.image.imread(committed), matplotlib.image.imread(rerun)
    if old.shape != new.shape:
        return Comparison(different=1, where="the size of the image")
    if np.array_equal(old, new):
        return Comparison(same=1)
    grey_levels = 255 * np.sqrt(np.mean((old.astype(float) - new) ** 2))
    if grey_levels <= tolerance.image_rms:
        return Comparison(near=1)
    return Comparison(different=1, where=f"the image, {grey_levels:.1f} grey levels")
