"""Creep slope over load: patch area with the power 2/3, in the Hertzian formulas and in the contact of the car."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.contact import normal
from railrepro.contact.table import cone_patch
from railrepro.vehicle.parameters import load_vehicle

# No spin, so each creepage makes its own force only.
VEHICLE = load_vehicle(**{"contact.profile": "cone", "wheel.cone_angle": 1e-6})
DRY = VEHICLE.adhesion["dry"]
SPEED, CREEPAGE = 50.0, 2e-6


@pytest.mark.parametrize(("along", "across"), [(2.0, 1.5), (1.5, 2.0), (2.0, 20.0)])
def test_hertzian_patch_grows_with_the_third_root_of_the_load(along, across):
    modulus = normal.contact_modulus(VEHICLE.contact.young, VEHICLE.contact.poisson)
    small, large = (np.array(normal.hertz(along, across, load, modulus)) for load in (4e4, 8e4))
    assert large / small == pytest.approx([2 ** (1 / 3), 2 ** (1 / 3), 2 ** (2 / 3)], rel=1e-12)
    assert (small[0] < small[1]) == (along > across)


def probe(sink, creepage_x=0.0, creepage_y=0.0):
    """Loads and creep forces of the front wheels; the carrier is sunk into the rail (m) and creeps a little."""
    car = SteppedCar("T5", SPEED, VEHICLE)
    car.parameters[equations.PARAMETERS.index("contact.normal_damping")] = 0.0
    place = {name: i for i, name in enumerate(equations.STATES)}
    car.state[place["front.z"]] += sink
    car.state[place["front.vy"]] = creepage_y * SPEED
    out = car.outputs
    for side in ("le", "ri"):
        rolled = SPEED / out[f"front_{side}.w"] * (1 - out[f"front_{side}.nu_x"])  # rolling radius of the sunk wheel
        car.state[place[f"w.front_{side}"]] = SPEED * (1 - creepage_x) / rolled
    out = car.outputs
    return {
        name: np.array([out[f"front_{side}.{name}"] for side in ("le", "ri")])
        for name in ("N", "Fx", "Fy", "nu_x", "nu_y")
    }


@pytest.mark.parametrize("sink", [-40e-6, 0.0, 60e-6])
def test_creep_slope_of_the_car_follows_the_patch_under_its_load(sink):
    a, b, (c11, c22, *_) = cone_patch(VEHICLE)
    along, across = probe(sink, creepage_x=CREEPAGE), probe(sink, creepage_y=CREEPAGE)
    area = a * b * (along["N"] / VEHICLE.contact.nominal_load) ** (2 / 3)
    linear = VEHICLE.contact.shear_modulus * area * (DRY.k_a + DRY.k_s) / 2
    assert -along["Fx"] / along["nu_x"] == pytest.approx(linear * c11, rel=0.01)
    # What spin is left has opposite forces left and right.
    assert -np.mean(across["Fy"] / across["nu_y"]) == pytest.approx(linear[0] * c22, rel=0.01)


def test_normal_force_of_the_car_follows_hertz():
    loads = np.array([probe(sink)["N"].mean() for sink in (0.0, 30e-6, 60e-6)])
    penetration = (loads / VEHICLE.contact.normal_stiffness) ** (2 / 3)
    assert np.diff(penetration) == pytest.approx(30e-6, rel=1e-6)
    assert loads[0] == pytest.approx((VEHICLE.body.mass / 4 + VEHICLE.gear.mass / 2) * VEHICLE.gravity, rel=1e-6)
