"""Moment of the creep forces about the contact normal: Kalker's coefficients, reduction, effect on the car."""

import numpy as np
import pytest
from rolling import rolling

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.contact import creep
from railrepro.vehicle.parameters import load_vehicle

A, B, LOAD, SHEAR = 6e-3, 5e-3, 78.5e3, 8.2e10
KALKER = creep.kalker_coefficients(A / B)


def moment(nu_x, nu_y, spin, k_s=1.0):
    law = (1.0, k_s, 0.4, 1.0, 0.0, 0.0)
    return float(creep.spin_moment(nu_x, nu_y, spin, LOAD, A, B, *KALKER, SHEAR, *law))


def test_spin_coefficient_meets_the_table_and_the_slender_limits():
    assert creep.kalker_coefficients([0.1, 1.0, 2.0], 0.25)[3] == pytest.approx([8.28, 1.19, 0.819], rel=1e-12)
    # Patches that are slender across: pi^2 b/(16 (1 - nu) a); along, without Poisson's effect: pi/4.
    for poisson in (0.0, 0.25):
        slender = np.pi**2 / 16 / (1 - poisson) / 0.1
        assert creep.kalker_coefficients(0.1, poisson)[3] == pytest.approx(slender, rel=0.05)
    assert creep.kalker_coefficients(10.0, 0.0)[3] == pytest.approx(np.pi / 4, rel=0.02)


def test_small_creepage_gives_kalkers_moment():
    area = A * B
    assert moment(0, 1e-6, 0) == pytest.approx(SHEAR * area**1.5 * KALKER[2] * 1e-6, rel=0.01)
    assert moment(0, 0, 1e-4) == pytest.approx(-SHEAR * area**2 * KALKER[3] * 1e-4, rel=0.01)
    assert moment(1e-6, 0, 0) == 0.0


@pytest.mark.parametrize("nu_y", [1e-4, 5e-4, 1e-3, 2e-3, 3e-3, 5e-3])
def test_moment_of_lateral_creepage_fades_as_on_half_spaces(nu_y):
    """Without the fade it is 1.03, 1.18, 1.39, 1.9, 9 times that of CONTACT at .1, .5, 1, 2, 5 per mille."""
    assert moment(0, nu_y, 0) == pytest.approx(rolling((0, nu_y, 0), LOAD, A, B, 0.4, count=26)[2], rel=0.12, abs=2.5)


def test_mirrored_creepage_mirrors_the_moment():
    for k_s in (0.4, 1.0):
        assert moment(1e-3, -2e-3, 0.1, k_s) == -moment(1e-3, 2e-3, -0.1, k_s) == moment(-1e-3, -2e-3, 0.1, k_s)


def test_sliding_takes_the_moment_away():
    assert abs(moment(0.05, 0.0, 0.06)) < 0.1 * abs(moment(1e-6, 0.0, 0.06))
    assert abs(moment(0.0, 0.0, 5.0)) < 0.6 * 0.4 * LOAD * np.sqrt(A * B)


def test_moment_turns_the_carrier():
    """A gear that drifts sideways on cones without cone angle: only the moments of its wheels turn it."""
    own = {"contact.profile": "cone", "wheel.cone_angle": 1e-6, "adhesion.dry.b_decay": 0.0}
    vehicle = load_vehicle(**own)
    car = SteppedCar("T5", 50.0, vehicle)
    drift = 1e-5 * 50.0
    for name in ("front.vy", "rear.vy", "body.vy"):
        car.state[equations.INDEX[name]] = drift
    rate = np.array(equations.car().rate(*car.inputs())).ravel()
    out, table = car.outputs, car.table.frame.iloc[0]
    area = table["semi_axis_x_m"] * table["semi_axis_y_m"]
    adhesion = vehicle.adhesion["dry"]
    reduced = (adhesion.k_a + adhesion.k_s) / 2
    linear = reduced * vehicle.contact.shear_modulus * area**1.5 * table["c23"] * out["front_le.nu_y"]
    turning = rate[equations.INDEX["front.wz"]] * vehicle.gear.inertia_z
    assert out["front_le.nu_y"] == pytest.approx(1e-5, rel=1e-3)
    assert turning == pytest.approx(2 * linear, rel=0.02)
