"""Sets of arguments and twins side by side have the values of single operations; divisions are shared."""

import ctypes
import re

import casadi as ca
import numpy as np
import pytest

from railrepro.car import component, equations
from railrepro.car.component import SteppedCar
from railrepro.compile import codegen, lanes
from railrepro.compile.lanes import lanes_header, lanes_text, pairs_text
from railrepro.compile.reciprocals import share_reciprocals


def test_lanes_equal_single_evaluations():
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    chosen = ca.if_else(ca.logic_and(x[0] < x[1], ca.logic_not(p[0] > 1)), ca.fmin(x[0], 0.8) ** 0.3, ca.exp(-x[1]))
    wide = ca.vertcat(ca.sin(x[0]) / x[1], -ca.cos(x[1]) * p[0] - 2 * x[0] + x[1] ** 2, 1 / x[1], 3.5 + p[1], chosen)
    function = ca.Function("several", [x, p], [wide, ca.tan(p[0] * x[0])], ["x", "p"], ["first", "second"])
    entry = """
void run(const void *x, const double *p, void *first, void *second) {
  lanes_t in[2], out[5], last[1];
  memcpy(in, x, sizeof in);
  several_lanes(in, p, out, last);
  memcpy(first, out, sizeof out), memcpy(second, last, sizeof last);
}
"""
    text = codegen.PREAMBLE + lanes_header() + lanes_text(function, common=["p"]) + entry
    sets, common = np.random.default_rng(0).uniform(0.5, 1.5, (2, 4)), np.array([0.3, -0.7])
    first, second = np.zeros((5, 4)), np.zeros((1, 4))
    arrays = (ctypes.c_void_p(array.ctypes.data) for array in (sets, common, first, second))
    codegen.library([function], text).run(*arrays)
    for values, *results in zip(sets.T, first.T, second.T, strict=True):
        for found, exact in zip(results, function(values, common), strict=True):
            np.testing.assert_allclose(found, exact.nonzeros(), rtol=1e-14)


@pytest.mark.parametrize("piece", [1, 3, 10, 1000])
def test_twins_have_the_bits_of_single_operations(piece, monkeypatch):
    """Functions of two gears on a body, sums over both, the sign of an end of the car, a part without twin."""
    monkeypatch.setattr(lanes, "_PIECE", piece)
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 2)
    body, gears, seats = x[:2], (x[2:4], x[4:]), (ca.SX(0.5), ca.SX(-0.5))
    forces = [
        ca.sin(gear[0] - seat * p[0]) * ca.exp(gear[1]) + ca.if_else(gear[0] < body[0], ca.sqrt(gear[1]), body[1] ** 2)
        for gear, seat in zip(gears, seats, strict=True)
    ]
    rates = [*forces, forces[0] + forces[1], forces[0] - forces[1], ca.cos(body[0]) / p[1], gears[0][0] * gears[1][1]]
    rates += [gears[0][0] - gears[0][1], gears[1][1] - gears[1][0]]  # no twins, a difference has its order
    function = ca.Function("gears", [x, p], [ca.vertcat(*rates), forces[1]], ["x", "p"], ["rates", "rear"])
    text = pairs_text(function, {"x": [0, 1, 4, 5, 2, 3]})
    library = codegen.library((), "#define casadi_int long long\n" + lanes_header(2) + text)
    single, twins = codegen.CompiledFunction(function), codegen.CompiledFunction(function, library)
    assert len(re.findall(r"lanes_exp\(", text)) == 1 and "own_exp(" not in text
    assert ("gears_1(" in text) == (piece < 1000)
    for values in np.random.default_rng(0).uniform(0.1, 1.5, (50, 8)):
        for bound in (single, twins):
            bound.arguments[0][:], bound.arguments[1][:] = values[:6], values[6:]
        np.testing.assert_array_equal(np.concatenate(twins()), np.concatenate(single()))
    assert pairs_text(function, {}).count("lanes_t") == 0


@pytest.mark.parametrize("name", ["coordinates", "output", "step"])
def test_the_car_has_the_bits_of_single_operations(name):
    car = SteppedCar("T3", 70.0)
    car.step([900.0, -300.0, 500.0, 100.0], steps=400)
    given = dict(zip(("x", "u", "rows", "contacts", "par"), car.inputs(), strict=True)) | {"h": 1e-3}
    function = getattr(car.model, name)
    single, twins = codegen.CompiledFunction(function), codegen.CompiledFunction(function, component.library())
    for bound in (single, twins):
        for argument, of in zip(bound.arguments, function.name_in(), strict=True):
            argument[:] = np.ravel(given[of], order="F")
    for one, other in zip(twins(), single(), strict=True):
        np.testing.assert_array_equal(one, other)
    text = pairs_text(function, equations.mirrored())
    assert text.count("const lanes_t") > 3 * text.count("const double t")


def test_a_denominator_is_inverted_once():
    """As many divisions as denominators, and equal values."""
    x, y = ca.SX.sym("x", 5), ca.SX.sym("y", 2)
    before = ca.Function("f", [x, y], [x[:4] / y[0], ca.sin(x[0] / y[0]) / y[1], 1 / y[1], x[4] / x[0]])
    after = share_reciprocals(before)
    divisions = [after.instruction_id(k) for k in range(after.n_instructions())]
    assert sum(kind in (ca.OP_DIV, ca.OP_INV) for kind in divisions) == 3
    at = np.array([0.3, -1.2, 2.5, 0.7, 1.9]), np.array([1.7, -0.6])
    for found, expected in zip(after(*at), before(*at), strict=True):
        assert np.array(found) == pytest.approx(np.array(expected), rel=1e-15)
    assert (after.name(), after.name_in(), after.name_out()) == ("f", before.name_in(), before.name_out())
    a = ca.SX.sym("a")
    assert (a * (1 / y[0]) - a / y[0]).is_zero()  # simplification is on again
