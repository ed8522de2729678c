"""Stored graphs equal derived ones, and are used only if code and settings are the same."""

import json
import pickle
import zlib
from dataclasses import dataclass

import casadi as ca
import pandas as pd
import pytest

from railrepro import code
from railrepro.car import equations
from railrepro.compile import cache, codegen
from railrepro.control import lateral, law
from railrepro.control.ndi import NDI
from railrepro.control.solvers.recursion import recursion


@dataclass
class Built:
    functions: tuple[ca.Function]
    table: pd.DataFrame
    names: tuple[str, ...]
    values: list


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """A stored function, called once, that counts how often it builds, and its file."""
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    built = []

    @codegen.stored
    def look(power) -> Built:
        built.append(power)
        x = ca.SX.sym("x", 2)
        table = pd.DataFrame({"whole": [1, 2], "real": [0.1, float("nan")]})
        return Built((ca.Function("f", [x], [x**power]),), table, ("a", "b"), ["a", 0.1, None, True])

    look(3)
    (file,) = tmp_path.glob("*.graph")
    return look, built, file


def test_what_was_built_once_is_read_by_the_next_process(counted):
    look, built, _ = counted
    first = look(3)
    look.cache_clear()
    again = look(3)
    assert again is not first and built == [3]
    assert (again.names, again.values) == (("a", "b"), ["a", 0.1, None, True]) and isinstance(again.functions, tuple)
    pd.testing.assert_frame_equal(again.table, first.table, check_exact=True)
    assert codegen.source_text(again.functions) == codegen.source_text(first.functions)
    look(4)
    look.cache_clear()
    look(3), look(4)
    assert built == [3, 4]


class Shout:
    def __reduce__(self):
        return pytest.fail, ("a pickle was executed",)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: content[:-20] + bytes([content[-20] ^ 1]) + content[-19:],
        lambda content: b"",
        lambda content: content[:32] + zlib.compress(pickle.dumps(Shout())),
    ],
    ids=["another digit", "empty", "a pickle"],
)
def test_a_broken_file_or_one_of_other_code_is_built_again(counted, spoil, monkeypatch):
    look, built, file = counted
    file.write_bytes(spoil(file.read_bytes()))
    for change in (
        lambda: None,
        lambda: None,
        lambda: monkeypatch.setattr(code, "version", lambda: "other"),
        lambda: monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem"),  # other kernels may round otherwise
    ):
        change()
        look.cache_clear()
        look(3)
    assert built == 4 * [3]


@pytest.mark.parametrize(
    ("build", "arguments"),
    [
        (equations.car, ()),
        (recursion, ("corrected", "midpoint")),
        (law.function, (law.LawSignature(lateral.signature(NDI()), True),)),
    ],
)
def test_a_stored_graph_gives_the_same_c_source_as_the_derived_one(build, arguments):
    build(*arguments)
    build.cache_clear()
    read, derived = build(*arguments), build.__wrapped__.__wrapped__(*arguments)

    def text(value):
        return codegen.source_text([value]) if isinstance(value, ca.Function) else vars(value)

    assert json.dumps(read, default=text) == json.dumps(derived, default=text)
