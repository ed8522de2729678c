"""The optimal control problem as it is stated: its cost is the printed one, and so is the bound of its torque."""

from dataclasses import replace

import numpy as np
import pytest

from railrepro.control.mpc import NMPC
from railrepro.control.problem import MPCSettings
from railrepro.simulation import scenarios
from railrepro.vehicle.parameters import load_vehicle

Q = (2e-3, 3e2, 5e-3, 7e1, 1.0, 1.1e2)
SETTINGS = MPCSettings(Q, r=3e-11, q_terminal=4.0, steps=12, lateral_bound=5e-4, bound_weight=30.0)
"""Every weight counts and the lateral bound is exceeded, so that no change of one of them goes unnoticed."""


@pytest.mark.parametrize("side", [1, -1])
def test_cost_is_the_printed_one_on_either_side_of_the_lateral_bound(side):
    controller = NMPC(load_vehicle(), scenarios.load_scenario("curve_entry_T3").route(), 0, SETTINGS)
    problem = controller.problem(np.array([60.0, 2e-4, 77.0, 0.01, side * 2e-3, 3e-4]), 500.0)
    du = np.random.default_rng(5).normal(0, 300, SETTINGS.steps)
    states, period = problem.roll_out(du), SETTINGS.period
    error, over = states - problem.ahead.x_d, np.maximum(np.abs(states[1:, 4]) - SETTINGS.lateral_bound, 0.0)
    terminal = np.array([0.0, 0.0, 0.0, 0.0, SETTINGS.q_terminal, SETTINGS.q_terminal])
    expected = period * sum(e @ np.diag(Q) @ e for e in error[1:-1]) + period * SETTINGS.r * du @ du
    expected += period * error[-1] @ (np.diag(Q) * terminal) @ error[-1]
    expected += period * SETTINGS.bound_weight * Q[4] * over @ over
    assert (side * states[1:, 4] > SETTINGS.lateral_bound).any()
    assert problem.cost(states, du) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("yielding", "u_d", "bound"),
    [(True, 3900.0, 4000.0), (False, 1500.0, 2500.0), (False, -1500.0, 2500.0), (False, 4500.0, 0.0)],
)
def test_base_torque_leaves_the_printed_bound_what_is_left(yielding, u_d, bound):
    assert replace(SETTINGS, yielding=yielding).torque_bound(u_d, 4000.0) == bound
