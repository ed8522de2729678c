"""A rigid body on a curved, canted, inclined track against its motion in space; the direction of the normal force."""

from functools import cache

import casadi as ca
import numpy as np
import pytest

from railrepro.car.equations import CarParameters, parameter_vector
from railrepro.car.integrator import Stages
from railrepro.car.kinematics import COORDINATES, Body, Coordinates
from railrepro.car.wheel_rail import Contact
from railrepro.contact.table import contact_table
from railrepro.quantities import symbols, unpack
from railrepro.track.irregularity import CHANNELS
from railrepro.track.route import COLUMNS, irregularity_in
from railrepro.vehicle.parameters import load_vehicle

CELL = {"p": 20.0, "psi": 0.4, "kappa": 6e-3, "dkappa": 3e-4, "phi": 0.08, "dphi": 4e-3, "eps": -0.05, "deps": 2e-3}
CELL |= {"x": 100.0, "y": -7.0, "z": 3.0, "lateral": 2e-3, "dlateral": 1e-3, "vertical": -1e-3, "dvertical": 3e-3}
CELL |= {"crosslevel": 1e-3, "dcrosslevel": -2e-3, "poor_le": 0.3, "poor_ri": 0.9}
ROW = np.array([CELL.get(name, 0.0) for name in COLUMNS])
STATE = {"s": 20.3, "y": 0.4, "z": -1.2, "psi": 0.3, "pitch": 0.2, "phi": -0.4, "vx": 30.0, "vy": 1.5, "vz": -0.8}
STATE |= {"wx": 0.5, "wy": -0.7, "wz": 1.1}
X = np.array([STATE[name] for name in COORDINATES])
MASS, INERTIA, SPIN = 2000.0, np.array([800.0, 1500.0, 1900.0]), -3000.0
FORCE, MOMENT = np.array([900.0, -4000.0, 7000.0]), np.array([300.0, 500.0, -800.0])
H = 1e-6


@cache
def body_function():
    x, state = symbols(Coordinates, "x")
    body = Body(state, ca.SX(ca.DM(ROW)))
    rates = body.derivatives(ca.DM(FORCE), ca.DM(MOMENT), MASS, ca.DM(INERTIA), SPIN)
    return ca.Function("body", [x], [rates, body.position, body.attitude, body.section.rotation])


def at(x):
    """Rates, position and attitude of the body in the state x, rotation of the track frame."""
    return [np.array(value).squeeze() for value in body_function()(x)]


RATES = at(X)[0]


def over_time(quantity):
    """Time derivative of a quantity of the state along the rates of the body."""
    return (quantity(X + H * RATES) - quantity(X - H * RATES)) / (2 * H)


def part(x, *names):
    return x[[COORDINATES.index(name) for name in names]]


def momentum(x):
    return at(x)[3] @ (MASS * part(x, "vx", "vy", "vz"))


def angular_momentum(x):
    """In space, with that of the rotors."""
    return at(x)[2] @ (INERTIA * part(x, "wx", "wy", "wz") + [0, SPIN, 0])


def test_a_body_obeys_newton_and_euler_in_space():
    """Inside a cell the position is an expansion of third order, good to 2e-6 of the speed at 0.3 m."""
    _, _, attitude, track = at(X)
    assert over_time(lambda x: at(x)[1]) == pytest.approx(track @ part(X, "vx", "vy", "vz"), rel=2e-6)
    assert over_time(momentum) == pytest.approx(track @ FORCE, rel=1e-6)
    assert over_time(angular_momentum) == pytest.approx(attitude @ MOMENT, rel=1e-6)


@pytest.mark.parametrize(("side", "sign"), [("le", -1), ("ri", 1)])
def test_the_normal_force_is_square_to_a_rail_that_climbs_on_a_cant_ramp(side, sign):
    """The rail's direction is the derivative of its position in space; wheels slide along it without friction."""
    vehicle = load_vehicle(**{"contact.profile": "cone", "adhesion.dry.mu0": 1e-9, "adhesion.poor.mu0": 1e-9})
    par = unpack(CarParameters, parameter_vector(vehicle))
    profile = contact_table("cone", vehicle)
    here = dict.fromkeys(STATE, 0.0) | {"s": STATE["s"], "y": 1e-3, "psi": 2e-3, "pitch": 0.01, "phi": 1e-3}
    here["z"] = 1e-3 - vehicle.wheel.radius
    x, state = symbols(Coordinates, "x")
    stages, gear = Stages(), Body(state, ca.SX(ROW))
    cell = ca.SX(profile.cells()[np.abs(profile.frame["shift_m"]).argmin()])
    contact = Contact(gear, side, ca.SX(65.0), cell, par, stages)
    results = ca.Function("contact", [x], [stages.resolve(contact.force), gear.section.rotation])
    force, rotation = (np.array(value).squeeze() for value in results(list(here.values())))

    def rail(s):
        of_cell, half = dict(zip(COLUMNS, ROW, strict=True)), sign * par.gear.contact_base / 2
        lateral, vertical, crosslevel = (irregularity_in(of_cell, name, s)[0] for name in list(CHANNELS)[:3])
        moved = here | {"s": s, "y": half + lateral, "z": vertical + half * crosslevel}
        return at(np.array(list(moved.values())))[1]

    along = rotation.T @ (rail(here["s"] + 1e-4) - rail(here["s"] - 1e-4)) / 2e-4
    assert abs(along[2]) > 1e-3 and force[2] < -1e4
    assert force @ along == pytest.approx(0.0, abs=1e-5 * np.linalg.norm(force))
