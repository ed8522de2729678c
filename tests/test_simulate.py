"""Co-simulation: whole runs, endings, warnings, scenario files."""

import numpy as np
import pytest

from railrepro.control.ndi import NDI
from railrepro.control.nmpc import NMPC
from railrepro.control.problem import MPCSettings
from railrepro.errors import InputError
from railrepro.simulation import metrics, scenarios, simulate
from railrepro.studies.experiment import Experiment
from railrepro.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def curve():
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=250)
    guidance = {"nmpc": NMPC, "ndi": NDI(pole=40, frequency=40)}
    return {name: simulate.run(scenario, how) for name, how in guidance.items()}


def test_preview_removes_the_delay(curve):
    assert metrics.delay(curve["nmpc"].series) < 0.5 * metrics.delay(curve["ndi"].series)


def test_runs_end_with_a_reason_and_without_warnings(curve):
    for run in curve.values():
        assert run.ended.startswith("end of the run")
        assert not run.failed
        assert run.warnings == ()
        assert np.isfinite(run.series.to_numpy()).all()


def test_two_runs_are_identical(curve):
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=250)
    assert simulate.run(scenario, NMPC).series.equals(curve["nmpc"].series)


def test_an_unguided_car_leaves_the_rail_and_the_run_says_so():
    run = simulate.run(scenarios.load_scenario("curve_entry_T2"), NDI(pole=1e-3, frequency=1e-3))
    assert run.failed
    assert "left the rail" in run.ended


def test_delay_of_a_shifted_signal_is_found():
    import pandas as pd

    p = np.arange(0, 600, 0.1)
    series = pd.DataFrame({"front.p": p, "front.y_ref": np.sin(p / 15), "front.y": np.sin((p - 4.0) / 15)})
    assert metrics.delay(series) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[a]\ntrack = "T5"\nspeed_kmh = 100\n', "lacks the key 'end_m'"),
        ('[a]\ntrack = "T5"\nspeed_kmh = -1\nend_m = 10\n', "speed_kmh = -1"),
        ('[a]\ntrack = "T5"\nspeed_kmh = 100\nend_m = 10\nspede = 1\n', "unknown key 'spede'"),
        ('[a]\ntrack = "T5"\nspeed_kmh = 100\nend_m = 10\npoor_share = [[0, 2]]\n', "outside 0 to 1"),
        ('[a]\ntrack = "T5"\nspeed_kmh = 100\nend_m = 10\nset_point = { kind = "saw" }\n', "kind 'saw'"),
        ('[a]\ntrack = "T5"\nspeed_kmh = 100\nend_m = 10\nset_point = { kind = "sine" }\n', "lacks"),
    ],
)
def test_wrong_scenarios_are_refused(tmp_path, text, sentence):
    file = tmp_path / "own.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=sentence):
        scenarios.load_scenarios(file)


def test_names_that_do_not_exist_are_refused():
    with pytest.raises(InputError, match="there are"):
        scenarios.load_scenario("curve_entry_T9")
    with pytest.raises(InputError, match="T9"):
        scenarios.load_scenario("sine_tracking").but(track="T9").route()
    with pytest.raises(InputError, match="beyond track"):
        scenarios.load_scenario("sine_tracking").but(end_m=9000).route()


def test_offset_observer_removes_the_drift_in_the_curve():
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=450.0)
    drift = []
    for observer in (0.0, 0.05):
        settings = MPCSettings(period=0.005, r=1e-11, observer=observer)
        run = simulate.run(scenario, lambda v, w, g, s=settings: NMPC(v, w, g, s, solver="rti"))
        drift.append(abs(np.mean(metrics.lateral_error(run.series)[-1500:])))
    assert drift[0] > 5e-4 > 5 * drift[1]


def test_a_controller_that_returns_nan_is_named():
    class Broken:
        period = 0.01

        def plan(self, x_hat, u_d):
            return np.nan if x_hat[0] > 5 else 0.0

    scenario = scenarios.load_scenario("sine_tracking").but(end_m=50.0)
    with pytest.raises(ArithmeticError, match=r"controller of the front gear returned nan at t = 0\.0\d0 s, p = "):
        simulate.run(scenario, lambda vehicle, way, gear: Broken())


def test_no_number_that_is_not_finite_leaves_a_run():
    light = load_vehicle(**{"suspension.link_stiffness": 5e6, "drive.lag": 0.002})
    state = simulate.run(scenarios.load_scenario("sine_tracking").but(end_m=30.0), NDI(900, 900), plant_vehicle=light)
    assert np.isfinite(state.series).all().all()


def test_irregular_track_moves_the_car():
    experiment = Experiment(
        scenarios.load_scenario("sine_tracking").but(end_m=150.0, set_point={"kind": "none"}),
        "ndi",
        parameters={"pole": 30.0, "frequency": 30.0, "damping": 1.0},
        irregular={"seed": 2},
    )
    assert experiment()[0]["rmse_y"] > 1e-5
