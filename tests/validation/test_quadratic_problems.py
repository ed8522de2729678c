"""The stored quadratic problems are those of the controllers, and their stored optimum is optimal."""

import numpy as np
import pytest
import quadratic_problems as problems
from quadratic_problems import CASES, UNIT


@pytest.mark.parametrize("name", CASES)
def test_a_stored_problem_is_that_of_its_controller_and_an_independent_solver_finds_its_optimum(name):
    """The stored optimum is from the recursion; DAQP solves a dense problem without states. 1e-4 N m is the tolerance
    of the controllers, 1e-9 is left for other processors."""
    stored, today = problems.read(name), problems.posed(name)
    assert stored.keys() == today.keys()
    for key, values in stored.items():
        assert values.dtype == today[key].dtype and values == pytest.approx(today[key], rel=1e-9, abs=1e-9), key
    cost, rows = problems.matrices(stored)
    assert (rows @ stored["x"] > stored["l"] - 1e-9).all() and (rows @ stored["x"] < stored["u"] + 1e-9).all()
    torque, objective = problems.apart(name, stored, problems.daqp(stored)())
    assert torque < 1e-4 and objective < 1e-9


def test_bounds_act_where_a_name_says_so():
    for name, case in CASES.items():
        torques, slacks = np.split(problems.read(name)["x"][-2 * case.steps :], 2)
        at_bound = np.isclose(np.abs(torques), case.torque_limit / UNIT, rtol=1e-9)
        assert np.abs(torques).max() > 0 and at_bound.any() == (slacks > 0).any() == name.endswith("bounds")
        assert not at_bound.all() and case.steps in (10, 30, 60)
