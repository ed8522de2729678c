"""Comparison of the products of two runs: numbers of tables, pixels of images."""

from pathlib import Path
from typing import Annotated

import matplotlib.image
import numpy as np
import pandas as pd

from railrepro import data

OUTCOMES = SAME, NEAR, DIFFERENT = ("same", "within tolerance", "different")
_SHARE = Annotated[data.Number, data.between(0.0, 1.0)]


@data.table
class Own:
    """Tolerance for a `column` of a table, "*" for all, an item [[verify.own]] of chain.toml. `table` is a file name,
    `rows` a query of pandas that selects rows, `relative` the tolerance (-), `why` its reason."""

    table: str
    column: str
    rows: str
    relative: _SHARE
    why: str


@data.table
class Tolerance:
    """Tolerances for the comparison of two runs, the table [verify] of notebooks/chain.toml. `relative` is for numbers
    in tables (over the largest in their column), `image_rms` for images (RMS, grey levels of 255), `own` for single
    columns in place of `relative`. Columns in `not_compared` (computation times) may differ by any amount."""

    relative: _SHARE = 0.0
    image_rms: Annotated[data.Number, data.between(0.0, 255.0, "grey levels")] = 0.0
    not_compared: tuple[str, ...] = ()
    own: tuple[Own, ...] = ()


def compare(committed: Path, rerun: Path, tolerance: Tolerance) -> pd.DataFrame:
    """Compare two tables (csv) or two images (png): returns one row per cell of a table, one row for an image. Columns:
    name; apart, the difference (-); outcome, "same", "within tolerance" or "different". The name of a cell is its
    column, as "delay_m"; in a column "value" beside a column "metric" or "quantity" it names the entry there, as "value
    of delay". Where no cells are compared, `name` is "the image", or what differs: "its rows or columns", "the size of
    the image", "FILE, which is missing"; then `apart` is inf. In tables `apart` is relative to the largest committed
    magnitude under the same name, inf for changed text; in images it is the RMS of the levels (0 black, 1 white)."""
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
    """Text with the number of cells per outcome and the largest difference, from a table of `compare`."""
    text = ", ".join(f"{(entries['outcome'] == outcome).sum()} {outcome}" for outcome in OUTCOMES)
    if entries["apart"].max() > 0:
        worst = entries.iloc[entries["apart"].argmax()]
        text += f"; largest difference {worst['apart']:.1e} in {worst['name']}"
    return text


def _judged(name, apart, limit) -> pd.DataFrame:
    """Table of `compare` from arrays of equal length, or from scalars for one row."""
    outcome = np.where(np.equal(apart, 0), SAME, np.where(apart <= limit, NEAR, DIFFERENT))
    return pd.DataFrame({"name": name, "apart": np.atleast_1d(apart), "outcome": np.atleast_1d(outcome)})


def _column(table: pd.DataFrame, again: pd.DataFrame, column: str, file: str, tolerance: Tolerance) -> pd.DataFrame:
    """Rows of `compare` for one column; in the column `value` of a tidy table magnitudes are per metric."""
    old, new = table[column], again[column]
    names = [name for name in ("metric", "quantity") if column == "value" and name in table]
    kind = table[names[0]].astype(str) if names else None
    apart = np.full(len(old), np.inf)
    if pd.api.types.is_numeric_dtype(old) and pd.api.types.is_numeric_dtype(new):
        size = old.astype(float).abs()
        largest = size.max() if kind is None else size.groupby(kind).transform("max")
        apart = ((old.astype(float) - new).abs() / largest).fillna(np.inf).to_numpy(copy=True)
    same = (old == new) | (old.isna() & new.isna())
    apart[same | (column in tolerance.not_compared)] = 0.0
    limit = np.full(len(table), tolerance.relative)
    for own in tolerance.own:
        if own.table == file and own.column in (column, "*"):
            limit[table.eval(own.rows, engine="python")] = own.relative
    return _judged(column if kind is None else f"{column} of " + kind, apart, limit)
