"""Comparison of the products of two runs: numbers of tables, pixels of images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import matplotlib.image
import numpy as np
import pandas as pd

from railrepro import data
from railrepro.data import Number, between

OUTCOMES = SAME, NEAR, DIFFERENT = ("same", "within tolerance", "different")
_SHARE = Annotated[Number, between(0.0, 1.0)]


@data.table
class Own:
    """Entry [[verify.own]] of notebooks/chain.toml: relative tolerance (-) of a column of a table, and why.

    `rows` is a query of pandas for the rows that it holds for.
    """

    table: str
    column: str
    rows: str
    relative: _SHARE
    why: str


@data.table
class Tolerance:
    """Table [verify] of notebooks/chain.toml: relative tolerance of tables (-), RMS tolerance of images (grey levels).

    Columns in `not_compared` (computation times) may differ; `own` has the tolerances of single columns.
    """

    relative: _SHARE = 0.0
    image_rms: Annotated[Number, between(0.0, 255.0, "grey levels")] = 0.0
    not_compared: tuple[str, ...] = ()
    own: tuple[Own, ...] = ()


def compare(committed: Path, rerun: Path, tolerance: Tolerance) -> pd.DataFrame:
    """Compare two tables (csv) or two images (png): one row per entry of a table, one row for an image.

    Columns name (column and metric, or in words what differs), apart (-: difference over the largest magnitude of the
    same name; of an image its root mean square over white), outcome (one of `OUTCOMES`).
    """
    for path in (committed, rerun):
        if not path.exists():
            return _judged(f"{path.name}, which is missing", np.inf, 0.0)
    if committed.suffix == ".png":
        old, new = matplotlib.image.imread(committed), matplotlib.image.imread(rerun)
        if old.shape != new.shape:
            return _judged("the size of the image", np.inf, 0.0)
        return _judged("the image", np.sqrt(np.mean((old.astype(float) - new) ** 2)), tolerance.image_rms / 255)
    table, again = pd.read_csv(committed), pd.read_csv(rerun)
    if list(table) != list(again) or len(table) != len(again):
        return _judged("its rows or columns", np.inf, 0.0)
    found = [_column(table, again, column, committed.name, tolerance) for column in table]
    return pd.concat(found, ignore_index=True)


def summary(entries: pd.DataFrame) -> str:
    """Text with the number of entries per outcome and the largest difference, from a table of `compare`."""
    text = ", ".join(f"{(entries['outcome'] == outcome).sum()} {outcome}" for outcome in OUTCOMES)
    if entries["apart"].max() > 0:
        worst = entries.iloc[entries["apart"].argmax()]
        text += f"; largest difference {worst['apart']:.1e} in {worst['name']}"
    return text


def _judged(name, apart, limit) -> pd.DataFrame:
    """Entries with their outcomes; arrays of one length, or numbers for a single one."""
    outcome = np.where(np.equal(apart, 0), SAME, np.where(apart <= limit, NEAR, DIFFERENT))
    return pd.DataFrame({"name": name, "apart": np.atleast_1d(apart), "outcome": np.atleast_1d(outcome)})


def _column(table: pd.DataFrame, again: pd.DataFrame, column: str, file: str, tolerance: Tolerance) -> pd.DataFrame:
    """Entries of a column of two tables, apart by their difference over the largest magnitude; inf without numbers.

    In the column `value` of a tidy table that of the same metric counts, whose name is in another column.
    """
    old, new = table[column], again[column]
    names = [name for name in ("metric", "quantity") if column == "value" and name in table]
    kind = table[names[0]].astype(str) if names else None
    apart = np.full(len(old), np.inf)
    if pd.api.types.is_numeric_dtype(old) and pd.api.types.is_numeric_dtype(new):
        size = old.astype(float).abs()
        largest = size.max() if kind is None else size.groupby(kind).transform("max")
        apart = ((old.astype(float) - new).abs() / largest).fillna(np.inf).to_numpy(copy=True)
    same = (old == new) | (old.isna() & new.isna())
    apart[same if column not in tolerance.not_compared else slice(None)] = 0.0
    limit = np.full(len(table), tolerance.relative)
    for own in tolerance.own:
        if (own.table, own.column) == (file, column):
            limit[table.eval(own.rows, engine="python")] = own.relative
    return _judged(column if kind is None else f"{column} of " + kind, apart, limit)
