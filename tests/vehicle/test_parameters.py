"""Vehicle data: derived quantities and refused input."""

import warnings

import pytest

from railrepro.vehicle.parameters import describe, load_vehicle, sample_ranges


def test_derived_quantities():
    vehicle = load_vehicle()
    assert vehicle.effective_yaw_inertia == pytest.approx(2319.0, abs=0.1)
    assert vehicle.effective_longitudinal_mass == pytest.approx(16567, abs=1)
    assert vehicle.gamma == pytest.approx(0.03386, abs=1e-5)
    assert vehicle.suspension.yaw_stiffness == 60e3


def test_every_parameter_tells_where_it_comes_from():
    table = describe()
    assert (table["source"].str.len() > 3).all()
    assert table["confidence"].isin(["VV", "V", "D", "R", "A"]).all()
    assert len(sample_ranges()) > 30


def test_a_cone_angle_of_wheels_that_are_no_cones_is_warned_of():
    with pytest.warns(UserWarning, match="wheel.cone_angle changes the control model only: .* profile 's1002'"):
        load_vehicle(**{"wheel.cone_angle": 0.03})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_vehicle(**{"wheel.cone_angle": 0.03, "contact.profile": "cone"})
        load_vehicle(**{"wheel.radius": 0.43})
