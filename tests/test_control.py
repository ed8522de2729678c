"""The optimum of the fast solver is that of Ipopt, at small and at large states, with and without active bounds."""

import numpy as np
import pytest

from railrepro.control.mpc import NMPC
from railrepro.control.problem import MPCSettings
from railrepro.simulation import scenarios
from railrepro.vehicle.parameters import load_vehicle

LIMIT = 4000.0


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


def recorded_problems(vehicle, name="curve_entry_T3", count=12, u_d=0.0, scale=1.0):
    """Problems at random states along a scenario."""
    route = scenarios.load_scenario(name).route()
    controller = NMPC(vehicle, route, 0, MPCSettings())
    generator, speed = np.random.default_rng(7), scenarios.load_scenario(name).speed
    problems = []
    for p in np.linspace(10, 500, count):
        psi, kappa = route.track_at(p)[:2, 0]
        psi_r = generator.normal(0, 2e-4) * scale
        y = generator.normal(0, 2e-3) * scale
        problems.append(controller.problem(np.array([p, psi + psi_r, speed, kappa * speed, y, psi_r]), u_d))
    return route, problems


def planned(controller, problem):
    """Torques that a controller plans at the state and base torque of a problem."""
    controller.plan(problem.x_hat, problem.u_d)
    assert not controller.stats[-1].fallback
    return controller.plan_du.copy()


@pytest.mark.parametrize(("u_d", "scale"), [(0.0, 1.0), (-3950.0, 4.0), (3990.0, 6.0)])
def test_fast_path_finds_the_optimum_of_ipopt(vehicle, u_d, scale):
    route, problems = recorded_problems(vehicle, count=4, u_d=u_d, scale=scale)
    active = []
    for problem in problems:
        fast, reference = (NMPC(vehicle, route, 0, MPCSettings(), solver=s) for s in ("gauss_newton", "ipopt"))
        ours, exact = planned(fast, problem), planned(reference, problem)
        assert np.abs(ours - exact).max() < 1e-4 * LIMIT
        assert problem.cost(problem.roll_out(ours), ours) == pytest.approx(
            problem.cost(problem.roll_out(exact), exact), rel=1e-6
        )
        assert np.abs(ours).max() <= problem.bound + 1e-9
        active.append(np.abs(ours).max() > 0.999 * problem.bound)
    assert any(active) == (u_d != 0.0)
