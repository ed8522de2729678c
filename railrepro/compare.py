"""Comparison of the products of two runs: numbers of tables, pixels of images."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd

SUFFIXES = (".csv", ".png")
"""Kinds of products that are compared; the other formats of a figure hold the same."""
SAME, NEAR, DIFFERENT = "same", "within tolerance", "different"


def compare(committed: Path, rerun: Path, tolerance: dict) -> dict[str, int]:
    """Count what is the same, within tolerance or different.

    Parameters
    ----------
    committed, rerun : Path
        Two tables (csv) or two images (png).
    tolerance : dict
        The table [verify] of notebooks/chain.toml.

    Returns
    -------
    dict
        Number of table entries, or of images, per outcome.
    """
    if not committed.exists():
        return _counts(different=1)
    kind = _images if committed.suffix == ".png" else _tables
    return kind(committed, rerun, tolerance)


def _counts(same: int = 0, near: int = 0, different: int = 0) -> dict[str, int]:
    return {SAME: int(same), NEAR: int(near), DIFFERENT: int(different)}


def _tables(committed: Path, rerun: Path, tolerance: dict) -> dict[str, int]:
    old, new = pd.read_csv(committed), pd.read_csv(rerun)
    if list(old.columns) != list(new.columns) or len(old) != len(new):
        return _counts(different=max(old.size, new.size))
    counts = np.zeros(3, dtype=int)
    for column in old.columns:
        a, b = old[column], new[column]
        same = (a == b) | (a.isna() & b.isna())
        near = same | (column in tolerance["not_compared"])
        numeric = pd.api.types.is_numeric_dtype(a) and pd.api.types.is_numeric_dtype(b)
        if numeric and column not in tolerance["not_compared"]:
            a, b = a.to_numpy(dtype=float), b.to_numpy(dtype=float)
            near |= np.abs(a - b) <= tolerance["relative"] * np.nanmax(np.abs(a), initial=0.0)
        counts += same.sum(), (near & ~same).sum(), (~near).sum()
    return _counts(*counts)


def _images(committed: Path, rerun: Path, tolerance: dict) -> dict[str, int]:
    old, new = matplotlib.image.imread(committed), matplotlib.image.imread(rerun)
    if old.shape != new.shape:
        return _counts(different=1)
    if np.array_equal(old, new):
        return _counts(same=1)
    grey_levels = 255 * np.sqrt(np.mean((old.astype(float) - new) ** 2))
    return _counts(near=1) if grey_levels <= tolerance["image_rms"] else _counts(different=1)
