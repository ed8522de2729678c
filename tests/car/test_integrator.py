"""Rodas3 by itself: linear algebra, order, damping of stiff parts, error estimate, chain rule over held stages."""

import casadi as ca
import numpy as np
import pytest

from railrepro.car.integrator import factorise, rodas3


def solver(matrix):
    """The unrolled factorisation of a matrix with its zeros left out, as a function of its entries and a vector."""
    sparsity = ca.DM(matrix).sparsity() if (matrix != 0).all() else ca.sparsify(ca.DM(matrix)).sparsity()
    entries, b = ca.SX.sym("m", sparsity), ca.SX.sym("b", len(matrix))
    return ca.Function("solve", [entries, b], [factorise(entries)(b)])


@pytest.mark.parametrize("density", [0.15, 0.4, 1.0])
def test_factorisation_solves_sparse_systems(density):
    generator = np.random.default_rng(2)
    n = 12
    matrix = generator.normal(0, 1, (n, n)) * (generator.uniform(size=(n, n)) < density) + 5 * n * np.eye(n) / 4
    b = generator.normal(0, 1, n)
    found = np.array(solver(matrix)(ca.sparsify(ca.DM(matrix)), b)).ravel()
    assert found == pytest.approx(np.linalg.solve(matrix, b), rel=1e-12, abs=1e-14)


def stepped(rate, x, parameters=()):
    """One step of a rate given as an expression of the symbol x, as a numeric function of state, parameters and h."""
    h = ca.SX.sym("h")
    x_next, error = rodas3(rate, ca.jacobian(rate, x), x, h)
    return ca.Function("step", [x, ca.vertcat(*parameters), h], [x_next, error])


def pendulum():
    x, gain = ca.SX.sym("x", 2), ca.SX.sym("gain")
    rate = ca.vertcat(x[1], -gain * ca.sin(x[0]) - 0.3 * x[1] ** 2 + x[0] * x[1])
    return stepped(rate, x, (gain,))


def ends(step, n, start=(1.2, 0.5), span=1.0):
    x = np.array(start)
    for _ in range(n):
        x = np.array(step(x, 3.0, span / n)[0]).ravel()
    return x


def test_order_three_and_error_estimate_of_order_two():
    step = pendulum()
    exact = ends(step, 4000)
    errors = [np.abs(ends(step, n) - exact).max() for n in (20, 40, 80)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([3, 3], abs=0.25)
    estimates = [np.abs(np.array(step([1.2, 0.5], 3.0, h)[1])).max() for h in (0.02, 0.01, 0.005)]
    assert np.log2(np.array(estimates[:-1]) / estimates[1:]) == pytest.approx([3, 3], abs=0.25)
    local = np.abs(np.array(step([1.2, 0.5], 3.0, 0.01)[0]).ravel() - ends(step, 100, span=0.01)).max()
    assert 0 < local < estimates[1]


@pytest.mark.parametrize("z", [-0.3, -2.0, -20.0, -1e9, 1.0])
def test_stability_function_is_that_of_rodas3(z):
    """R(z) = P(z) / (1 - z/2)^4 with a P of degree three, since R(infinity) = 0, that makes R - exp of order z^4."""
    x = ca.SX.sym("x")
    step = stepped(z * x, x)
    g = 0.5
    numerator = np.zeros(4)
    denominator = np.array([1.0, -4 * g, 6 * g**2, -4 * g**3, g**4])
    exponential = 1 / np.array([1.0, 1, 2, 6])
    for k in range(4):
        numerator[k] = sum(denominator[j] * exponential[k - j] for j in range(k + 1))
    expected = np.polyval(numerator[::-1], z) / np.polyval(denominator[::-1], z)
    assert float(step(1.0, [], 1.0)[0]) == pytest.approx(expected, rel=1e-12, abs=1e-16)
