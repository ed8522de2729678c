"""The multibody car: statics, energy, symmetry, integrator, contact of a wheel."""

import casadi as ca
import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.car.integrator import rodas3
from railrepro.track import route
from railrepro.track.alignment import Alignment, Segment
from railrepro.track.table import Track, build_table, load_track
from railrepro.vehicle.parameters import load_vehicle

VEHICLE = load_vehicle()


def test_energy_of_the_car_without_damping_and_friction_is_conserved():
    car = SteppedCar("T5", 50.0)
    for i, name in enumerate(equations.PARAMETERS):
        if name.startswith("suspension.c_") or name.endswith("_damping"):
            car.parameters[i] = 0.0
        if name.endswith(".mu0"):
            car.parameters[i] = 1e-12
    car.state[equations.indices("body.y", "body.phi", "front.y", "rear.y")] = 0.002, 0.002, 0.001, -0.001
    before = car.energies["mechanical_J"]
    car.step(steps=10_000)
    assert car.energies["mechanical_J"] == pytest.approx(before, rel=1e-6)


def test_between_bodies_and_motors_energy_is_lost_only_in_dampers():
    """At one instant in the air over the clothoid of T3, at the stops: each force fits its energy and its power."""
    car, generator = SteppedCar("T3", 60.0), np.random.default_rng(1)
    car.parameters[equations.PARAMETERS.index("gear.axle_damping")] = 600.0
    sizes = {"y": 0.04, "psi": 0.06, "pitch": 0.02, "phi": 0.02, "w": 5.0, "tau": 500.0}
    for name, i in equations.INDEX.items():
        group, _, coordinate = name.partition(".")
        car.state[i] += generator.normal(0, sizes.get(group, sizes.get(coordinate, 0.3)))
    for body in equations.BODIES:
        car.state[equations.indices(f"{body}.s", f"{body}.z")] += 150.0, -1.0
    x, (at, *inputs) = ca.SX.sym("x", len(car.state)), car.inputs()
    energy, motors, dampers, creep = ca.vertsplit(car.model.energy(x, *inputs))
    balance = ca.vertcat(ca.jtimes(energy, x, car.model.rate(x, *inputs)), motors - dampers, creep)
    gained, given, slid = ca.Function("power", [x], [balance])(at).nonzeros()
    assert gained == pytest.approx(given, rel=1e-9) and slid == 0.0
    for gear in equations.GEARS:
        assert abs(car.outputs[f"{gear}.yaw_to_body"]) > VEHICLE.suspension.yaw_stop_angle
        assert abs(car.outputs[f"{gear}.sway"]) > VEHICLE.suspension.bump_clearance


def test_wheels_bounce_on_the_rails_as_hertz_has_it():
    """A carrier on two contacts, of stiffness 1.5 N/penetration and damping N times its constant, and on dampers."""
    car, (body, gear, contact) = SteppedCar("T5", 50.0), (VEHICLE.body, VEHICLE.gear, VEHICLE.contact)
    car.step(steps=2000)
    load = (body.mass / 2 + gear.mass) * VEHICLE.gravity / 2
    penetration = (load / contact.normal_stiffness) ** (2 / 3)
    frequency = np.sqrt(2 * 1.5 * load / penetration / gear.mass)
    modes = np.linalg.eigvals(car.linearise().a.to_numpy())
    bounce = modes[np.argsort(np.abs(modes.imag - frequency))[:2]]
    assert bounce.imag == pytest.approx(frequency, rel=0.02)
    decay = (load * contact.normal_damping + VEHICLE.suspension.c_z) / gear.mass
    assert -bounce.real == pytest.approx(decay, rel=0.01)


def pulled(good, poor, *weights):
    """The car after it was pulled over rails with these weights of the poor set."""
    profiles = tuple(lambda p, weight=weight: np.full_like(p, weight) for weight in weights)
    car = SteppedCar(route.lay(load_track("T5"), poor=profiles), 50.0, None, good, poor)
    car.step([2000.0] * 4, 1500)
    return car


def test_a_share_of_the_poor_set_blends_each_rail_from_good_to_poor():
    assert pulled("dry", "poor", 1.0, 1.0).state == pytest.approx(pulled("poor", "dry", 0.0, 0.0).state, rel=1e-12)
    slips = pulled("dry", "poor", 1.0, 0.0).outputs
    assert slips["front_le.sx"] < 1.5 * slips["front_ri.sx"] < 0


def test_jacobian_of_the_step_is_the_derivative_of_the_rate():
    """A wrong chain rule would lower the order, which a linear test problem does not show."""
    car = SteppedCar("T3", 280 / 3.6)
    car.step([300.0, -300.0, 150.0, -150.0], 700)
    x, (at, *inputs), h = ca.SX.sym("x", len(car.state)), car.inputs(), 1e-3
    rate = car.model.rate(x, *inputs)
    plain = ca.Function("plain", [x], [rodas3(rate, ca.jacobian(rate, x), x, h)])
    assert plain(at).nonzeros() == pytest.approx(car.model.step(at, *inputs, h).nonzeros(), rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("slope", [0.01, -0.01])
def test_the_brake_holds_the_car_on_a_gradient(slope):
    """Each wheel carries a quarter of the downhill force; up or down, the command is the same."""
    weight = (VEHICLE.body.mass + 2 * VEHICLE.gear.mass) * VEHICLE.gravity
    straight = Segment(300.0, (0.0, 0.0), (0.0, 0.0), (slope, slope))
    car = SteppedCar(route.lay(Track("gradient", build_table(Alignment("gradient", (straight,), None)))), 1.0)
    car.step(np.full(4, -4000.0), 5000)
    rest = car.outputs["front.p"]
    car.step(steps=5000)
    assert abs(car.outputs["front.v"]) < 1e-4 and abs(car.outputs["front.p"] - rest) < 1e-3
    held = weight * np.sin(slope) / 4 * VEHICLE.wheel.radius
    assert np.mean([car.outputs[f"{wheel}.tau"] for wheel in equations.WHEELS]) == pytest.approx(held, rel=5e-3)


def test_a_wheel_that_lifts_carries_nothing_and_the_run_stays_finite():
    car = SteppedCar("T5", 30.0)
    car.state[equations.INDEX["front.z"]] -= 0.02
    assert car.outputs["front_le.N"] == 0.0
    car.step(steps=3000)
    assert car.outputs["front_le.N"] > 5e4
