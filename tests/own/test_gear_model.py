"""Lateral model with creep: poles against the car, steady creep by hand, the control model as its limit."""

import casadi as ca
import numpy as np
import pytest

from railrepro.car.component import SteppedCar
from railrepro.model import control_model as rolling
from railrepro.own import gear_model
from railrepro.own.gear_model import KNOWN, STATES, lateral_model
from railrepro.vehicle.parameters import load_vehicle

V = load_vehicle(**{"contact.profile": "cone"})
S1002 = load_vehicle()
_LATERAL = ("y", "psi", "phi", "vy", "wx", "wz")


def car_poles(speed, vehicle=V):
    """Poles (rad/s) of the antisymmetric motion of the car in steady rolling."""
    car = SteppedCar("T5", speed, vehicle, good="dry")
    car.step(steps=1000)
    unit = dict(zip(car.model.states, np.eye(len(car.model.states)), strict=True))
    rows = [unit[name] for name in unit if name.rpartition(".")[2] in _LATERAL]
    wheels = ("w.front", "w.rear", "tau.front", "tau.rear")
    basis = np.array(rows + [(unit[f"{name}_le"] - unit[f"{name}_ri"]) / np.sqrt(2) for name in wheels])
    return np.linalg.eigvals(basis @ car.linearise().a.to_numpy() @ basis.T)


def model_poles(speed, vehicle=V):
    """Fast poles (rad/s), and the slow real one with which the gear drifts against a body that stays on the track."""
    poles = np.linalg.eigvals(lateral_model(vehicle, speed)[0])
    slow = (np.abs(poles) < 5) & (poles.imag == 0)
    [drift] = poles[slow].real
    return poles[~slow], drift


@pytest.mark.parametrize(("vehicle", "tolerance", "sign"), [(V, 0.02, -1), (S1002, 0.035, 1)])
@pytest.mark.parametrize("speed_kmh", [100, 280, 400])
def test_poles_are_those_of_the_car(monkeypatch, vehicle, tolerance, sign, speed_kmh):
    """With the profile's slopes at its centre, as in the linearised car; S1002 wheels diverge, cones do not."""
    monkeypatch.setattr(gear_model, "_REACH", 1e-4)
    poles, drift = model_poles(speed_kmh / 3.6, vehicle)
    distance = np.abs(car_poles(speed_kmh / 3.6, vehicle) / poles[:, None] - 1).min(axis=1)  # to the nearest
    assert len(poles) == len(STATES) - 1 and distance.max() < tolerance and np.sign(drift) == sign


def test_steady_creep_carries_the_unbalanced_force():
    """The gear is held at the centre of an arc; the torque that this needs is the unknown in place of y."""
    a, b, e, _ = lateral_model(V, 77.8)
    unknown = np.column_stack([np.delete(a, STATES.index("y"), 1), b])
    psi = np.linalg.solve(unknown, -e[:, KNOWN.index("side")])[STATES.index("psi") - 1]
    middle, _, steepening, _ = gear_model._profile(V)
    stiffness = -gear_model._creep(V, middle, steepening)[1][0, 1]
    assert psi == pytest.approx(-(V.body.mass / 2 + V.gear.mass) / stiffness, rel=0.01)


@pytest.mark.parametrize(("cone_angle", "tolerance"), [(1e-5, 2e-3), (0.025, 0.03)])
def test_stiff_creep_is_the_control_model(monkeypatch, cone_angle, tolerance):
    """Displacement after torque, cant, body and curvature; on a cone the hub's roll moves the contact by 1.6 %."""
    vehicle, speed = load_vehicle(**{"contact.profile": "cone", "wheel.cone_angle": cone_angle}), 50.0
    rolls_only = np.array([[0.0, -2e13, 0.0], [0.0, 0.0, 0.0]])
    monkeypatch.setattr(gear_model, "_creep", lambda *given: (1e13, rolls_only))
    own_a, own_b, own_e, _ = lateral_model(vehicle, speed)
    x, u, theta = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("theta", len(rolling.THETA))
    rate = rolling.control_model()(x, u, theta, rolling.parameter_vector(vehicle))
    jacobians = ca.Function("j", [x, u, theta], [ca.jacobian(rate, v) for v in (x, u, theta)])
    at = np.zeros(6), np.zeros(2), np.zeros(len(rolling.THETA))
    at[0][rolling.XDOT], at[2][rolling.M_CB] = speed, vehicle.body.mass
    by_x, by_u, by_theta = (np.array(m) for m in jacobians(*at))
    keep = [rolling.PSI_AX, rolling.PSIDOT_AX, rolling.Y, rolling.PSI_TRAX]
    a = by_x[np.ix_(keep, keep)]
    side, turning, rolls, heading, slewing, *_ = own_e.T
    inputs = {
        "du": (own_b, by_u[keep, rolling.TAU_LE] - by_u[keep, rolling.TAU_RI]),
        "cant": (speed * rolls, by_theta[keep, rolling.DPHI_DP]),
        "body": (heading, -by_theta[keep, rolling.PSI_CB]),
    }
    for frequency in (1.0, 5.0, 20.0):
        s = 1j * frequency
        turned = speed * (s * turning + slewing + heading / s - speed * side)
        inputs["curvature"] = turned, by_theta[keep, rolling.DPSI_DP]
        for name, (ours, theirs) in inputs.items():
            lag = 1 / (1 + s * vehicle.drive.lag) if name == "du" else 1
            expected = lag * np.linalg.solve(s * np.eye(len(a)) - a, theirs)[2]
            found = np.linalg.solve(s * np.eye(len(own_a)) - own_a, ours)[STATES.index("y")]
            assert abs(found / expected - 1) < tolerance, (name, frequency)


def test_rails_that_move_take_the_gear_along():
    """On rails that lie off centre, or move sideways, only the springs to the car body act on the gear."""
    speed, stage, gear = 60.0, S1002.suspension, S1002.gear
    a, _, e, _ = lateral_model(S1002, speed)
    springs = {"y": 1.0, "vy": -2 * stage.c_y / gear.mass, "r": -stage.yaw_stiffness / speed / gear.inertia_z}
    for rails, motion, expected in (
        ("rail_offset", {"y": 1.0}, {"vy": -2 * stage.k_y / gear.mass}),
        ("rail_rate", {"vy": 1.0, "psi": 1 / speed}, springs),
    ):
        known = e[:, KNOWN.index(rails)]
        found = a @ [motion.get(name, 0.0) for name in STATES] + known
        np.testing.assert_allclose(found, [expected.get(n, 0.0) for n in STATES], atol=1e-9 * np.abs(known).max())
