"""Twins side by side give the bits of one after the other, and the car is nearly all twins."""

import re

import casadi as ca
import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.compile import codegen
from railrepro.compile.pairs import pairs_text


def both(function, mirrored):
    """The function as CasADi writes it, and by twins; text of the latter."""
    text = pairs_text(function, mirrored)
    library = codegen.library((), "#define casadi_int long long\n" + codegen.lanes_header(2) + text)
    return codegen.compiled(function), codegen.CompiledFunction(library, function), text


def test_twins_have_the_bits_of_single_operations():
    """Two gears on a body: functions of each, sums over both, an end of the car by its sign, a part without twin."""
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p", 2)
    body, gears, seats = x[:2], (x[2:4], x[4:]), (ca.SX(0.5), ca.SX(-0.5))
    forces = [
        ca.sin(gear[0] - seat * p[0]) * ca.exp(gear[1]) + ca.if_else(gear[0] < body[0], ca.sqrt(gear[1]), body[1] ** 2)
        for gear, seat in zip(gears, seats, strict=True)
    ]
    rates = [*forces, forces[0] + forces[1], forces[0] - forces[1], ca.cos(body[0]) / p[1], gears[0][0] * gears[1][1]]
    rates += [gears[0][0] - gears[0][1], gears[1][1] - gears[1][0]]  # no twins, a difference has its order
    function = ca.Function("gears", [x, p], [ca.vertcat(*rates), forces[1]], ["x", "p"], ["rates", "rear"])
    single, twins, text = both(function, {"x": [0, 1, 4, 5, 2, 3]})
    assert len(re.findall(r"lanes_exp\(", text)) == 1 and "own_exp(" not in text
    for values in np.random.default_rng(0).uniform(0.1, 1.5, (50, 8)):
        for bound in (single, twins):
            bound.arguments[0][:], bound.arguments[1][:] = values[:6], values[6:]
        np.testing.assert_array_equal(np.concatenate(twins()), np.concatenate(single()))
    assert pairs_text(function, {}).count("lanes_t") == 0


def test_an_operation_that_is_not_translated_is_refused():
    x = ca.SX.sym("x", 2)
    with pytest.raises(ValueError, match="is not translated to lanes"):
        pairs_text(ca.Function("f", [x], [ca.erf(x)], ["x"], ["y"]), {"x": [1, 0]})


@pytest.mark.parametrize("name", ["coordinates", "output", "step"])
def test_the_car_has_the_bits_of_single_operations(name):
    car = SteppedCar("T3", 70.0)
    car.step([900.0, -300.0, 500.0, 100.0], steps=400)
    car.measure()
    twins, function = car.functions[name], getattr(car.model, name)
    found = [result.copy() for result in twins()]
    single = codegen.compiled(function)
    for argument, value in zip(single.arguments, twins.arguments, strict=True):
        argument[:] = value
    for one, other in zip(found, single(), strict=True):
        np.testing.assert_array_equal(one, other)
    text = pairs_text(function, equations.mirrored())
    assert text.count("const lanes_t") > 3 * text.count("const double t")
