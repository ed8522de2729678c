"""The car's own equations without compiling them: drive limits, named outputs, energies, parameters, start."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.contact.table import contact_table
from railrepro.track.route import COLUMNS
from railrepro.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


def case(vehicle, speed=20.0, commands=None, cell=None, **values):
    """Arguments of the car's functions at rest state but for `values` (dots as double underscores)."""
    table = contact_table("cone", vehicle)
    state = equations.rest_state(vehicle, table, speed)
    for name, value in values.items():
        state[equations.INDEX[name.replace("__", ".")]] = value
    commands = {"front_le": 0.0} | (commands or {})
    u = [commands.get(wheel, 0.0) for wheel in equations.WHEELS]
    row = [(cell or {}).get(name, 0.0) for name in COLUMNS]
    rows = np.tile(np.reshape(row, (-1, 1)), len(equations.BODIES))
    contacts = np.tile(table.cells()[round(-table.start / table.step)][:, None], len(equations.WHEELS))
    return state, u, rows, contacts, equations.parameter_vector(vehicle)


def outputs(*arguments, **values):
    found = np.array(equations.car().output(*case(*arguments, **values))).ravel()
    return dict(zip(equations.car().outputs, found, strict=True))


def energies(*arguments, **values):
    return np.array(equations.car().energy(*case(*arguments, **values))).ravel()


@pytest.mark.parametrize(
    ("command", "rim_speed", "given"),
    [
        (1000.0, 20.0, 1000.0),
        (5000.0, 20.0, 4000.0),
        (-5000.0, 20.0, -4000.0),
        (4000.0, 92.0, 4000.0),
        (-3000.0, 0.2, -3000.0),
        (-3000.0, -0.2, 3000.0),
        (-5000.0, -20.0, 4000.0),
        (3000.0, 0.1, 3000.0),
        (3000.0, -0.1, 3000.0),
    ],
)
def test_the_drive_gives_what_its_limit_and_standstill_allow(vehicle, command, rim_speed, given):
    """4 kN m; a braking torque is against the rotation, a driving one forward."""
    arguments = case(vehicle, commands={"rear_le": command}, w__rear_le=rim_speed / 0.46, tau__rear_le=200.0)
    rate = np.array(equations.car().rate(*arguments)).ravel()
    assert rate[equations.INDEX["tau.rear_le"]] == pytest.approx((given - 200.0) / 0.005)
    assert rate[equations.indices("tau.front_le", "tau.front_ri", "tau.rear_ri")] == pytest.approx(0.0)


@pytest.mark.parametrize("mirror", [1, -1])
@pytest.mark.parametrize(("rim_speed", "share"), [(0.2, 1.0), (0.1, 0.5), (0.02, 0.1), (0.0, 0.0)])
def test_a_braking_torque_follows_its_wheel_to_rest_and_stays(vehicle, rim_speed, share, mirror):
    """Torque over angle turned near standstill, the same forward and backward; the command is -3000 N m for both."""
    state = {"w__rear_le": mirror * rim_speed / 0.46, "tau__rear_le": mirror * 200.0}
    rate = np.array(equations.car().rate(*case(vehicle, commands={"rear_le": -3000.0}, **state))).ravel()
    assert rate[equations.INDEX["tau.rear_le"]] == pytest.approx(mirror * share * (-3000.0 - 200.0) / 0.005)


def test_at_the_start_no_body_is_accelerated(vehicle):
    """Weight rests on springs and rails; the spin creep of the cones leaves ninety newtons per gear."""
    rate = np.array(equations.car().rate(*case(vehicle))).ravel()
    turns = ("vx", "vy", "vz", "wx", "wy", "wz")
    names = [f"{body}.{name}" for body in equations.BODIES for name in turns] + [f"w.{w}" for w in equations.WHEELS]
    assert rate[equations.indices(*names)] == pytest.approx(0.0, abs=0.05)


def test_a_motor_spins_its_wheel_against_the_rail(vehicle):
    """60 kg m2 per wheel: 300 N m more at the motor are 5 rad/s2 more at that wheel alone."""
    car = equations.car()
    idle, driven = (np.array(car.rate(*case(vehicle, tau__front_ri=tau))).ravel() for tau in (0.0, 300.0))
    more = (driven - idle)[equations.indices(*(f"w.{wheel}" for wheel in equations.WHEELS))]
    assert more == pytest.approx([0, 5, 0, 0], abs=1e-12)


def test_heading_and_turn_rate_are_absolute_and_speed_is_along_the_track(vehicle):
    """On an arc of 500 m, 2 mm and 10 mrad off the line: what a controller measures of its gear."""
    arc = {"psi": 0.3, "kappa": 2e-3}
    found = outputs(vehicle, cell=arc, front__y=2e-3, front__psi=0.01, front__wz=0.07, front__vy=0.1, front__s=5.0)
    assert found["front.p"] == 5.0
    assert found["front.psi_Ax"] == pytest.approx(0.3 + 5 * 2e-3 + 0.01)
    assert found["front.psi_TrAx"] == pytest.approx(0.01)
    assert found["front.y"] == pytest.approx(2e-3)
    assert found["front.v"] == pytest.approx(20.0 / (1 - 2e-3 * 2e-3), rel=1e-12)
    assert found["front.psidot_Ax"] == pytest.approx(0.07, rel=1e-12)
    assert found["rear.psidot_Ax"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("gear", equations.GEARS)
def test_yaw_of_a_gear_to_the_body(vehicle, gear):
    found = outputs(vehicle, **{f"{gear}__psi": 0.03, "body__psi": -0.01})
    other = "rear" if gear == "front" else "front"
    assert found[f"{gear}.yaw_to_body"] == pytest.approx(0.04, rel=1e-6)
    assert found[f"{other}.yaw_to_body"] == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize(("speed", "slip"), [(20.0, -0.01), (0.5, -0.5 * 0.01)])
def test_adhesion_and_slip_of_a_driven_wheel(vehicle, speed, slip):
    """A wheel that turns 1 % too fast; below 1 m/s the slip is told over 1 m/s."""
    rolling = case(vehicle, speed)[0][equations.INDEX["w.front_le"]]
    found = outputs(vehicle, speed, w__front_le=1.01 * rolling, tau__front_le=123.0)
    assert found["front_le.sx"] == pytest.approx(slip, rel=1e-9)
    assert found["front_le.adhesion"] == pytest.approx(found["front_le.Fx"] / found["front_le.N"], rel=2e-5)
    assert found["front_le.Fx"] > 1e3
    assert found["front_ri.sx"] == pytest.approx(0.0, abs=1e-12)
    assert (found["front_le.w"], found["front_le.tau"]) == (pytest.approx(1.01 * rolling), 123.0)


@pytest.mark.parametrize(
    ("name", "before", "after", "energy"),
    [
        ("body.vx", 20.0, 21.0, 26_000 / 2 * (21**2 - 20**2)),
        ("body.vy", 0.0, 0.3, 26_000 / 2 * 0.3**2),
        ("rear.vz", 0.0, 0.4, 3000 / 2 * 0.4**2),
        ("body.wx", 0.0, 0.1, 50_000 / 2 * 0.1**2),
        ("body.wz", 0.0, 0.1, 900_000 / 2 * 0.1**2),
        ("front.wx", 0.0, 0.1, 1500 / 2 * 0.1**2),
        ("front.wy", 0.0, 0.1, 600 / 2 * 0.1**2),
        ("front.wz", 0.0, 0.1, 2000 / 2 * 0.1**2),
        ("w.rear_ri", 40.0, 41.0, 60 / 2 * (41**2 - 40**2)),
        ("tau.rear_ri", 0.0, 500.0, 0.0),
    ],
)
def test_kinetic_energy_by_hand(vehicle, name, before, after, energy):
    key = name.replace(".", "__")
    difference = energies(vehicle, **{key: after})[0] - energies(vehicle, **{key: before})[0]
    assert difference == pytest.approx(energy, rel=1e-6, abs=1e-6)


def test_weight_of_all_bodies_has_its_potential(vehicle):
    """Over the rails: 26 t at 1.8 m, twice 3 t at 0.46 m, all 0.09 mm lower by the approach of the contacts."""
    light = load_vehicle(**{"environment.gravity": 1e-9})
    table = contact_table("cone", vehicle)
    state = equations.rest_state(vehicle, table, 20.0)
    arguments = [state, *case(vehicle)[1:]]
    parameters = arguments[-1].copy()
    parameters[equations.PARAMETERS.index("gravity")] = light.gravity
    heavy, none = (float(equations.car().energy(*arguments[:-1], p)[0]) for p in (arguments[-1], parameters))
    drop = (78_480 / np.cos(0.025) / 92e9) ** (2 / 3)
    assert heavy - none == pytest.approx(9.81 * (26_000 * 1.8 + 6000 * 0.46 - 32_000 * drop), rel=1e-4)


def test_power_of_a_motor_is_taken_over_its_stator(vehicle):
    """500 N m on a wheel that turns at 43 rad/s forward; the carrier pitches nose up at 2 rad/s."""
    power = energies(vehicle, tau__front_le=500.0, w__front_le=43.0, front__wy=2.0)[1]
    assert power == pytest.approx(500.0 * (43.0 + 2.0))
    assert energies(vehicle)[1] == 0.0


def test_creep_loss_is_force_times_sliding(vehicle):
    rolling = case(vehicle)[0][equations.INDEX["w.front_le"]]
    found = outputs(vehicle, w__front_le=1.01 * rolling)
    loss = energies(vehicle, w__front_le=1.01 * rolling)[3]
    # The spin of the cone against its rail loses a few W more than the sliding along it.
    assert 0 < loss - found["front_le.Fx"] * 0.01 * 20.0 < 3e-3 * loss


def test_parameters_name_good_and_poor_sets():
    vehicle = load_vehicle()
    values = dict(zip(equations.PARAMETERS, equations.parameter_vector(vehicle, "wet", "very_poor"), strict=True))
    assert (values["adhesion.good.mu0"], values["adhesion.poor.mu0"]) == (0.3, 0.08)
    assert (values["adhesion.good.k_a"], values["gravity"], values["wheel.radius"]) == (0.3, 9.81, 0.46)
    usual = dict(zip(equations.PARAMETERS, equations.parameter_vector(vehicle), strict=True))
    assert (usual["adhesion.good.mu0"], usual["adhesion.poor.mu0"]) == (0.55, 0.15)


def test_the_end_of_a_turning_floor_is_pulled_towards_the_middle(vehicle):
    """A yaw rate of 0.5 rad/s and 7 m to the centre of gravity: 1.75 m/s2, which an accelerometer reads."""
    found = [outputs(vehicle, body__wz=rate) for rate in (0.0, 0.5)]
    more = [found[1][f"floor_{end}.ax"] - found[0][f"floor_{end}.ax"] for end in ("front", "centre", "rear")]
    assert more == pytest.approx([-1.75, 0.0, 1.75], abs=1e-6)


def test_axle_damping_brakes_the_faster_wheel_and_drives_the_slower_one():
    vehicle = load_vehicle(**{"gear.axle_damping": 600.0})
    speeds = equations.indices(*(f"w.{wheel}" for wheel in equations.WHEELS))
    even, uneven = (np.array(equations.car().rate(*case(vehicle, **wheels))).ravel()[speeds]
                    for wheels in ({}, {"w__front_le": case(vehicle)[0][speeds[0]] + 1e-6}))  # fmt: skip
    assert (uneven - even)[1] == pytest.approx(600.0 * 1e-6 / vehicle.wheel.spin_inertia, rel=1e-3)
    assert (uneven - even)[0] < -0.9 * (uneven - even)[1]
