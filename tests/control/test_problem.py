"""The optimal control problem as it is stated: its costs are the printed ones, and so is the bound of its torque."""

from dataclasses import replace

import numpy as np
import pytest

from railrepro.control import problem
from railrepro.control.problem import MPCSettings, Problem, Tuning

Q = (2e-3, 3e2, 5e-3, 7e1, 1.0, 1.1e2)
SETTINGS = MPCSettings(Q, r=3e-11, q_terminal=4.0, steps=12, lateral_bound=5e-4, bound_weight=30.0)


@pytest.mark.parametrize("side", [1, -1])
def test_costs_are_the_printed_ones_on_either_side_of_the_lateral_bound(side):
    t, period = Tuning.of(SETTINGS.tuning()), SETTINGS.period
    x, x_d = np.random.default_rng(5).normal(0, 1e-2, (2, 6))
    x[4] = side * 2e-3
    over, error, last = 2e-3 - SETTINGS.lateral_bound, x - x_d, np.array([0, 0, 0, 0, 4.0, 4.0])
    assert problem.slack_on(side, x, t) == max(problem.lateral_excess(x, t)) == pytest.approx(over)
    slack_cost = period * SETTINGS.bound_weight * Q[4] * over**2
    stage, terminal = (cost(x, x_d, over, t) for cost in (problem.stage_cost, problem.terminal_cost))
    assert float(stage) == pytest.approx(period * error @ np.diag(Q) @ error + slack_cost)
    assert float(terminal) == pytest.approx(period * error @ (np.diag(Q) * last) @ error + slack_cost)
    assert problem.effort_cost(300.0, t) == pytest.approx(period * SETTINGS.r * 300.0**2)


@pytest.mark.parametrize(
    ("yielding", "u_d", "bound"),
    [(True, 3900.0, 4000.0), (False, 1500.0, 2500.0), (False, -1500.0, 2500.0), (False, 4500.0, 0.0)],
)
def test_base_torque_leaves_the_printed_bound_what_is_left(yielding, u_d, bound):
    assert Problem(replace(SETTINGS, yielding=yielding), None, u_d, None, None, 4000.0).bound == bound
