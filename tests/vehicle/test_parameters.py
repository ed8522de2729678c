"""Vehicle data: derived quantities."""

import pytest

from railrepro.vehicle.parameters import load_vehicle, sample_ranges


def test_derived_quantities():
    vehicle = load_vehicle()
    assert vehicle.effective_yaw_inertia == pytest.approx(2319.0, abs=0.1)
    assert vehicle.effective_longitudinal_mass == pytest.approx(16567, abs=1)
    assert vehicle.gamma == pytest.approx(0.03386, abs=1e-5)
    assert vehicle.suspension.yaw_stiffness == 60e3
    assert len(sample_ranges()) > 30


def test_a_cone_angle_of_wheels_that_are_no_cones_is_warned_of():
    with pytest.warns(UserWarning, match="wheel.cone_angle changes the control model only"):
        load_vehicle(**{"wheel.cone_angle": 0.03})
