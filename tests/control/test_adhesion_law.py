"""The adhesion law on bare wheels: both directions, the bound of its step, robustness; and on the car."""

from dataclasses import replace

import numpy as np
import pytest

from railrepro.contact.creep import adhesion_maximum
from railrepro.contact.table import middle_patch
from railrepro.control.adhesion import AdhesionSettings
from railrepro.simulation import bare_wheel
from railrepro.vehicle.parameters import load_vehicle

LAW = AdhesionSettings()


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


@pytest.mark.parametrize("sign", [1, -1])
def test_set_point_and_maximum_in_both_directions(vehicle, sign):
    cases = [bare_wheel.Case(LAW, vehicle.adhesion["poor"])] * 2
    demand = sign * np.tile([0.05, 0.2], (6000, 1))
    run = bare_wheel.simulate(vehicle, cases, 400 / 3.6, demand)
    late = sign * run.adhesion[-2000:]
    assert np.abs(late[:, 0] - 0.05).max() < 2 * LAW.corridor
    load, patch = vehicle.wheel_load, (*middle_patch(vehicle), vehicle.contact.shear_modulus)
    peak, _ = adhesion_maximum(vehicle.adhesion["poor"], 400 / 3.6, load, *patch)
    assert late[:, 1].max() == pytest.approx(peak, rel=0.01) and late[:, 1].mean() > 0.9 * peak
    assert np.abs(run.slip[:, 1]).max() < 0.06


@pytest.mark.parametrize(("ratio", "follows"), [(0.6, False), (1.5, True)])
def test_the_step_must_beat_the_rate_of_the_set_point(vehicle, ratio, follows):
    load = (vehicle.body.mass / 2 + vehicle.gear.mass) * vehicle.gravity / 2
    rate = 0.04
    step = ratio * 1e-3 * vehicle.wheel.radius * load * rate
    triangle = 0.02 + 0.04 * np.abs(((np.arange(6000) / 2000 + 0.5) % 1) * 2 - 1)
    law = replace(LAW, raise_step=step, lower_step=step)
    run = bare_wheel.simulate(vehicle, [bare_wheel.Case(law, vehicle.adhesion["dry"])], 50.0, triangle)
    error = np.sqrt(np.mean((run.adhesion[3000:, 0] - triangle[3000:]) ** 2))
    assert (error < 1.5 * LAW.corridor) == follows


def test_a_bare_wheel_carries_its_share_of_the_car(vehicle):
    """Newton for the mass on one wheel: v' = g f, summed over a second of traction and one of braking."""
    demand = np.repeat([0.05, -0.05], 1000)
    run = bare_wheel.simulate(vehicle, [bare_wheel.Case(LAW, vehicle.adhesion["dry"])], 20.0, demand)
    gained = 1e-3 * 9.81 * np.cumsum(run.adhesion[:, 0])
    assert run.speed[1:, 0] - 20.0 == pytest.approx(gained[:-1], abs=2e-3) and gained.max() > 0.2
