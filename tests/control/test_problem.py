"""The optimal control problem is stated once: cost, condensed form, recursion and nonlinear program agree on it."""

from dataclasses import replace

import casadi as ca
import condensed
import numpy as np
import pytest

from railrepro.control.mpc import NMPC
from railrepro.control.problem import MPCSettings
from railrepro.control.solvers import ipopt
from railrepro.model.control_model import STATES
from railrepro.simulation import scenarios
from railrepro.vehicle.parameters import load_vehicle

Q = (2e-3, 3e2, 5e-3, 7e1, 1.0, 1.1e2)
SETTINGS = MPCSettings(Q, r=3e-11, q_terminal=4.0, steps=12, lateral_bound=5e-4, bound_weight=30.0)
"""Every weight counts and the lateral bound is exceeded, so that no change of one of them goes unnoticed."""


@pytest.fixture(scope="module")
def case():
    """A linearised horizon about random torques, and its problem."""
    vehicle, generator = load_vehicle(), np.random.default_rng(5)
    controller = NMPC(vehicle, scenarios.load_scenario("curve_entry_T3").route(), 0, SETTINGS)
    problem = controller.problem(np.array([60.0, 2e-4, 77.0, 0.01, 2e-3, 3e-4]), 500.0)
    horizon = controller.horizon
    horizon.u[:] = generator.normal(0, 300, SETTINGS.steps)
    horizon.x[:] = problem.roll_out(horizon.u) + generator.normal(0, 1e-5, horizon.x.shape)
    horizon.linearise()
    return problem, controller, generator


def test_cost_is_the_printed_one(case):
    problem, controller, _ = case
    states, du = controller.horizon.x, controller.horizon.u
    error, period = states - problem.ahead.x_d, SETTINGS.period
    terminal = np.array([0.0, 0.0, 0.0, 0.0, SETTINGS.q_terminal, SETTINGS.q_terminal])
    expected = period * sum(e @ np.diag(Q) @ e for e in error[1:-1]) + period * SETTINGS.r * du @ du
    expected += period * error[-1] @ (np.diag(Q) * terminal) @ error[-1]
    over = np.maximum(np.abs(states[1:, 4]) - SETTINGS.lateral_bound, 0.0)
    expected += period * SETTINGS.bound_weight * Q[4] * over @ over
    assert (over > 0).any()
    assert problem.cost(states, du) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("side", [1, -1])
def test_beyond_either_side_of_the_bound_the_cost_counts_the_excess(case, side):
    """0.3 mm beyond in one state: T w Q_y (0.3 mm)^2 more than for the same error within a wide bound."""
    states, du = case[0].ahead.x_d.copy(), np.zeros(SETTINGS.steps)
    states[:, STATES.index("y_TrAx")] = 0.0
    states[3, STATES.index("y_TrAx")] = side * 8e-4
    within = replace(case[0], settings=replace(SETTINGS, lateral_bound=1.0))
    more = case[0].cost(states, du) - within.cost(states, du)
    assert more == pytest.approx(SETTINGS.period * 30.0 * (3e-4) ** 2, rel=1e-9)


def test_condensed_form_is_the_stated_cost_of_the_linearised_trajectory(case):
    problem, controller, generator = case
    horizon, qp = controller.horizon, condensed.condense(controller.horizon)

    def both(steps):
        states = horizon.x.copy()
        states[1:] += qp.sensitivity @ steps + qp.drift
        over = np.maximum(np.abs(qp.y_free + qp.sensitivity[:, 4, :] @ steps) - qp.y_bound, 0.0)
        short = 0.5 * steps @ qp.hessian @ steps + qp.gradient @ steps + 0.5 * qp.soft * over @ over
        stated = problem.cost(states, horizon.u + ipopt.UNIT * steps)
        return np.array([short, ipopt.COST / 2 * stated])

    reference = both(np.zeros(SETTINGS.steps))
    for _ in range(3):
        short, stated = both(generator.normal(0, 0.2, SETTINGS.steps)) - reference
        assert short == pytest.approx(stated, rel=1e-9)


def test_nonlinear_program_has_the_stated_cost_bound_and_dynamics(case):
    problem, controller, generator = case
    s, steps = SETTINGS, SETTINGS.steps
    program = ipopt.program(s.variant, s.discretisation, steps)
    parts = [ca.vec(ca.DM(problem.ahead.x_d.T)), ca.vec(ca.DM(problem.ahead.theta[:-1].T)), problem.parameters]
    evaluate = ca.Function("nlp", [program["x"], program["p"]], [program["f"], program["g"]])
    du = generator.normal(0, 300, steps)
    states = problem.roll_out(du)
    over = np.maximum(np.abs(states[1:, 4]) - s.lateral_bound, 0.0)
    deviation = ((states - problem.ahead.x_d) / ipopt.SCALE).T
    x = ca.vertcat(ca.vec(ca.DM(deviation)), du / ipopt.UNIT, over / ipopt.SLACK)
    f, g = evaluate(x, ca.vertcat(*parts, s.tuning(), problem.u_d))
    assert float(f) == pytest.approx(ipopt.COST * problem.cost(states, du), rel=1e-9)
    defects, sides = np.split(np.array(g).ravel(), [states[1:].size])
    assert np.abs(defects).max() < 1e-9
    assert sides.max() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("yielding", "u_d", "bound"),
    [(True, 3900.0, 4000.0), (False, 0.0, 4000.0), (False, 1500.0, 2500.0), (False, -1500.0, 2500.0),
     (False, -4000.0, 0.0), (False, 4500.0, 0.0)],
)  # fmt: skip
def test_base_torque_leaves_the_printed_bound_what_is_left(case, yielding, u_d, bound):
    settings = replace(SETTINGS, yielding=yielding)
    assert replace(case[0], settings=settings, u_d=u_d).bound == settings.torque_bound(u_d, 4000.0) == bound
