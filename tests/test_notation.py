"""Every Python name in the notation table exists, and nothing of the control model is left out."""

import dataclasses
import importlib
import os
import re
from pathlib import Path

import pytest
import symbols

from railrepro.car import equations
from railrepro.control import law
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
        return name in {*equations.car().outputs, *law.RECORD}
    if kind == "vehicle":
        return exists(VEHICLE, name.split("."))
    return exists(importlib.import_module("railrepro"), name.split(".")[1:])


def test_every_name_exists():
    entries = {entry for cell in TABLE["python"] for entry in names(cell)}
    assert len(entries) > 100
    missing = sorted(" ".join(entry) for entry in entries if not known(*entry))
    assert not missing, "not there: " + ", ".join(missing)


def test_an_invented_name_is_found_out():
    assert not known("library", "railrepro.model.derivation.nonsense")
    assert not known("vehicle", "wheel.colour")
    assert not known("vehicle", "adhesion.dry.colour")
    assert not known("series", "front.colour")


def test_all_of_the_control_model_is_there():
    listed = {name for cell in TABLE["python"] for _, name in names(cell)}
    symbols = {id(value): name for name, value in vars(derivation).items()}
    quantities = [*derivation.parameters, *derivation.theta, *derivation.torques, *derivation.rates[:2]]
    for quantity in [*quantities, *derivation.coordinates[:3]]:
        assert f"railrepro.model.derivation.{symbols[id(quantity)]}" in listed
    keys = set(parameters.describe().query("symbol != '-'")["key"])
    assert {f"vehicle {key}" for key in keys} <= set(TABLE["python"])


LOCAL = {"b:M", "b:v", "b:v_biM", "b:z", "b:z_vw", "z", "i", "j"}
"""Letters of one definition each (norm, sequence) and running indices."""


def ours():
    return set().union(*(symbols.symbols(cell.replace("$", " ")) for cell in TABLE["symbol"]))


@pytest.mark.parametrize(
    ("latex", "found"),
    [
        (r"\dot{\psi}_{\ur{Ax}_k}^{\ur{d}}", {"psi_Ax"}),
        (r"\bi{\cali{U}}", {"c:U"}),
        (r"\bi{Q}_L + \bar{\sigma}", {"b:Q", "sigma"}),
        (r"f_{x_{\ur{max}}}", {"f_xmax"}),
        (r"160 \,\ur{km/h}", set()),
        (r"\sin \psitrax", {"psi_TrAx"}),
    ],
)
def test_symbols_are_read_from_formulas(latex, found):
    assert symbols.symbols(latex) == found


def test_known_symbols_are_there():
    lacked_once = {"H", "sigma", "nu", "V", "G", "J_term", "f_max", "s_max", "tau_min", "l_sup", "c:F_Train", "c:L"}
    assert lacked_once | {"b:x_lin", "b:q_red", "b:R_Tr", "f", "s", "a", "delta"} <= ours()


@pytest.mark.skipif(
    "RAILREPRO_PAPER" not in os.environ, reason="RAILREPRO_PAPER does not name the paper's LaTeX source"
)
def test_no_symbol_of_the_paper_is_left_out():
    theirs = symbols.symbols(symbols.formulas(Path(os.environ["RAILREPRO_PAPER"]).read_text(encoding="utf-8")))
    assert len(theirs) > 80
    assert theirs - ours() - LOCAL == set()
