"""Vehicle data: a choice without effect on the car; files that are edited."""

import pytest

from railrepro import data
from railrepro.vehicle.parameters import load_vehicle


def test_a_cone_angle_of_wheels_that_are_no_cones_is_warned_of():
    with pytest.warns(UserWarning, match="wheel.cone_angle changes the control model only"):
        load_vehicle(**{"wheel.cone_angle": 0.03})


def test_what_a_reader_does_to_the_content_of_a_file_and_a_new_file_under_its_name(tmp_path):
    """Parsed files are kept between runs: no reader gets what another one has changed, nor an old file."""
    file = tmp_path / "sets.toml"
    file.write_text("[a]\nb = 1\n")
    data.read(file)["a"]["b"] = 2
    assert data.read(file) == {"a": {"b": 1}}
    file.write_text("[a]\nb = 3\n")
    assert data.read(file) == {"a": {"b": 3}}
