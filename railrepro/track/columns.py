"""Columns of numbers along the track in a CSV, and how a wrong one is refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro.data import InputError


def read_numbers(file: Path, needed: Iterable[Sequence[str]], optional: Iterable[Sequence[str]] = ()) -> pd.DataFrame:
    """Finite numbers of a CSV along the track.

    Parameters
    ----------
    file : Path
        CSV whose rows follow the first needed column.
    needed, optional : iterable of sequences of str
        Columns, each with the names that it may have; others are ignored. A column radius_m may be empty or infinite.

    Returns
    -------
    DataFrame
        At least two rows; the columns that are there, in the order asked for, with their names in the file.

    Raises
    ------
    InputError
        A column that is missing or there twice, anything but a finite number, first column not increasing.
    """
    try:
        text = pd.read_csv(file, header=None, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({str(error).strip()})") from error
    head = text.iloc[0].tolist()
    columns, must = [], list(needed)
    for names in [*must, *optional]:
        there = [name for name in head if name in names]
        if len(there) > 1 or (not there and names in must):
            raise InputError(f"{file.name}: has {there or 'none'} of {list(names)} among {head}, one of them is needed")
        columns += there
    if len(text) < 3:
        raise InputError(f"{file.name}: {len(text) - 1} rows found, at least 2 are needed")
    text = text.iloc[1:].set_axis(head, axis="columns").reset_index(drop=True)[columns]
    numbers = text.apply(pd.to_numeric, errors="coerce").astype(float)
    if "radius_m" in numbers:
        straight = (text["radius_m"] == "") | np.isinf(numbers["radius_m"])
        numbers["radius_m"] = numbers["radius_m"].mask(straight, 0.0)
    for row, column in np.argwhere(~np.isfinite(numbers.to_numpy()))[:1]:
        found = f"{columns[column]} is {text.iloc[row, column]!r}"
        raise InputError(f"{file.name}: row {row + 2}, {found}, a finite number is needed")
    along = numbers[columns[0]]
    refuse(file.name, along, np.diff(along, prepend=-np.inf) <= 0, "which does not increase")
    return numbers


def refuse(where: str, values: pd.Series, wrong, allowed: str) -> None:
    """Refuse a column of a CSV with the first of the rows that are wrong; InputError."""
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise InputError(f"{where}: row {row + 2}, {values.name} = {values.iloc[row]:g}, {allowed}")
