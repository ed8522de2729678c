"""The adhesion law on bare wheels."""

import numpy as np
import pytest

from railrepro.contact.creep import adhesion_maximum
from railrepro.contact.table import middle_patch
from railrepro.control.adhesion import AdhesionSettings
from railrepro.simulation import bare_wheel
from railrepro.vehicle.parameters import load_vehicle


@pytest.mark.parametrize("sign", [1, -1])
def test_a_bare_wheel_comes_to_its_set_point_or_to_its_maximum_and_moves_its_share_of_the_car(sign):
    vehicle, law = load_vehicle(), AdhesionSettings()
    poor = vehicle.adhesion["poor"]
    run = bare_wheel.simulate(
        vehicle, [bare_wheel.Case(law, poor)] * 2, 400 / 3.6, sign * np.tile([0.05, 0.2], (6000, 1))
    )
    late = sign * run.adhesion[-2000:]
    assert np.abs(late[:, 0] - 0.05).max() < 2 * law.corridor
    load, patch = vehicle.wheel_load, (*middle_patch(vehicle), vehicle.contact.shear_modulus)
    peak, _ = adhesion_maximum(poor, 400 / 3.6, load, *patch)
    assert late[:, 1].max() == pytest.approx(peak, rel=0.01) and late[:, 1].mean() > 0.9 * peak
    assert np.abs(run.slip[:, 1]).max() < 0.06
    gained = 1e-3 * 9.81 * np.cumsum(run.adhesion[:, 0])  # v' = g f
    assert run.speed[1:, 0] - 400 / 3.6 == pytest.approx(gained[:-1], abs=2e-2) and np.abs(gained).max() > 2.0
