"""Comparison of the products of two runs: numbers of tables, pixels of images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import matplotlib.image
import numpy as np
import pandas as pd

from railrepro import data
from railrepro.data import Number, between

VALUE, KINDS = "value", ("metric", "quantity")
"""Column of a tidy table that holds values of several metrics; columns of which one holds the name of the metric."""
OUTCOMES = SAME, NEAR, DIFFERENT = ("same", "within tolerance", "different")
_SHARE = Annotated[Number, between(0.0, 1.0)]


@data.table
class Own:
    """Entry [[verify.own]] of notebooks/chain.toml: relative tolerance (-) of a column of a table, and why.

    `rows` is a query of pandas for the rows that it holds for; "" takes all.
    """

    table: str
    column: str
    relative: _SHARE
    why: str
    rows: str = ""


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
    return (_images if committed.suffix == ".png" else _tables)(committed, rerun, tolerance)


def summary(entries: pd.DataFrame) -> str:
    """Text with the number of entries per outcome and the largest difference, from a table of `compare`."""
    text = ", ".join(f"{(entries['outcome'] == outcome).sum()} {outcome}" for outcome in OUTCOMES)
    if entries.empty:
        return text
    worst = entries.iloc[entries["apart"].argmax()]
    return text + (f"; largest difference {worst['apart']:.1e} in {worst['name']}" if worst["apart"] else "")


def _judged(name, apart, limit) -> pd.DataFrame:
    """Entries with their outcomes; arrays of one length, or numbers for a single one."""
    outcome = np.where(np.equal(apart, 0), SAME, np.where(apart <= limit, NEAR, DIFFERENT))
    return pd.DataFrame({"name": name, "apart": np.atleast_1d(apart), "outcome": np.atleast_1d(outcome)})


def _tables(committed: Path, rerun: Path, tolerance: Tolerance) -> pd.DataFrame:
    old, new = pd.read_csv(committed), pd.read_csv(rerun)
    if list(old.columns) != list(new.columns) or len(old) != len(new):
        return _judged("its rows or columns", np.inf, 0.0)
    parts = []
    for column in old.columns:
        kind = next((name for name in KINDS if column == VALUE and name in old), None)
        name = column if kind is None else f"{column} of " + old[kind].astype(str)
        apart = _apart(old[column], new[column], None if kind is None else old[kind])
        apart[(old[column] == new[column]) | (old[column].isna() & new[column].isna())] = 0.0
        if column in tolerance.not_compared:
            apart[:] = 0.0
        parts.append(_judged(name, apart, limits(old, committed.name, column, tolerance)))
    return pd.concat(parts, ignore_index=True)


def _apart(old: pd.Series, new: pd.Series, kind: pd.Series | None) -> np.ndarray:
    """Differences over the largest magnitude of the column, or of its metric in it (-); infinite without numbers."""
    if not (pd.api.types.is_numeric_dtype(old) and pd.api.types.is_numeric_dtype(new)):
        return np.full(len(old), np.inf)
    size = old.astype(float).abs()
    largest = size.max() if kind is None else size.groupby(kind).transform("max")
    return ((old.astype(float) - new).abs() / largest).fillna(np.inf).to_numpy(copy=True)


def limits(table: pd.DataFrame, name: str, column: str, tolerance: Tolerance) -> np.ndarray:
    """Tolerance of each row of `column` of `table` relative to the largest magnitude in that column (-), shape (n,).

    `name` is the file name of the table, by which `tolerance` may have its own entries.
    """
    found = np.full(len(table), tolerance.relative)
    for own in tolerance.own:
        if (own.table, own.column) == (name, column):
            chosen = table.eval(own.rows, engine="python").to_numpy() if own.rows else slice(None)
            found[chosen] = own.relative
    return found


def _images(committed: Path, rerun: Path, tolerance: Tolerance) -> pd.DataFrame:
    old, new = matplotlib.image.imread(committed), matplotlib.image.imread(rerun)
    if old.shape != new.shape:
        return _judged("the size of the image", np.inf, 0.0)
    return _judged("the image", np.sqrt(np.mean((old.astype(float) - new) ** 2)), tolerance.image_rms / 255)
