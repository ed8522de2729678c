"""Every Python name in the notation table exists."""

import dataclasses
import pkgutil
import re

import pandas as pd

from railrepro import paths
from railrepro.car import equations
from railrepro.control import interface
from railrepro.vehicle import parameters

TABLE, VEHICLE = pd.read_csv(paths.DATA / "notation.csv", keep_default_na=False), parameters.load_vehicle()
SERIES = {*equations.car().outputs, *(f"front.{field.name}" for field in dataclasses.fields(interface.Record))}


def names(python):
    """Kind and full name of each entry of a cell: library paths, vehicle keys, columns of a run."""
    found, kind, prefix = [], "library", ""
    for entry in re.split("[,;] ", python):
        word, _, name = entry.rpartition(" ")
        if word:
            kind = word
        elif name.startswith("railrepro."):
            kind, prefix = "library", name.rpartition(".")[0] + "."
        elif kind == "library":
            name = prefix + name
        found.append((kind, name))
    return found


def known(kind, name):
    """Whether an entry of the table names something that is there."""
    if kind == "series":
        return name in SERIES
    home, _, last = name.rpartition(".")
    try:
        if kind == "library":
            fields = getattr(pkgutil.resolve_name(home), "__annotations__", {})
            return last in fields or pkgutil.resolve_name(name) is not None
        owner = VEHICLE
        for part in name.split("."):
            owner = owner[part] if isinstance(owner, dict) else getattr(owner, part)
        return True
    except (ImportError, AttributeError, KeyError):
        return False


def test_every_name_exists():
    entries = {entry for cell in TABLE["python"] for entry in names(cell)}
    assert len(entries) > 100
    missing = sorted(" ".join(entry) for entry in entries if not known(*entry))
    assert not missing, "not there: " + ", ".join(missing)
