"""The multibody car: statics, energy, symmetry, steady curving, integrator, faults, the compiled loop."""

from dataclasses import astuple, replace

import casadi as ca
import numpy as np
import pandas as pd
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.creep import polach
from railrepro.contact.table import CELL_COLUMNS, contact_table
from railrepro.control import law
from railrepro.control.ndi import NDI
from railrepro.estimation.sensors import Readings, load_loop
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


def start(
    vehicle,
    track="T5",
    speed=50.0,
    ndi=None,
    reference=None,
    state=None,
    parameters=None,
    **lay,
):
    """A control cycle at rest state (or `state`) on a named track."""
    way = route.lay(load_track(track), reference, **lay)
    control = law.control_law(vehicle, ndi, lateral_limit=0.03, track_end=way.length, stop_speed=-1.0)
    car = SteppedCar(way, speed, vehicle)
    car.parameters[:] = car.parameters if parameters is None else parameters
    car.state[:] = car.state if state is None else state
    return closed_loop.ClosedLoop(car, control)


def frame(rows, coupled):
    return pd.DataFrame(rows, columns=coupled.columns)


def energies(coupled):
    coupled.measure()
    return np.array(equations.car().energy(*coupled.inputs())).ravel()


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
    table = contact_table(vehicle.contact.profile, vehicle)
    state = equations.rest_state(vehicle, table, 50.0)
    state[equations.indices("body.y", "body.phi", "front.y", "rear.y")] = 0.002, 0.002, 0.001, -0.001
    coupled = start(vehicle, state=state, parameters=conservative(vehicle))
    before = energies(coupled)[0]
    coupled.run(10_000)
    assert energies(coupled)[0] == pytest.approx(before, rel=1e-6)


@pytest.mark.parametrize(
    ("spring", "coordinate", "angle"), [("antiroll", "phi", 0.01), ("pitch", "pitch", 0.01), ("yaw_stop", "psi", 0.06)]
)
def test_rotational_springs_store_their_energy(vehicle, spring, coordinate, angle):
    """Both gears' springs of a turned body: k (sin angle - sin clearance)^2 / 2 each."""
    state = equations.rest_state(vehicle, contact_table(vehicle.contact.profile, vehicle), 50.0)
    state[equations.indices(f"body.{coordinate}")] = angle
    clearance = vehicle.suspension.yaw_stop_angle if spring == "yaw_stop" else 0.0
    stored = []
    for stiffness in (getattr(vehicle.suspension, f"{spring}_stiffness"), 0.0):
        parameters = equations.parameter_vector(vehicle)
        parameters[equations.PARAMETERS.index(f"suspension.{spring}_stiffness")] = stiffness
        stored.append((stiffness, energies(start(vehicle, state=state, parameters=parameters))[0]))
    (stiffness, full), (_, without) = stored
    assert full - without == pytest.approx(stiffness * (np.sin(angle) - np.sin(clearance)) ** 2, rel=1e-3)


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


def test_share_of_the_poor_set_blends_from_good_to_poor(vehicle):
    ends = []
    for share, sets in ((1.0, ("dry", "poor")), (0.0, ("poor", "dry")), (0.0, ("dry", "poor"))):
        parameters = equations.parameter_vector(vehicle, *sets)
        coupled = start(
            vehicle,
            parameters=parameters,
            poor=lambda p, s=share: np.full_like(p, s),
            force=lambda p: np.full_like(p, 2e4),
        )
        coupled.run(1500)
        ends.append(coupled.state.copy())
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)
    assert not np.allclose(ends[0], ends[2], rtol=1e-6)


def test_a_driven_wheel_on_the_poor_rail_slips_and_the_other_does_not(vehicle):
    left = {"poor": (np.ones_like, np.zeros_like), "force": lambda p: np.full_like(p, 1e4)}
    coupled = start(vehicle, **left)
    last = frame(coupled.run(1500), coupled).iloc[-1]
    assert last["front_le.sx"] < 1.5 * last["front_ri.sx"] < 0


def test_work_of_the_motors_becomes_kinetic_energy_and_losses(vehicle):
    pull = {"force": lambda p: np.where(p > 5, 10e3, 0.0)}
    coupled = start(vehicle, "T3", 280 * KMH, NDI(), route.sweep(2e-3, 150, 60, 25, 500), **pull)
    balance = [energies(coupled)]
    for _ in range(4000):
        coupled.run(1)
        balance.append(energies(coupled))
    energy, motor, damping, creep = np.array(balance).T
    work = np.trapezoid(motor - damping - creep, dx=CONTROL_PERIOD)
    assert energy[-1] - energy[0] == pytest.approx(work, rel=1e-4)
    assert motor.max() > 1e5


def mirror(name):
    """Name of the same quantity on the other side of the track and its sign there."""
    odd = {"y", "psi", "phi", "vy", "wx", "wz", "psi_Ax", "psi_TrAx", "psidot_Ax", "yaw_to_body", "y_ref", "du"}
    odd |= {"Fy", "nu_y", "spin", "M_spin", "rail_y", "sway", "ay"}
    other = name.replace("_le", "_*").replace("_ri", "_le").replace("_*", "_ri")
    return other, -1 if name.split(".")[1] in odd else 1


@pytest.mark.parametrize("profile", ["cone", "s1002"])
def test_left_and_right_curves_mirror_in_every_state_and_output(vehicle, profile):
    table = contact_table(profile, vehicle)
    track = load_track("T3")
    flipped = track.table.copy()
    for column in ("psi_rad", "dpsi_dp_1pm", "phi_rad", "dphi_dp_1pm", "y_m"):
        flipped[column] = -flipped[column]
    runs = []
    for sign, geometry in ((1, track), (-1, replace(track, table=flipped))):
        way = route.lay(geometry, route.sweep(sign * 2e-3, 150, 60, 25, 500))
        control = law.control_law(vehicle, NDI(), lateral_limit=0.03, track_end=500.0, stop_speed=-1.0)
        coupled = closed_loop.ClosedLoop(SteppedCar(way, 280 * KMH, vehicle, table=table), control)
        log = frame(coupled.run(3000), coupled)
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


@pytest.mark.parametrize(("track", "speed"), [("T1", 40), ("T2", 160), ("T3", 280), ("T4", 400)])
def test_steady_curving_balances_weight_and_centrifugal_force(vehicle, track, speed):
    coupled = start(vehicle, track, speed * KMH, NDI(integral=0.05))
    length = load_track(track).length
    duration = (length - 30) / (speed * KMH)
    log = frame(coupled.run(int(1000 * duration)), coupled).tail(1500).mean()
    _, kappa, phi, *_ = load_track(track).interpolate(np.array([length - 40.0]))[:, 0]
    mass = vehicle.body.mass / 2 + vehicle.gear.mass
    v, g = log["front.v"], vehicle.gravity
    normal = mass * (g * np.cos(phi) + v**2 * kappa * np.sin(phi))
    sideways = mass * (v**2 * kappa * np.cos(phi) - g * np.sin(phi))
    lateral = 0.0
    for gear in ("front", "rear"):
        vertical = 0.0
        for side, sign in (("le", -1), ("ri", 1)):
            load, creep, angle = (log[f"{gear}_{side}.{name}"] for name in ("N", "Fy", "angle"))
            vertical += load * np.cos(angle) + sign * creep * np.sin(angle)
            lateral += creep * np.cos(angle) - sign * load * np.sin(angle)
        assert vertical == pytest.approx(normal, rel=2e-3)
    assert lateral == pytest.approx(2 * sideways, abs=300)


def test_yaw_spring_torque_in_the_narrow_curve(vehicle):
    coupled = start(vehicle, "T1", 40 * KMH, NDI(integral=0.2))
    log = frame(coupled.run(28_000), coupled).tail(1000).mean()
    angle = vehicle.body.gear_spacing / (2 * 175.0)
    expected = vehicle.suspension.yaw_stiffness * angle * vehicle.wheel.radius / vehicle.gear.contact_base
    assert log["front.du"] == pytest.approx(expected, rel=0.02)
    assert log["rear.du"] == pytest.approx(-expected, rel=0.02)


def by_functions(coupled, n):
    """Rows of a control cycle that CasADi evaluates; `coupled` gives start, tables, parameters and law."""
    car, model, control = coupled.car, coupled.car.model, coupled.control
    x, memory, log = coupled.state.copy(), coupled.memory.copy(), []
    first = equations.BODIES.index(law.GEARS[0])
    for _ in range(n):
        places = np.array(model.coordinates(x, car.rows.T, car.parameters)).ravel()
        for place, (cells, start, step, row) in zip(places, car._tables(), strict=True):
            row[:] = cells[int(np.clip((place - start) // step, 0, len(cells) - 1))]
        inputs = car.rows.T, car.contacts.T, car.parameters
        output = np.array(model.output(x, car.torque, *inputs)).ravel()
        below = car.rows[first : first + len(law.GEARS)].T
        found = control.function(output[coupled.sensed], below, coupled.held, control.gains, memory)
        car.torque[:], memory, record = (np.array(value).ravel() for value in found[:3])
        log.append(np.concatenate([output, record]))
        x = np.array(model.step(x, car.torque, *inputs, CONTROL_PERIOD)[0]).ravel()
    return np.array(log)


@pytest.mark.parametrize("sensed", [False, True])
def test_the_compiled_loop_is_that_of_its_functions(vehicle, sensed):
    scenario = load_scenario("curve_entry_T3")
    settings = law.LawSettings(sensors=Readings(load_loop(), 3) if sensed else None)
    way = simulate.checked_route(scenario, vehicle)
    one, other = (simulate.start(scenario, NDI(), way, vehicle, vehicle, settings) for _ in range(2))
    assert np.allclose(one.run(300), by_functions(other, 300), rtol=1e-6, atol=1e-6)


def test_jacobian_of_the_step_is_the_derivative_of_the_rate():
    """A wrong chain rule would cost the order silently; a linear test problem would not see it."""
    coupled = start(load_vehicle(), "T3", 280 * KMH, NDI())
    coupled.run(700)
    car = equations.car()
    x = ca.SX.sym("x", len(car.states))
    inputs = coupled.inputs()[1:]
    jacobian = np.array(ca.Function("J", [x], [ca.jacobian(car.rate(x, *inputs), x)])(coupled.state))
    h = 1e-3
    rate = np.array(car.rate(coupled.state, *inputs)).ravel()
    shift = 2 / h * np.eye(len(rate)) - jacobian

    def f(state):
        return np.array(car.rate(state, *inputs)).ravel()

    k1 = np.linalg.solve(shift, rate)
    k2 = np.linalg.solve(shift, rate + 4 / h * k1)
    k3 = np.linalg.solve(shift, f(coupled.state + 2 * k1) + (k1 - k2) / h)
    k4 = np.linalg.solve(shift, f(coupled.state + 2 * k1 + k3) + (k1 - k2 - 8 / 3 * k3) / h)
    stepped = np.array(car.step(coupled.state, *inputs, h)[0]).ravel()
    assert np.allclose(stepped, coupled.state + 2 * k1 + k3 + k4, rtol=1e-9, atol=1e-10)


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


@pytest.mark.parametrize("slope", [0.01, -0.01])
def test_a_brake_beyond_its_limit_slides_with_that_limit(vehicle, slope):
    """200 N m per wheel against the 361 N m that 10 per mille ask for: the rest accelerates downhill, either way."""
    mass = vehicle.body.mass + 2 * vehicle.gear.mass
    force = mass * vehicle.gravity * np.sin(slope) - np.sign(slope) * 4 * 200.0 / vehicle.wheel.radius
    car = SteppedCar(_gradient(slope), 0.05, vehicle)
    car.step(np.full(4, -200.0), 4000)
    before = car.outputs["front.v"]
    car.step(steps=4000)
    expected = -4.0 * force / (mass + 4 * vehicle.wheel.spin_inertia / vehicle.wheel.radius**2)
    assert car.outputs["front.v"] - before == pytest.approx(expected, rel=0.01)


def test_a_wheel_that_lifts_carries_nothing_and_the_run_stays_finite(vehicle):
    table = contact_table(vehicle.contact.profile, vehicle)
    state = equations.rest_state(vehicle, table, 30.0)
    state[equations.INDEX["front.z"]] -= 0.02
    coupled = start(vehicle, state=state)
    log = frame(coupled.run(3000), coupled)
    assert log["front_le.N"].iloc[0] == 0.0
    assert log["front_le.N"].iloc[-1] > 5e4


def test_gyroscopic_moment_of_the_rolling_axle_in_the_clothoid(vehicle):
    track = load_track("T3")
    speed = track.design_speed
    coupled = start(vehicle, "T3", speed, NDI(integral=0.2))
    log = frame(coupled.run(int(1000 * 200 / speed)), coupled)
    window = log[log["rear.p"] > 110]
    _, kappa, _, dphi, *_ = track.interpolate(np.array([100.0, 150.0]))
    gyro = -2 * vehicle.wheel.spin_inertia * speed / vehicle.wheel.radius * dphi[0] * speed
    turning = vehicle.effective_yaw_inertia * (kappa[1] - kappa[0]) / 50 * speed**2
    expected = (gyro + turning) * vehicle.wheel.radius / vehicle.gear.contact_base
    assert (window["front.du"].mean() + window["rear.du"].mean()) / 2 == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("profile", ["cone", "s1002"])
def test_the_car_starts_in_balance_and_without_slip(profile):
    vehicle = load_vehicle(**{"contact.profile": profile})
    out = SteppedCar("T5", 50.0, vehicle).outputs
    weight = (vehicle.body.mass + 2 * vehicle.gear.mass) * vehicle.gravity / 4
    for wheel in equations.WHEELS:
        assert out[f"{wheel}.N"] * np.cos(out[f"{wheel}.angle"]) == pytest.approx(weight, rel=1e-6)
        assert out[f"{wheel}.sx"] == pytest.approx(0.0, abs=1e-12)


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


def test_pitch_is_nose_up_and_roll_is_right_side_down(vehicle):
    car = SteppedCar("T5", 60.0)
    car.step(steps=500)
    a, spring = car.linearise().a, vehicle.suspension
    lift = spring.k_z * vehicle.body.gear_spacing / vehicle.gear.mass
    assert a.loc[["front.vz", "rear.vz"], "body.pitch"].tolist() == pytest.approx([-lift, lift], rel=1e-5)
    assert a.loc[["front.vz", "rear.vz"], "body.phi"].tolist() == pytest.approx([0, 0], abs=1e-6)
    tilt = spring.k_z * 2 * spring.half_spacing**2 + spring.antiroll_stiffness
    assert a.loc["front.wx", "body.phi"] == pytest.approx(tilt / vehicle.gear.inertia_x, rel=0.15)
    assert a.loc["front.wx", "body.pitch"] == pytest.approx(0, abs=1e-6)
    for body in equations.BODIES:
        angles, turns = (
            [f"{body}.{name}" for name in names] for names in (("phi", "pitch", "psi"), ("wx", "wy", "wz"))
        )
        assert a.loc[angles, turns].to_numpy() == pytest.approx(np.eye(3), abs=1e-4)
