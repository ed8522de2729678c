"""The receding horizon around a solver that answers as asked: warm start, bounds, fallback, record, observer."""

import numpy as np
import pytest

from railrepro.control.mpc import NMPC
from railrepro.control.problem import MPCSettings
from railrepro.control.solvers import ipopt
from railrepro.model.control_model import STATES
from railrepro.simulation import scenarios
from railrepro.vehicle.parameters import load_vehicle

STEPS = 4
SPEED = 50.0
EXPECTED_Y = 1e-3
PLAN = np.array([10.0, 20.0, 30.0, 40.0])
YAW = STATES.index("psi_TrAx")


@pytest.fixture
def controller(monkeypatch):
    """Controllers whose solver gives the last `answer` of the controller and remembers in `starts` where it started."""

    def build(answer=PLAN, **settings):
        route = scenarios.load_scenario("curve_entry_T3").route()
        guided = NMPC(load_vehicle(), route, 0, MPCSettings(steps=STEPS, **settings), solver="ipopt")
        guided.answer, guided.starts = answer, []

        def solve(function, horizon, parameters, du):
            guided.starts.append(du.copy())
            if isinstance(guided.answer, Exception):
                raise guided.answer
            horizon.x[1] = measured(y_TrAx=EXPECTED_Y)
            return np.array(guided.answer, dtype=float), 3

        monkeypatch.setattr(ipopt, "solve", solve)
        return guided

    return build


def measured(**values):
    state = dict.fromkeys(STATES, 0.0) | {"x": 100.0, "xdot": SPEED} | values
    return np.array([state[name] for name in STATES])


def test_the_first_torque_of_the_plan_is_applied_and_the_rest_starts_the_next_solve(controller):
    guided = controller()
    assert guided.plan(measured(), 0.0) == 10.0
    guided.plan(measured(), 0.0)
    assert guided.starts[0] == pytest.approx(np.zeros(4))
    assert guided.starts[1] == pytest.approx([20, 30, 40, 40])
    first = guided.stats[0]
    assert (first.iterations, first.fallback) == (3, False)
    assert 0 < first.seconds < 60


@pytest.mark.parametrize("failure", [[1, np.nan, 1, 1], [np.inf, 0, 0, 0], ArithmeticError("no")])
def test_a_solve_that_fails_is_replaced_by_the_plan_before_one_sample_later(controller, failure):
    guided = controller()
    guided.plan(measured(), 0.0)
    guided.answer = failure
    assert [guided.plan(measured(), 0.0) for _ in range(4)] == [20, 30, 40, 40]
    assert [solve.fallback for solve in guided.stats] == [False, True, True, True, True]
    assert guided.stats[1].iterations == (0 if isinstance(failure, Exception) else 3)
    guided.answer = PLAN
    assert guided.plan(measured(), 0.0) == 10.0


def test_an_error_of_another_kind_is_not_hidden(controller):
    with pytest.raises(KeyError):
        controller(KeyError("typing mistake")).plan(measured(), 0.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_torques_and_starts_stay_within_the_bound_of_the_sample(controller, sign):
    guided = controller(sign * np.array([5000.0, 4500.0, 3000.0, 100.0]), yielding=False)
    assert guided.plan(measured(), 0.0) == sign * 4000
    guided.plan(measured(), -sign * 2500.0)
    assert guided.starts[1] == pytest.approx(sign * np.array([1500, 1500, 100, 100]))
    assert guided.plan_du == pytest.approx(sign * np.array([1500, 1500, 1500, 100]))
    guided.answer = np.full(STEPS, np.nan)
    assert guided.plan(measured(), sign * 3999.0) == sign * 1.0


@pytest.mark.parametrize(("informed", "known"), [(True, -1200.0), (False, 0.0)])
def test_forecast_and_model_know_the_base_torque_unless_it_is_kept_from_them(controller, informed, known):
    guided = controller(informed=informed)
    guided.plan(measured(), -1200.0)
    assert guided.horizon.c.u_d == guided.problem(measured(), -1200.0).u_d == known
    speeds = guided.horizon.x_d[:, STATES.index("xdot")]
    assert (speeds[-1] < SPEED) == (known < 0)


def test_a_problem_stays_as_it_came(controller):
    guided = controller()
    states = [measured(y_TrAx=y, x=100.0 + 1e5 * y) for y in (1e-3, 2e-3)]
    problems = [guided.problem(x, 0.0) for x in states]
    for problem, x in zip(problems, states, strict=True):
        assert problem.x_hat == pytest.approx(x)
        assert problem.ahead.x_d[0, 0] == pytest.approx(x[0])
        assert (problem.tau_max, problem.settings) == (4000.0, guided.settings)
        assert problem.parameters == pytest.approx(guided.parameters)
    assert problems[0].ahead.theta[0] != pytest.approx(problems[1].ahead.theta[0])


@pytest.fixture
def observing(controller):
    """Controllers that have planned once and expect y to be `EXPECTED_Y` now."""

    def build(gain):
        guided = controller(observer=gain)
        guided.plan(measured(), 0.0)
        return guided

    return build


def observed_yaw(guided, y, **values):
    """Yaw angle that the controller believes at a measured y."""
    guided.plan(measured(y_TrAx=y, **values), 0.0)
    return guided.horizon.x_hat[YAW]


def test_the_observer_takes_its_share_of_the_angle_that_explains_the_prediction_error(observing):
    """0.2 mm in 10 ms at 50 m/s are 0.4 mrad; a tenth of it is learnt per sample, and it adds up."""
    guided = observing(0.1)
    assert observed_yaw(guided, 1.2e-3) == pytest.approx(4e-5)
    assert observed_yaw(guided, 1.2e-3, psi_TrAx=1e-3) == pytest.approx(1e-3 + 8e-5)
    state = measured(y_TrAx=EXPECTED_Y, psi_Ax=0.2)
    guided.plan(state, 0.0)
    assert guided.horizon.x_hat == pytest.approx(measured(y_TrAx=EXPECTED_Y, psi_Ax=0.2, psi_TrAx=8e-5))
    assert state[YAW] == 0.0 and guided.offset == pytest.approx(8e-5)
    assert observed_yaw(guided, 0.8e-3) == pytest.approx(4e-5)


def test_the_observer_rests_before_the_first_plan_after_a_failure_at_walking_pace_and_without_gain(
    controller, observing
):
    assert observed_yaw(controller(observer=0.1), 2e-3) == 0.0
    assert observed_yaw(observing(0.1), 2e-3, xdot=0.99) == 0.0
    assert observed_yaw(observing(0.1), 2e-3, xdot=1.2) == pytest.approx(0.1 * 1e-3 / (1.2 * 0.01))
    assert observed_yaw(observing(0.0), 2e-3) == 0.0
    guided = observing(0.1)
    guided.answer = np.full(STEPS, np.nan)
    guided.plan(measured(y_TrAx=EXPECTED_Y), 0.0)
    assert observed_yaw(guided, 2e-3) == 0.0
