"""Where the order turns: each axis moves one thing, its nominal value moves nothing, and a lost run has no error."""

import numpy as np
import pandas as pd
import pytest

from railrepro.evidence.runs import tuning
from railrepro.evidence.uncertainty import order
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.alignment import alignments
from railrepro.vehicle.parameters import load_vehicle

SCENARIO = load_scenario(order.SCENARIO)


def built(axis, value, controller="ndi"):
    return order.experiments(axis, value, "equal", controller)[0]


@pytest.mark.parametrize("acceleration", [0.0, 0.4333, 1.0])
def test_cant_leaves_the_unbalanced_acceleration_and_moves_nothing_else(acceleration):
    before = alignments()["T3"]
    start, ramp, arc = order.canted(before, acceleration).segments
    assert before.design_speed**2 * arc.kappa[0] - 9.81 * np.sin(arc.phi[0]) == pytest.approx(acceleration)
    assert ramp.phi == (0.0, arc.phi[0]) and arc.phi[0] == arc.phi[1] and start == before.segments[0]
    assert [s.length for s in (start, ramp, arc)] == [s.length for s in before.segments]
    assert ramp.kappa == before.segments[1].kappa
    if acceleration == 0.4333:
        assert arc.phi == pytest.approx(before.segments[2].phi)


def test_bandwidth_moves_all_poles_of_an_inversion_by_one_factor():
    tuned, moved = tuning.load("ndi", "equal")["parameters"], built("bandwidth", 2.0).parameters
    assert moved["pole"] == 2 * tuned["pole"] and moved["frequency"] == 2 * tuned["frequency"]
    assert moved["damping"] == tuned["damping"]
    assert built("bandwidth", 2.0, "nmpc").parameters == tuning.load("nmpc", "equal")["parameters"]


@pytest.mark.parametrize(
    ("axis", "value"),
    [("bandwidth", 1.0), ("unbalanced acceleration", 0.4333), ("creep stiffness", 1.0), ("car", "S1002")],
)
def test_a_nominal_value_moves_nothing(axis, value):
    assert value in order.AXES[axis][1]
    one = built(axis, value)
    assert one.parameters == tuning.load("ndi", "equal")["parameters"]
    assert one.car() == load_vehicle() and not one.sensors and not one.vehicle and one.scenario == SCENARIO


def test_delay_and_noise_begin_where_the_filter_ends_and_the_rest_is_that_of_the_car():
    assert built("creep stiffness", 4.0).car().contact.shear_modulus == 4 * load_vehicle().contact.shear_modulus
    assert built("delay", 2.0).sensors == {"perfect": True, "inverter.delay": pytest.approx(2e-3)}
    noise = order.experiments("noise", 2.0, "equal", "ndi")[1].sensors
    assert noise["seed"] == 102 and noise["gyro.noise"] == pytest.approx(2 * 0.004)
    silent = {key for key, value in noise.items() if value == 0.0}
    assert {"lateral.bias", "gyro.bias", "position.bias", "latency.measurement", "latency.command"} <= silent


def test_a_run_that_leaves_the_rail_has_no_error(tmp_path, monkeypatch):
    cone = {"contact.profile": "cone"}  # no flange holds it
    monkeypatch.setattr(order, "changed", lambda axis, value: {"plant": cone})
    monkeypatch.setattr(order, "AXES", {"bandwidth": ("-", (1.0, 4.0))})
    monkeypatch.setattr(order, "SETTINGS", ("paper",))
    monkeypatch.setattr(order, "CONTROLLERS", ("nmpc", "ndi"))
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    order.main()
    held, lost = pd.read_csv(tmp_path / "data/results/order_turns.csv").to_dict("records")
    assert not held["failed"] and 0 < held["rmse_mm"] < 5 and held["ended"].startswith("end of the run")
    assert lost["failed"] and "derailed" in lost["ended"] and np.isnan(lost["rmse_mm"])
