"""Comparisons: which experiments they run, and how their numbers are labelled."""

import pandas as pd
import pytest

from railrepro.data import InputError
from railrepro.evidence.claims import calibrated
from railrepro.studies import compare as comparison
from railrepro.studies.compare import compare
from railrepro.tuning import sets


@pytest.fixture
def asked(monkeypatch):
    """Experiments that a comparison runs, with rows and series of zeros in place of their results."""
    found = []

    def run_all(experiments, _title):
        found.extend(experiments)
        rows = [{"controller": one.controller, **one.label, "rmse_y": i} for i, one in enumerate(experiments)]
        zeros = dict.fromkeys(("front.p", "front.y", "front.y_ref", "front_ri.tau", "front_le.tau"), 0.0)
        return pd.DataFrame(rows), pd.DataFrame([row | zeros for row in rows])

    monkeypatch.setattr(comparison, "run_all", run_all)
    return found


def test_a_list_drives_each_of_its_values_and_labels_the_numbers(asked):
    runs = compare("sine_tracking", ["nmpc", "ndi"], ["paper", "loop"], speed_kmh=[80, 160], end_m=30.0)
    assert len(asked) == 8 and {one.scenario.end_m for one in asked} == {30.0}
    last = asked[-1]
    assert (last.controller, last.setting, last.scenario.speed_kmh) == ("ndi", "loop", 160)
    assert last.parameters == sets.load("ndi", "loop")["parameters"]
    assert runs.labels == ("setting", "speed_kmh", "controller")
    assert runs["rmse_mm"].loc[("loop", 160, "ndi")] == 7e3
    assert list(runs.table("rmse_mm").xs("ndi", level="controller")["rmse_mm"]) == [1e3, 3e3, 5e3, 7e3]


def test_a_list_with_one_value_is_a_label_as_with_two(asked):
    runs = compare(["sine_tracking"], {"NDI": "ndi"}, ["paper"], end_m=[30.0])
    assert runs.labels == ("setting", "scenario", "end_m", "case")
    assert list(runs["rmse_mm"].unstack("scenario")) == ["sine_tracking"]
    assert compare("sine_tracking", "ndi", end_m=30.0).labels == ("controller",)


@pytest.mark.parametrize("ask", [lambda runs: runs["rmse"], lambda runs: runs.plot("z"), lambda runs: runs.data("z")])
def test_an_unknown_quantity_or_panel_is_refused_with_the_known_ones(asked, ask):
    runs = compare("sine_tracking", ["ndi"])
    with pytest.raises(InputError, match="'(rmse|z)' is not known; there are"):
        ask(runs)


def test_a_variant_has_its_factor_on_r_and_its_own_fields(asked):
    low_gain, fine = {"controller": "nmpc", "r_times": lambda car: car.r_second}, {"controller": "ndi", "substeps": 2}
    runs, setup = compare("braking", {"a": low_gain, "b": fine}, car=calibrated.cars()), calibrated.cars()["calibrated"]
    r = setup.r_second * setup.parameters["nmpc"]["r"]
    assert asked[0].parameters["r"] == pytest.approx(r, rel=1e-12, abs=0.0) and asked[1].substeps == 2
    assert asked[0].scenario == setup.scenario("braking") and runs.labels == ("car", "case")


def test_sensors_belong_to_the_setting_loop_the_solver_to_nmpc_and_the_car_to_the_reader(asked):
    heavy = {"gear.mass": 2000.0}
    compare("sine_tracking", ["nmpc", "ndi"], ["paper", "loop"], solver="gauss_newton", noise_seed=7, vehicle=heavy)
    assert asked[0].car().gear.mass == 2000.0
    assert [one.sensors for one in asked] == [{}, {}, {"seed": 7}, {"seed": 7}]
    assert [one.options for one in asked] == [{"solver": "gauss_newton"}, {}] * 2


def test_a_figure_has_a_column_per_car_and_both_wheels_where_a_panel_shows_them(asked):
    runs = compare("curve_entry_T3", ["nmpc", "ndi"], car=calibrated.cars())
    axes = runs.plot("y", "torques", columns="car").axes
    assert len(axes) == 4 and len(axes[0].lines) == 3 and len(axes[3].lines) == 4
    assert list(runs.data("y")) == ["car", "setting", "controller", "p_m", "y_ref_m", "y_m"]
