"""Vehicles whose numbers other people published come out of our car, and so do those of an independent linear model."""

from functools import partial

import numpy as np
import pandas as pd
import published
import pytest
from exudyn_car import patch
from published import critical_speed, lateral

from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.vehicle.parameters import load_vehicle

RIGID = {"contact.profile": "cone", "gear.axle_damping": 1e8}


def test_published_vehicles_have_their_published_numbers_and_those_of_the_committed_table():
    """The lab wheelset by Routh's condition at 48.558 m/s; the bogie at 68.66 m/s, not the 66.61 often cited."""
    found = published.comparison()
    committed = pd.read_csv(paths.source("data/results/published_vehicles.csv"))
    assert found.iloc[:, :2].equals(committed.iloc[:, :2])
    assert found["published"].tolist() == pytest.approx([49.027, 26.272, 48.558, 26.133, 68.66, 0.6, 29.2], rel=2e-5)
    assert found["ours"].tolist() == pytest.approx(committed["ours"].tolist(), rel=1e-6)
    assert published.bump_stop_force()[[0, 3]] == pytest.approx([0.0, 33.97], abs=0.05)  # the metal contact has 230 kN
    assert ((found["ours"] / found["published"] - 1).abs() < found["limit"]).all()


# Our own car with rigid axles on cones, against a linear model of body and wheelsets: y, psi, phi each.


def stiffness_at_rest(vehicle):
    """f11, f22, f23, f33 (N, N, N m, N m2) of a wheel at nominal load: Kalker's, reduced; spin gives a direction."""
    a, b, (c11, c22, c23, c33) = patch(vehicle)
    rail, turned = vehicle.adhesion["dry"], np.sqrt(a * b)
    unit = vehicle.contact.shear_modulus * a * b * (rail.k_a + rail.k_s) / 2
    return unit * np.array([c11, c22, turned * c23, turned**2 * c33])


def nine_degrees_of_freedom(vehicle, speed):
    """State matrix of the car with rigid axles on cones, shape (18, 18): by hand, for small motion.

    The force of a wheel on its inclined rail, its lever about the axle and its load each change with the motion; the
    spring and damper of Hertz let the wheelset roll. Weight hangs on the springs. Source: Wickens 2003, ch. 2 and 3.
    """
    body, gear, wheel, spring, contact = vehicle.body, vehicle.gear, vehicle.wheel, vehicle.suspension, vehicle.contact
    f11, f22, f23, f33 = stiffness_at_rest(vehicle)
    half, radius, sin, cos = gear.contact_base / 2, wheel.radius, np.sin(wheel.cone_angle), np.cos(wheel.cone_angle)
    carried = (body.mass / 4 + gear.mass / 2) * vehicle.gravity
    push, twist = f23 * sin / radius, f33 * sin / radius  # what spin does to a wheel that rolls straight on
    normal = (carried - push * sin) / cos
    hertz = 1.5 * contact.normal_stiffness ** (2 / 3) * normal ** (1 / 3)
    turn = speed / radius
    above, below = spring.height - radius, body.cg_height - spring.height
    hung = body.mass * vehicle.gravity / 2

    def wheelset(y, psi, phi, vy, wz, wx):
        """Lateral force, yaw and roll moment of both rails."""
        change = hertz * (sin * (y - radius * phi) + cos * half * phi)
        change += normal * contact.normal_damping * (sin * (vy - radius * wx) + cos * half * wx)
        creepage = cos * (vy - radius * wx - speed * psi) - sin * (wx * half + speed * psi * np.tan(wheel.cone_angle))
        creepage, spin = creepage / speed, cos * wz / speed
        across = push / normal * change - f22 * creepage - f23 * spin
        force = 2 * (-change * sin + (normal * cos + push * sin) * phi + across * cos)
        roll = 2 * half * (-change * cos - normal * phi * sin + push * phi * cos - across * sin)
        roll += 2 * carried * y - radius * force
        yaw = 2 * (push * cos - normal * sin) * (radius * np.tan(wheel.cone_angle) - half) * psi
        yaw -= 2 * half**2 * f11 * (wz - turn * phi) / speed
        yaw += 2 * cos * (4 / 3 * twist / normal * change + f23 * creepage - f33 * spin) + 2 * twist * sin * phi
        return force, yaw, roll

    def acceleration(q, v):
        rates, gyroscope = np.zeros(9), 2 * wheel.spin_inertia * turn
        (yb, pb, rb), (vb, wb, ub) = q[:3], v[:3]
        for i, end in ((3, 1), (6, -1)):
            (y, psi, phi), (vy, wz, wx), lever = q[i : i + 3], v[i : i + 3], end * body.gear_spacing / 2
            gap = yb + lever * pb - below * rb - y - above * phi
            pull = 2 * spring.k_y * gap - hung * phi
            pull += 2 * spring.c_y * (vb + lever * wb - below * ub - vy - above * wx)
            steer = spring.yaw_stiffness * (pb - psi) + spring.yaw_damping * (wb - wz)
            tilt = spring.roll_stiffness * (rb - phi) + spring.roll_damping * (ub - wx)
            rates[0] -= pull / body.mass
            rates[1] -= (lever * pull + steer) / body.inertia_z
            rates[2] += (below * pull + hung * below * rb - tilt) / body.inertia_x
            force, yaw, roll = wheelset(y, psi, phi, vy, wz, wx)
            rates[i] = (force + pull) / gear.mass
            rates[i + 1] = (yaw + steer + gyroscope * wx) / gear.inertia_z
            rates[i + 2] = (roll + tilt + above * pull + hung * (gap + above * phi) - gyroscope * wz) / gear.inertia_x
        return rates

    unit, zero = np.eye(9), np.zeros(9)
    stiff = np.array([acceleration(q, zero) for q in unit]).T
    return np.block([[0 * unit, unit], [stiff, np.array([acceleration(zero, v) for v in unit]).T]])


def rolling(vehicle, speed):
    """Our car after half a second."""
    car = SteppedCar("T5", speed, vehicle)
    car.step(steps=500)
    return car


@pytest.mark.parametrize(
    ("k_x", "c_x", "cone", "low", "high"),
    [(3e5, 5e3, 0.025, 50, 62), (1e6, 1e3, 0.025, 100, 122), (1e6, 1e3, 0.05, 65, 80)],
)
def test_car_with_rigid_axles_hunts_as_nine_degrees_of_freedom_say(k_x, c_x, cone, low, high):
    own = {"suspension.k_x": k_x, "suspension.c_x": c_x, "wheel.cone_angle": cone}
    vehicle = load_vehicle(**RIGID | own)
    expected = critical_speed(partial(nine_degrees_of_freedom, vehicle), low - 5, high + 5)
    ours = critical_speed(
        lambda speed: lateral(rolling(vehicle, speed).linearise().a, "body", "front", "rear"), low, high
    )
    assert ours == pytest.approx(expected, rel=5e-3)
