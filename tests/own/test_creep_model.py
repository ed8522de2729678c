"""Creep-aware lateral model: poles against the car, steady creep by hand, the control model as its stiff limit."""

import casadi as ca
import numpy as np
import pytest

from railrepro.car.component import SteppedCar
from railrepro.contact.table import contact_table
from railrepro.control.ndi import NDI
from railrepro.data import InputError
from railrepro.model import control_model as rolling
from railrepro.own import creep_model
from railrepro.own.creep_model import KNOWN, SHIFTS, STATES, Creep, creep_at, lateral_model, shifts
from railrepro.own.creep_mpc import CreepMPC
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

V = load_vehicle(**{"contact.profile": "cone"})
S1002 = load_vehicle()
_LATERAL = ("y", "psi", "phi", "vy", "wx", "wz")


def car_poles(speed, slip=0.0, adhesion="dry", vehicle=V):
    """Poles (rad/s) of the antisymmetric motion of the car in steady rolling, all wheels with a slip."""
    car = SteppedCar("T5", speed, vehicle, good=adhesion)
    car.step(steps=1000)
    names = list(car.model.states)
    wheels = [names.index(name) for name in names if name.startswith("w.")]
    car.state[wheels] *= 1 + slip
    rows = [np.eye(len(names))[i] for i, name in enumerate(names) if name.rpartition(".")[2] in _LATERAL]
    for kind in ("w", "tau"):
        for gear in ("front", "rear"):
            left, right = (names.index(f"{kind}.{gear}_{side}") for side in ("le", "ri"))
            rows.append((np.eye(len(names))[left] - np.eye(len(names))[right]) / np.sqrt(2))
    basis = np.array(rows)
    return np.linalg.eigvals(basis @ car.linearise().a.to_numpy() @ basis.T)


def model_poles(speed, creep, vehicle=V):
    poles = np.linalg.eigvals(lateral_model(vehicle, speed, creep).a)
    return poles[np.abs(poles) > 0.05]


def distance(found, expected):
    """Distance of each expected pole to the nearest found one, relative to its size."""
    return np.abs(found[None, :] / expected[:, None] - 1).min(axis=1)


@pytest.mark.parametrize("speed_kmh", [100, 280, 400])
def test_poles_are_those_of_the_car(speed_kmh):
    """Sway and yaw of the body differ in frequency; half a body knows the sway only."""
    speed = speed_kmh / 3.6
    poles = model_poles(speed, creep_at(V, "dry", speed))
    assert len(poles) == 9
    assert distance(car_poles(speed), poles).max() < 0.015


@pytest.mark.parametrize(("speed_kmh", "tolerance"), [(100, 0.06), (280, 0.015), (400, 0.012)])
@pytest.mark.parametrize(("rail", "slip"), [("dry", 0.0), ("poor", 0.0), ("poor", 0.01)])
def test_poles_on_s1002_are_those_of_the_car(monkeypatch, speed_kmh, tolerance, rail, slip):
    """With the profile's slopes in the middle, as the linearised car has them; the divergence in sign and size."""
    monkeypatch.setattr(creep_model, "REACH", 1e-4)
    speed = speed_kmh / 3.6
    poles, car = model_poles(speed, creep_at(S1002, rail, speed, slip), S1002), car_poles(speed, slip, rail, S1002)
    drifts = (np.abs(poles) < 5) & (poles.imag == 0)
    assert distance(car, poles[~drifts & (np.abs(poles) < 60)]).max() < (tolerance if slip == 0 else 0.12)
    if rail == "dry":
        [ours], theirs = poles[drifts].real, car[(np.abs(car) < 5) & (car.real > 0.3) & (car.imag == 0)].real
        assert ours > 0 and np.abs(ours / theirs - 1).min() < 0.5


@pytest.mark.parametrize("slip", [0.0104, 0.0121])
def test_used_adhesion_makes_the_gear_unstable_as_in_the_car(slip):
    speed = 400 / 3.6
    creep, car = creep_at(V, "poor", speed, slip), car_poles(speed, slip, "poor")
    poles = model_poles(speed, creep)
    unstable = poles[(poles.real > 0.5) & (poles.imag > 0)]
    assert len(unstable) == 1 and distance(car, unstable).max() < 0.03
    drifting = poles[(poles.real > 0.5) & (poles.imag == 0)]
    assert len(drifting) == 1 and distance(car, drifting).max() < 0.3  # the car has one of sway and one of yaw
    assert model_poles(speed, Creep(creep.along, creep.across, 0.0, creep.spin)).real.max() < 0


def steady_yaw(model, known, y):
    """Yaw angle (rad) of a gear that is held at a displacement (m); the torque that it takes is unknown instead."""
    place = STATES.index("y")
    forced = -model.e @ known - y * model.a[:, place]
    steady = np.linalg.solve(np.column_stack([np.delete(model.a, place, 1), model.b]), forced)
    return steady[STATES.index("psi") - 1]


def test_steady_creep_in_an_arc_is_that_of_the_car_and_of_the_hand_formula():
    scenario = load_scenario("curve_entry_T3").but(set_point={"kind": "none"})
    run = simulate.run(scenario, NDI(integral=0.05), vehicle=V)
    last = run.series.tail(500).mean()
    _, kappa, phi, *_ = load_track("T3").interpolate(np.array([last["front.p"]]))[:, 0]
    speed = last["front.v"]
    creep = creep_at(V, "dry", speed)
    side = (V.body.mass / 2 + V.gear.mass) * (speed**2 * kappa - V.gravity * phi)
    model = lateral_model(V, speed, creep)
    known = np.zeros(len(KNOWN))
    known[KNOWN.index("side")] = V.gravity * phi - speed**2 * kappa
    psi = steady_yaw(model, known, 0.0)
    shifted = (last["front_le.N"] - last["front_ri.N"]) / 2
    cone, spin = 2 * np.tan(V.wheel.cone_angle) * shifted, creep.spin.force[2] * shifted
    assert psi == pytest.approx((side - cone - spin) / (2 * creep.across), rel=0.01)
    assert 2 * creep.across * psi + spin == pytest.approx(last["front_le.Fy"] + last["front_ri.Fy"], rel=0.02)
    assert psi == pytest.approx(last["front.psi_TrAx"], rel=0.1)  # Polach's law softens by 7 % up to this creepage
    assert psi > 3e-4


class Aside:
    """Our controller, which takes a gear at a distance (m) from the middle of the track for one in the middle."""

    def __init__(self, distance, *on):
        self._law, self._distance = CreepMPC()(*on), distance
        self.period, self.stats, self.notice = self._law.period, self._law.stats, self._law.notice

    def plan(self, x_hat, u_d):
        seen = x_hat.copy()
        seen[rolling.Y] -= self._distance
        return self._law.plan(seen, u_d)


@pytest.mark.parametrize(("distance", "missed"), [(2e-3, 0.1), (3e-3, 0.25), (-3e-3, 0.25)])
def test_a_gear_that_is_held_aside_of_the_track_yaws_as_the_car_does(distance, missed):
    """The creep angle that carries the weight on inclined contacts; secants alone miss it by a tenth to a third."""
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, end_m=600.0)
    last = simulate.run(scenario, lambda *on: Aside(distance, *on), vehicle=S1002).series.tail(300).mean()
    assert last["front.y"] == pytest.approx(distance, rel=1e-3)
    model = lateral_model(S1002, last["front.v"], creep_at(S1002, "dry", last["front.v"]))
    errors = []
    for bend in (shifts(S1002)(np.array(distance)), np.zeros(3)):
        known = np.zeros(len(KNOWN))
        known[SHIFTS] = bend
        errors.append(abs(steady_yaw(model, known, distance) / last["front.psi_TrAx"] - 1))
    assert errors[0] < 0.01 and errors[1] > missed


def test_shifts_are_what_the_contact_table_has_beyond_the_secants():
    form, frame = creep_model.shape(S1002), contact_table("s1002", S1002).frame
    columns = np.tan(frame["angle_rad"]), frame["rolling_radius_m"], -frame["rail_contact_m"]
    found = shifts(S1002)(np.array([-3e-3, -1e-3, 0.0, 1e-3, 3e-3]))
    for row, column, rate in zip(found, columns, (form.slope_rate, form.conicity, form.arm), strict=True):
        low, high = np.interp([-3e-3, 3e-3], frame["shift_m"], column)
        assert row[-1] == pytest.approx((high - low) / 2 / rate - 3e-3, rel=1e-3) == -row[0]
        assert np.abs(row[1:4]).max() < 1e-9  # the secants are those of a millimetre
    beyond = shifts(S1002)(np.array([4.5e-3, 6e-3]))
    np.testing.assert_allclose(beyond[:, 1], beyond[:, 0], atol=1e-6)
    assert not shifts(V)(np.array([-3e-3, 2e-3]))[[0, 2]].any() and abs(shifts(V)(np.array(3e-3))).max() < 1e-9


def test_each_shift_turns_the_gear_by_its_own_moment():
    speed, weight = 60.0, (S1002.body.mass / 2 + S1002.gear.mass) * S1002.gravity
    rolling, pulling = (creep_at(S1002, "dry", speed, slip) for slip in (0.0, 1e-3))
    form, wheel, inertia = creep_model.shape(S1002), S1002.wheel, S1002.gear.inertia_z
    angle, radius, contact = (KNOWN.index(name) for name in KNOWN[SHIFTS])
    model, row = lateral_model(S1002, speed, rolling), STATES.index("r")
    assert inertia * model.e[row, angle] == pytest.approx(rolling.spin.moment[0], rel=0.05)
    rolled = -S1002.gear.contact_base * rolling.along * form.conicity / wheel.radius
    assert inertia * model.e[row, radius] == pytest.approx(rolled, rel=1e-9)
    pulled = inertia * lateral_model(S1002, speed, pulling).e[row, contact]
    assert pulled == pytest.approx(pulling.adhesion * weight * form.arm, rel=1e-9)
    assert pulling.adhesion > 0.1 and model.e[row, contact] == 0.0


def test_where_one_wheel_slides_half_of_the_torque_reaches_the_rails():
    """The other wheel has twice the mean stiffness; the torque of its motor goes to the rail, that of the sliding one
    to its speed."""
    speed, stiff, whole = 30.0, 4e6, creep_at(S1002, "dry", 30.0)
    model = lateral_model(S1002, speed, Creep(stiff, whole.across, share=0.5))
    wheel, place = S1002.wheel, STATES.index
    # of the wheel that holds: J E' = r (tau - r F), F = 2 k_11 E/v, and half the difference of the forces is F/2
    faster = -(wheel.radius**2) / wheel.spin_inertia * 2 * stiff / speed
    assert model.a[place("E"), place("E")] == pytest.approx(faster, rel=1e-12)
    steady = model.a[place("E"), place("tau")] / -faster  # its speed per N m
    assert stiff / speed * steady == pytest.approx(0.5 / wheel.radius, rel=1e-12)


def response(a, b, row, frequency):
    return np.linalg.solve(1j * frequency * np.eye(len(a)) - a, b)[row]


@pytest.mark.parametrize(("cone_angle", "tolerance"), [(1e-5, 2e-3), (0.025, 0.03)])
def test_stiff_creep_is_the_control_model(cone_angle, tolerance):
    """Displacement after torque, cant, body and curvature; on a cone the hub's roll moves the contact by 1.6 %."""
    vehicle, speed = load_vehicle(**{"contact.profile": "cone", "wheel.cone_angle": cone_angle}), 50.0
    stiff = lateral_model(vehicle, speed, Creep(1e13, 1e13))
    control = rolling.control_model()
    x, u, theta = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("theta", len(rolling.THETA))
    rate = control.rhs(x, u, theta, control.parameter_vector(vehicle))
    jacobians = ca.Function("j", [x, u, theta], [ca.jacobian(rate, v) for v in (x, u, theta)])
    at = np.zeros(6), np.zeros(2), np.zeros(len(rolling.THETA))
    at[0][rolling.XDOT], at[2][rolling.M_CB] = speed, vehicle.body.mass
    by_x, by_u, by_theta = (np.array(m) for m in jacobians(*at))
    keep = [rolling.PSI_AX, rolling.PSIDOT_AX, rolling.Y, rolling.PSI_TRAX]
    a = by_x[np.ix_(keep, keep)]
    side, turning, rolls, heading, slewing, *_ = stiff.e.T
    inputs = {
        "du": (stiff.b, by_u[keep, rolling.TAU_LE] - by_u[keep, rolling.TAU_RI]),
        "cant": (speed * rolls, by_theta[keep, rolling.DPHI_DP]),
        "body": (heading, -by_theta[keep, rolling.PSI_CB]),
    }
    for frequency in (1.0, 5.0, 20.0):
        s = 1j * frequency
        bend = speed * (s * turning + slewing + heading / s - speed * side)
        inputs["curvature"] = bend, by_theta[keep, rolling.DPSI_DP]
        lag = 1 / (1 + s * vehicle.drive.lag)
        for name, (ours, theirs) in inputs.items():
            found = response(stiff.a, ours, STATES.index("y"), frequency)
            expected = response(a, theirs, 2, frequency) * (lag if name == "du" else 1)
            assert abs(found / expected - 1) < tolerance, (name, frequency)


def test_a_gear_and_a_body_that_move_with_the_rails_feel_nothing():
    vehicle = load_vehicle()
    speed, creep = 60.0, creep_at(vehicle, "dry", 60.0, 1e-3)
    model = lateral_model(vehicle, speed, creep)
    assert abs(creep.spin.force[0]) > 0.0 and creep.adhesion > 0.1  # all forces of the contact are there
    offset, rate = (KNOWN.index(name) for name in ("rail_offset", "rail_rate"))
    beside = np.array([float(name in ("y", "yb")) for name in STATES])
    np.testing.assert_allclose(model.a @ beside + model.e[:, offset], 0.0, atol=1e-9 * np.abs(model.e[:, offset]).max())
    # rails that are straight and turned: all that moves along them does so steadily, with the yaw angle of the rails
    along = {"vy": 1.0, "vb": 1.0, "psi": 1 / speed}
    turned = model.a @ [along.get(name, 0.0) for name in STATES] + model.e[:, rate]
    stage = vehicle.suspension.yaw_stiffness / speed / vehicle.gear.inertia_z  # holds the gear along the car body
    steady = [{"y": 1.0, "yb": 1.0, "r": -stage}.get(name, 0.0) for name in STATES]
    np.testing.assert_allclose(turned, steady, atol=1e-9 * np.abs(model.e[:, rate]).max())


def test_discrete_model_is_exact_for_held_inputs():
    model = lateral_model(V, 20.0, creep_at(V, "dry", 20.0))
    one, half = model.discrete(4e-3), model.discrete(2e-3)
    assert half.a @ half.a == pytest.approx(one.a, rel=1e-9, abs=1e-9 * np.abs(one.a).max())
    for name in ("b", "e", "d"):
        short, long = getattr(half, name), getattr(one, name)
        assert half.a @ short + short == pytest.approx(long, rel=1e-9, abs=1e-9 * np.abs(long).max())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Creep(1e7, 0.0), "Creep: across is 0.0, a number above 0"),
        (lambda: Creep(True, 1e7), "Creep: along is True"),
        (lambda: Creep(1e7, 1e7, share=0.4), "Creep: share is 0.4, a number from 0.5"),
        (lambda: Creep(1e7, 1e7, np.nan), "Creep: adhesion is nan"),
        (lambda: lateral_model(V, 0.0, Creep(1e7, 1e7)), "lateral model: speed is 0.0, a number from 0.5"),
        (lambda: creep_at(V, "dry", 20.0, "much"), "creep: slip is 'much'"),
        (lambda: creep_at(V, "icy", 20.0), "adhesion set 'icy' is not known"),
    ],
)
def test_impossible_arguments_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
