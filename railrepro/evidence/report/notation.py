"""Symbols of the paper and of the car with their Python names, from data/notation.csv and data/vehicle.toml."""

from __future__ import annotations

import pandas as pd

from railrepro import paths
from railrepro.vehicle import parameters


def table() -> pd.DataFrame:
    """One row per symbol: symbol, meaning, unit, python, equation (label in the paper); then all vehicle parameters."""
    symbols = pd.read_csv(paths.source("data/notation.csv"), keep_default_na=False)
    entries = parameters.describe()
    entries = entries[entries["symbol"] != "-"]
    vehicle = {
        "symbol": entries["symbol"].map(_latex),
        "meaning": entries["key"].str.replace("_", " ").str.replace(".", ", "),
        "unit": entries["unit"],
        "python": "vehicle " + entries["key"],
        "equation": "",
    }
    return pd.concat([symbols, pd.DataFrame(vehicle)], ignore_index=True)


def _latex(symbol: str) -> str:
    head, _, index = symbol.partition("_")
    greek = {"mu", "nu", "tau", "psi", "delta"}
    return f"${chr(92) + head if head in greek else head}{f'_{{{index}}}' if index else ''}$"
