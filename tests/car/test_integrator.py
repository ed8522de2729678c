"""The integrator Rodas3: linear algebra, order, damping of stiff parts."""

import casadi as ca
import numpy as np
import pytest

from railrepro.car.integrator import factorise, rodas3


@pytest.mark.parametrize("density", [0.15, 1.0])
def test_factorisation_solves_sparse_systems(density):
    generator, n = np.random.default_rng(2), 12
    matrix = generator.normal(0, 1, (n, n)) * (generator.uniform(size=(n, n)) < density) + 5 * n * np.eye(n) / 4
    b = generator.normal(0, 1, n)
    sparse = ca.sparsify(ca.DM(matrix))
    entries, vector = ca.SX.sym("m", sparse.sparsity()), ca.SX.sym("b", n)
    found = ca.Function("solve", [entries, vector], [factorise(entries)(vector)])(sparse, b).nonzeros()
    assert found == pytest.approx(np.linalg.solve(matrix, b), rel=1e-12, abs=1e-14)


def stepped(rate, x, parameters=()):
    """One step of x' = rate, an expression in x, as a function of state, parameters and step h."""
    h = ca.SX.sym("h")
    return ca.Function("step", [x, ca.vertcat(*parameters), h], [rodas3(rate, ca.jacobian(rate, x), x, h)])


def test_the_order_is_three():
    x, gain = ca.SX.sym("x", 2), ca.SX.sym("gain")
    pendulum = ca.vertcat(x[1], -gain * ca.sin(x[0]) - 0.3 * x[1] ** 2 + x[0] * x[1])
    step, ends = stepped(pendulum, x, (gain,)), {}
    for n in (20, 40, 80, 4000):
        ends[n] = np.array(step.mapaccum(n)([1.2, 0.5], ca.repmat(3.0, 1, n), ca.repmat(1 / n, 1, n)))[:, -1]
    errors = np.array([np.abs(ends[n] - ends[4000]).max() for n in (20, 40, 80)])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([3, 3], abs=0.25)


@pytest.mark.parametrize("z", [-0.3, -2.0, -20.0, -1e9, 1.0])
def test_stability_function_is_that_of_rodas3(z):
    """R(z) is the fraction with this denominator and R(infinity) = 0 that differs from exp(z) by O(z^4)."""
    x = ca.SX.sym("x")
    expected = (1 - z + z**3 / 6) / (1 - z / 2) ** 4
    assert float(stepped(z * x, x)(1.0, [], 1.0)) == pytest.approx(expected, rel=1e-12, abs=1e-16)
