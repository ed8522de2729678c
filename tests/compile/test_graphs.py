"""Stored graphs: the same as derived ones, for this very code, and for nothing else."""

import os
import shutil

import casadi as ca
import pytest

from railrepro import code
from railrepro.car import equations
from railrepro.compile import cache, codegen, graphs
from railrepro.control import lateral, law
from railrepro.control.ndi import NDI
from railrepro.control.problem import dynamics
from railrepro.control.solvers.recursion import barrier, recursion
from railrepro.model import control_model, forecast


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """A stored function that counts how often it builds, what it gave first, its file, and how to forget."""
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    built = []

    def build(power):
        built.append(power)
        x = ca.SX.sym("x", 2)
        return {"functions": (ca.Function("f", [x], [x**power]),), "names": ["a", 0.1, None, True]}

    build.__module__ = "railrepro.anywhere"
    look = graphs.stored(build)
    look(3)
    (file,) = tmp_path.glob("*.graph")
    return look, built, file


def test_what_was_built_once_is_read_by_the_next_process(counted):
    look, built, _ = counted
    first = look(3)
    assert look(3) is first and built == [3]
    look.cache_clear()
    again = look(3)
    assert built == [3]
    assert again["names"] == ["a", 0.1, None, True] and isinstance(again["functions"], tuple)
    assert codegen.source_text(again["functions"]) == codegen.source_text(first["functions"])
    look(4)
    assert built == [3, 4]
    look.cache_clear()
    look(3), look(4)
    assert built == [3, 4]


def cut(file):
    file.write_bytes(file.read_bytes()[:-1])


def other_digit(file):
    content = bytearray(file.read_bytes())
    content[-20] ^= 1
    file.write_bytes(content)


def open_to_others(file):
    file.chmod(0o666)


def linked(file):
    shutil.move(file, file.with_suffix(".elsewhere"))
    os.symlink(file.with_suffix(".elsewhere"), file)


@pytest.mark.parametrize("spoil", [cut, other_digit, open_to_others, linked, lambda file: file.write_bytes(b"")])
def test_a_broken_or_foreign_file_is_built_again(counted, spoil):
    look, built, file = counted
    spoil(file)
    look.cache_clear()
    look(3)
    assert built == [3, 3]
    look.cache_clear()
    look(3)
    assert built == [3, 3]


def test_a_graph_of_other_code_is_built_again(counted, monkeypatch):
    look, built, _ = counted
    monkeypatch.setattr(code, "version", lambda: "other")
    look.cache_clear()
    look(3)
    assert built == [3, 3]


@pytest.mark.parametrize(
    ("build", "arguments"),
    [
        (equations._derived, ()),
        (control_model._rhs, ((),)),
        (control_model._rhs, (("D1", "D3"),)),
        (dynamics, ("corrected", "rk4")),
        (recursion, ("corrected", "midpoint")),
        (barrier, ("corrected", "midpoint")),
        (forecast.functions, ()),
        (law.function, (law.LawSignature(lateral.signature(NDI()), True),)),
    ],
)
def test_a_stored_graph_gives_the_same_c_source_as_the_derived_one(build, arguments):
    build(*arguments)
    build.cache_clear()
    read, derived = build(*arguments), build.__wrapped__(*arguments)

    def text(value):
        if isinstance(value, ca.Function):
            return codegen.source_text([value])
        if isinstance(value, dict):
            return {name: text(entry) for name, entry in value.items()}
        return type(value)(text(entry) for entry in value) if isinstance(value, tuple) else value

    assert text(read) == text(derived)
