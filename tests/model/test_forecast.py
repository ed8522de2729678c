"""What the predictive controllers think lies ahead: motion under a base torque, track of both gears, set point."""

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from railrepro.control.problem import MPCSettings
from railrepro.control.solvers.riccati import Horizon
from railrepro.model.control_model import STATES, THETA, parameter_vector
from railrepro.model.forecast import NOMINAL, nominal_values
from railrepro.track import route
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

PERIOD, STEPS = 0.02, 30
STRAIGHT = route.lay(load_track("T5"))
HALF_CAR = 13_000 + 3000 + 2 * 60 / 0.46**2  # kg, with the spin inertia of two wheels
V = load_vehicle()


def ahead(way, u_d=0.0, gear=0, **values):
    """Desired states and track parameters by name from a measured state."""
    state = dict.fromkeys(STATES, 0.0) | {"x": 100.0, "xdot": 40.0} | values
    horizon = Horizon(MPCSettings(period=PERIOD, steps=STEPS), nominal_values(V, gear), parameter_vector(V), way)
    found = horizon.forecast(np.array(list(state.values())), u_d)
    return dict(zip(STATES, found.x_d.T, strict=True)), dict(zip(THETA, found.theta.T, strict=True))


def test_nominal_values_by_hand():
    front, rear, printed = (dict(zip(NOMINAL, nominal_values(V, *how), strict=True)) for how in ((0,), (1,), (1, True)))
    assert front == pytest.approx({"acceleration_per_torque": 2 / 0.46 / HALF_CAR, "partner": -14.0, "m_CB": 26_000.0})
    assert rear == front | {"partner": 14.0}
    assert printed == pytest.approx(rear | {"acceleration_per_torque": -1 / 0.46 / 16_000})


STOP = 0.3 / (2 * 4000 / 0.46 / HALF_CAR)  # s, from 0.3 m/s by a base torque of -4000 N m


@pytest.mark.parametrize(
    ("u_d", "speed", "driven"),
    [(u_d, 40.0, np.inf) for u_d in (0.0, 1500.0, -1500.0)]
    + [(-4000.0, 0.3, STOP), (-4000.0, 0.0, 0.0), (-4000.0, -0.01, 0.0), (0.0, -0.01, np.inf)],
)
def test_a_base_torque_accelerates_uniformly_and_brakes_to_standstill_only(u_d, speed, driven):
    x_d, theta = ahead(STRAIGHT, u_d, xdot=speed)
    t, acceleration = np.minimum(PERIOD * np.arange(STEPS + 1), driven), 2 * u_d / 0.46 / HALF_CAR
    assert x_d["x"] == pytest.approx(100 + speed * t + acceleration * t**2 / 2, rel=1e-12)
    assert x_d["xdot"] == pytest.approx(speed + acceleration * t, rel=1e-12, abs=1e-12)
    assert theta["m_CB"] == pytest.approx(26_000.0) and PERIOD * 10 < STOP < PERIOD * 20


@pytest.mark.parametrize(("gear", "partner"), [(0, -14.0), (1, 14.0)])
def test_track_parameters_are_those_below_the_gear_and_half_way_to_the_other_one(gear, partner):
    """On the clothoid of T3 heading and curvature differ between the gears."""
    track = load_track("T3")
    x_d, theta = ahead(route.lay(track), gear=gear, xdot=77.0)
    here, there = (track.interpolate(x_d["x"] + offset) for offset in (0.0, partner))
    for name, expected in zip(THETA[:6], here, strict=True):
        assert theta[name] == pytest.approx(expected, abs=1e-12), name
    assert np.abs(here[0] - there[0]).min() > 1e-4
    assert theta["psi_CB"] == pytest.approx((here[0] + there[0]) / 2, abs=1e-12)
    assert theta["dpsi_dp_CB"] == pytest.approx((here[1] + there[1]) / 2, abs=1e-12)


def test_the_desired_state_follows_the_set_point_along_the_track():
    """y* over p: the gear points along its tangent and turns with its bend and the track's curvature, (des_states)."""
    shape = Polynomial([1e-3, 1e-5, -2e-8, 1e-11])
    track = load_track("T3")
    place = ca.SX.sym("p")
    laid = route.lay(track, ca.Function("y_ref", [place], [sum(c * place**k for k, c in enumerate(shape.coef))]))
    x_d, theta = ahead(laid, 2000.0, xdot=77.0)
    p, v = x_d["x"], x_d["xdot"]
    assert x_d["y_TrAx"] == pytest.approx(shape(p), rel=1e-9)
    assert x_d["psi_TrAx"] == pytest.approx(shape.deriv()(p), rel=1e-9, abs=1e-15)
    assert x_d["psi_Ax"] == pytest.approx(theta["psi_Tr"] + shape.deriv()(p), rel=1e-9)
    assert x_d["psidot_Ax"] == pytest.approx(v * (shape.deriv(2)(p) + theta["dpsi_dp"]), rel=1e-9)
    assert np.diff(v).min() > 0
