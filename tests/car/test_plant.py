"""The multibody car: statics, energy, symmetry, integrator, contact of a wheel."""

from dataclasses import astuple

import casadi as ca
import numpy as np
import pandas as pd
import pytest
import symmetry

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.creep import polach
from railrepro.contact.table import CELL_COLUMNS
from railrepro.control import law
from railrepro.control.ndi import NDI
from railrepro.simulation import closed_loop, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track import route
from railrepro.track.alignment import Alignment, Segment
from railrepro.track.table import Track, build_table, load_track
from railrepro.vehicle.parameters import load_vehicle

KMH = 1 / 3.6


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


def guided(vehicle, way, ndi):
    """The control cycle of a car at 280 km/h."""
    control = law.control_law(vehicle, ndi, lateral_limit=0.03, track_end=way.length, stop_speed=-1.0)
    return closed_loop.ClosedLoop(SteppedCar(way, 280 * KMH, vehicle), control)


def conservative(vehicle):
    """Plant parameters without any damping or friction."""
    values = equations.parameter_vector(vehicle)
    for i, name in enumerate(equations.PARAMETERS):
        if name.startswith("suspension.c_") or name.endswith("_damping"):
            values[i] = 0.0
        if name.endswith(".mu0"):
            values[i] = 1e-12
    return values


def test_energy_of_the_free_car_is_conserved(vehicle):
    car = SteppedCar("T5", 50.0)
    car.parameters[:] = conservative(vehicle)
    car.state[equations.indices("body.y", "body.phi", "front.y", "rear.y")] = 0.002, 0.002, 0.001, -0.001
    before = car.energies["mechanical_J"]
    car.step(steps=10_000)
    assert car.energies["mechanical_J"] == pytest.approx(before, rel=1e-6)


@pytest.mark.parametrize(
    ("spring", "coordinate", "angle"), [("antiroll", "phi", 0.01), ("pitch", "pitch", 0.01), ("yaw_stop", "psi", 0.06)]
)
def test_rotational_springs_store_their_energy(vehicle, spring, coordinate, angle):
    """Both gears' springs of a turned body: k (sin angle - sin clearance)^2 / 2 each."""
    car, stored = SteppedCar("T5", 50.0), []
    car.state[equations.indices(f"body.{coordinate}")] = angle
    clearance = vehicle.suspension.yaw_stop_angle if spring == "yaw_stop" else 0.0
    stiffness = getattr(vehicle.suspension, f"{spring}_stiffness")
    for value in (stiffness, 0.0):
        car.parameters[equations.PARAMETERS.index(f"suspension.{spring}_stiffness")] = value
        stored.append(car.energies["mechanical_J"])
    expected = stiffness * (np.sin(angle) - np.sin(clearance)) ** 2
    assert stored[0] - stored[1] == pytest.approx(expected, rel=1e-3)


def test_wheels_bounce_on_the_rails_as_hertz_has_it(vehicle):
    """A carrier on two contacts, of stiffness 1.5 N/penetration and damping N times its constant, and on dampers."""
    car = SteppedCar("T5", 50.0)
    car.step(steps=2000)
    load = (vehicle.body.mass / 2 + vehicle.gear.mass) * vehicle.gravity / 2
    penetration = (load / vehicle.contact.normal_stiffness) ** (2 / 3)
    frequency = np.sqrt(2 * 1.5 * load / penetration / vehicle.gear.mass)
    decay = (load * vehicle.contact.normal_damping + vehicle.suspension.c_z) / vehicle.gear.mass
    modes = np.linalg.eigvals(car.linearise().a.to_numpy())
    bounce = modes[np.argsort(np.abs(modes.imag - frequency))[:2]]
    assert bounce.imag == pytest.approx(frequency, rel=0.02)
    assert -bounce.real == pytest.approx(decay, rel=0.01)


def pulled(good, poor, *share):
    """The car after it was pulled over rails with some share of the poor set."""
    profiles = tuple(lambda p, part=part: np.full_like(p, part) for part in share)
    car = SteppedCar(route.lay(load_track("T5"), poor=profiles), 50.0, None, good, poor)
    car.step([2000.0] * 4, 1500)
    return car


def test_share_of_the_poor_set_blends_from_good_to_poor():
    poor, exchanged, dry = (pulled(*rails).state for rails in (("dry", "poor", 1.0, 1.0), ("poor", "dry", 0.0, 0.0),
                                                               ("dry", "poor", 0.0, 0.0)))  # fmt: skip
    assert poor == pytest.approx(exchanged, rel=1e-12)
    assert not np.allclose(poor, dry, rtol=1e-6)


def test_a_driven_wheel_on_the_poor_rail_slips_and_the_other_does_not():
    slips = pulled("dry", "poor", 1.0, 0.0).outputs
    assert slips["front_le.sx"] < 1.5 * slips["front_ri.sx"] < 0


def test_work_of_the_motors_becomes_kinetic_energy_and_losses(vehicle):
    sweep = route.sweep(2e-3, 150, 60, 25, 500)
    coupled = guided(vehicle, route.lay(load_track("T3"), sweep, force=lambda p: np.where(p > 5, 10e3, 0.0)), NDI())
    rows = []
    for _ in range(4000):
        rows.append(coupled.car.energies)
        coupled.run(1)
    table = pd.DataFrame([*rows, coupled.car.energies])
    work = np.trapezoid(table["motor_W"] - table["damping_W"] - table["creep_W"], dx=CONTROL_PERIOD)
    assert table["mechanical_J"].iloc[-1] - table["mechanical_J"].iloc[0] == pytest.approx(work, rel=1e-4)
    assert table["motor_W"].max() > 1e5


def mirror(name):
    """Name of the same quantity on the other side of the track and its sign there."""
    odd = {"y", "psi", "phi", "vy", "wx", "wz", "psi_Ax", "psi_TrAx", "psidot_Ax", "yaw_to_body", "y_ref", "du"}
    odd |= {"Fy", "nu_y", "spin", "M_spin", "rail_y", "sway", "ay"}
    other = name.replace("_le", "_*").replace("_ri", "_le").replace("_*", "_ri")
    return other, -1 if name.split(".")[1] in odd else 1


@pytest.mark.parametrize("profile", ["cone", "s1002"])
def test_left_and_right_curves_mirror_in_every_state_and_output(profile):
    vehicle, runs = load_vehicle(**{"contact.profile": profile}), []
    way = route.lay(load_track("T3"), route.sweep(2e-3, 150, 60, 25, 500))
    for each in (way, symmetry.mirrored(way)):
        coupled = guided(vehicle, each, NDI())
        log = pd.DataFrame(coupled.run(3000), columns=coupled.columns)
        runs.append((dict(zip(equations.STATES, coupled.state, strict=True)), log))
    (right, right_log), (left, left_log) = runs
    assert np.abs(right_log["front.y"]).max() > 1e-3
    for name, value in right.items():
        other, sign = mirror(name)
        assert value == pytest.approx(sign * left[other], rel=1e-8, abs=1e-11), name
        assert abs(value) > 1e-7, f"{name} says nothing about symmetry"
    for name in right_log:
        other, sign = mirror(name)
        scale = np.abs(right_log[name]).max()
        assert np.abs(right_log[name] - sign * left_log[other]).max() <= 1e-8 * scale + 1e-10, name


def test_jacobian_of_the_step_is_the_derivative_of_the_rate():
    """A wrong chain rule would cost the order silently; a linear test problem would not see it."""
    moving = SteppedCar("T3", 280 * KMH)
    moving.step([300.0, -300.0, 150.0, -150.0], 700)
    car, start = moving.model, moving.state
    x = ca.SX.sym("x", len(car.states))
    inputs = moving.inputs()[1:]
    jacobian = np.array(ca.Function("J", [x], [ca.jacobian(car.rate(x, *inputs), x)])(start))
    h = 1e-3
    rate = np.array(car.rate(start, *inputs)).ravel()
    shift = 2 / h * np.eye(len(rate)) - jacobian

    def f(state):
        return np.array(car.rate(state, *inputs)).ravel()

    k1 = np.linalg.solve(shift, rate)
    k2 = np.linalg.solve(shift, rate + 4 / h * k1)
    k3 = np.linalg.solve(shift, f(start + 2 * k1) + (k1 - k2) / h)
    k4 = np.linalg.solve(shift, f(start + 2 * k1 + k3) + (k1 - k2 - 8 / 3 * k3) / h)
    stepped = np.array(car.step(start, *inputs, h)[0]).ravel()
    assert np.allclose(stepped, start + 2 * k1 + k3 + k4, rtol=1e-9, atol=1e-10)


def _gradient(slope):
    """300 m straight, rising for a positive slope (-)."""
    straight = Segment(300.0, (0.0, 0.0), (0.0, 0.0), (slope, slope))
    return route.lay(Track("gradient", build_table(Alignment("gradient", (straight,), None))))


@pytest.mark.parametrize("slope", [0.01, -0.01])
def test_the_brake_holds_the_car_on_a_gradient(vehicle, slope):
    """Each wheel carries a quarter of the downhill force; up or down, the command is the same."""
    weight = (vehicle.body.mass + 2 * vehicle.gear.mass) * vehicle.gravity
    car = SteppedCar(_gradient(slope), 1.0, vehicle)
    car.step(np.full(4, -4000.0), 5000)
    rest = car.outputs["front.p"]
    car.step(steps=5000)
    assert abs(car.outputs["front.v"]) < 1e-4 and abs(car.outputs["front.p"] - rest) < 1e-3
    held = weight * np.sin(slope) / 4 * vehicle.wheel.radius
    assert np.mean([car.outputs[f"{wheel}.tau"] for wheel in equations.WHEELS]) == pytest.approx(held, rel=5e-3)


def test_a_wheel_that_lifts_carries_nothing_and_the_run_stays_finite():
    car = SteppedCar("T5", 30.0)
    car.state[equations.INDEX["front.z"]] -= 0.02
    assert car.outputs["front_le.N"] == 0.0
    car.step(steps=3000)
    assert car.outputs["front_le.N"] > 5e4


def test_gyroscopic_moment_of_the_rolling_axle_in_the_clothoid(vehicle):
    track, scenario = load_track("T3"), load_scenario("curve_entry_T3").but(set_point={"kind": "none"}, end_m=200)
    speed = track.design_speed
    log = simulate.run(scenario, NDI(integral=0.2)).series
    window = log[log["rear.p"] > 110]
    _, kappa, _, dphi, *_ = track.interpolate(np.array([100.0, 150.0]))
    gyro = -2 * vehicle.wheel.spin_inertia * speed / vehicle.wheel.radius * dphi[0] * speed
    turning = vehicle.effective_yaw_inertia * (kappa[1] - kappa[0]) / 50 * speed**2
    expected = (gyro + turning) * vehicle.wheel.radius / vehicle.gear.contact_base
    assert (window["front.du"].mean() + window["rear.du"].mean()) / 2 == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(("side", "sign"), [("le", -1), ("ri", 1)])
def test_contact_of_a_wheel_follows_from_the_named_columns_of_its_cell(vehicle, side, sign):
    """One gear off the centre of straight track, with yaw rate and lateral speed, worked out from names."""
    cell = {
        "shift": sign * 1.5e-3 - 4e-4,
        "width": 5e-4,
        "effective_radius": 0.46,
        "radius_slope": 0.03,
        "radius_square": 2.0,
    }
    cell |= {"radius_cube": 900.0, "rolling_radius": 0.4603, "drolling_radius": 0.04, "rail_contact": 4e-3}
    cell |= {"drail_contact": 1.3, "semi_axis_x": 6e-3, "dsemi_axis_x": 0.4, "semi_axis_y": 5e-3, "dsemi_axis_y": -0.6}
    cell |= {"c11": 4.1, "dc11": 30.0, "c22": 3.6, "dc22": -50.0, "c23": 1.5, "dc23": 70.0, "c33": 1.1, "dc33": -90.0}
    cell |= {"normal_stiffness": 9e10, "dnormal_stiffness": 4e12}
    at = {name: cell[name] + cell[f"d{name}"] * 4e-4 for name in cell if f"d{name}" in cell}
    radius = 0.46 + 4e-4 * (0.03 + 4e-4 * (2.0 + 4e-4 * 900.0))
    slope = 0.03 + 2 * 2.0 * 4e-4 + 3 * 900.0 * 4e-4**2
    vx, vy, wz, spin = 40.0, 0.03, 0.02, 87.05
    moving = {"front.y": 1.5e-3, "front.z": 1e-4 - radius, "front.vx": vx, "front.vy": vy, "front.wz": wz}
    state = np.zeros(len(equations.STATES))
    for name, value in (moving | {f"w.front_{side}": spin}).items():
        state[equations.INDEX[name]] = value
    par = dict(zip(equations.PARAMETERS, equations.parameter_vector(vehicle), strict=True))
    par["contact.normal_damping"] = 0.0
    contacts = np.tile(np.array([[cell[name]] for name in CELL_COLUMNS]), 4)
    car, rows = equations.car(), np.zeros((len(route.COLUMNS), 3))
    found = np.array(car.output(state, np.zeros(4), rows, contacts, np.array(list(par.values())))).ravel()
    found = {
        name: found[car.outputs.index(f"front_{side}.{name}")] for name in ("N", "nu_x", "nu_y", "spin", "Fx", "Fy")
    }

    cos = 1 / np.hypot(1, slope)
    load = at["normal_stiffness"] * (1e-4 * cos) ** 1.5
    lever = sign * (vehicle.gear.contact_base / 2 + at["rail_contact"]) - 1.5e-3
    sliding = vx - spin * (at["rolling_radius"] - 1e-4) - wz * lever, vy * cos
    rolling = np.hypot(vx, vehicle.contact.rest_speed)
    creepage = *(np.array(sliding) / rolling), (wz * cos - spin * sign * slope * cos) / rolling
    scale = (load / vehicle.contact.nominal_load) ** (1 / 3)
    ellipse = at["semi_axis_x"] * scale, at["semi_axis_y"] * scale
    kalker = (at[name] for name in ("c11", "c22", "c23", "c33"))
    law_ = astuple(vehicle.adhesion["dry"])
    force = polach(*creepage, load, *ellipse, *kalker, vehicle.contact.shear_modulus, *law_, np.hypot(*sliding))
    expected = dict(zip(found, (load, *creepage, *force), strict=True))
    assert found == pytest.approx(expected, rel=2e-5)  # the car's law carries one newton more
    assert max(abs(value) for value in creepage[:2]) > 5e-4
