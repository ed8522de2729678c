"""Every Python name in the notation table exists, and nothing of the control model is left out."""

import dataclasses
import importlib
import re

from railrepro.car import equations
from railrepro.control import interface
from railrepro.evidence.report import notation
from railrepro.model import derivation
from railrepro.vehicle import parameters

TABLE, VEHICLE = notation.table(), parameters.load_vehicle()


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


def exists(owner, path):
    for name in path:
        fields = {field.name for field in dataclasses.fields(owner)} if dataclasses.is_dataclass(owner) else set()
        if isinstance(owner, dict):
            if name not in owner:
                return False
            owner = owner[name]
        elif name in fields or hasattr(owner, name):
            owner = getattr(owner, name, None)
        else:
            try:
                owner = importlib.import_module(f"{owner.__name__}.{name}")
            except (ImportError, AttributeError):
                return False
    return True


def known(kind, name):
    """Whether an entry of the table names something that is there."""
    if kind == "series":
        return name in {
            *equations.car().outputs,
            *(f"front.{field.name}" for field in dataclasses.fields(interface.Record)),
        }
    if kind == "vehicle":
        return exists(VEHICLE, name.split("."))
    return exists(importlib.import_module("railrepro"), name.split(".")[1:])


def test_every_name_exists():
    entries = {entry for cell in TABLE["python"] for entry in names(cell)}
    assert len(entries) > 100
    missing = sorted(" ".join(entry) for entry in entries if not known(*entry))
    assert not missing, "not there: " + ", ".join(missing)


def test_all_of_the_control_model_is_there():
    listed = {name for cell in TABLE["python"] for _, name in names(cell)}
    symbols = {id(value): name for name, value in vars(derivation).items()}
    quantities = [*derivation.parameters, *derivation.theta, *derivation.torques, *derivation.rates[:2]]
    for quantity in [*quantities, *derivation.coordinates[:3]]:
        assert f"railrepro.model.derivation.{symbols[id(quantity)]}" in listed
    keys = set(parameters.describe().query("symbol != '-'")["key"])
    assert {f"vehicle {key}" for key in keys} <= set(TABLE["python"])
