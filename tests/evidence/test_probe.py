"""Metrics of a probe on runs made by hand, and one small probe of the car that decides statements."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from railrepro.control.registry import LOOP, PAPER_TRIO
from railrepro.evidence.claims import probe, statements
from railrepro.evidence.claims.setup import COLUMNS, SWARM, setting_of, setup
from railrepro.simulation.scenarios import load_scenario
from railrepro.tuning import sets
from railrepro.vehicle.parameters import load_vehicle


@pytest.mark.parametrize(
    ("later", "noise", "alike"), [(5.0, 0.0, 1.0), (0.75, 0.0, 1.0), (-12.0, 0.0, 1.0), (5.0, 0.9, 0.6)]
)
def test_the_lag_of_a_torque(later, noise, alike):
    p = np.arange(0.0, 650.0, 0.5)
    first, second = (np.sin(x / 15 + 4 * np.sin(x / 100)) for x in (p, p - later))
    second += np.random.default_rng(5).normal(0, noise, p.size)
    found = probe.torque_shift(*(pd.DataFrame({"front.p": p, "front.du": du}) for du in (first, second)))
    assert found["ndi_later"] == pytest.approx(later, abs=0.26)
    assert found["ndi_alike"] == pytest.approx(alike, abs=0.1)


@pytest.mark.parametrize("side", [1, -1])
def test_the_torque_over_the_first_wave_less_the_torque_before(side):
    """A wave from 20 to 120 m, over which the torque of tracking has no mean."""
    p = np.arange(0.0, 400.0)
    reference = side * np.where(p < 20, 0.0, np.sin(2 * np.pi * (p - 19.5) / 100))
    du = np.select([p < 20, p < 120], [30.0, 10.0 + 500 * reference], -1e4)
    found = probe.torque_step(pd.DataFrame({"front.p": p, "front.y_ref": reference, "front.du": du}))
    assert found == pytest.approx(-20.0, abs=2)


@pytest.mark.parametrize("side", [1, -1])
def test_shortfall_at_the_crests_of_the_worse_side(side):
    reference = side * 1e-3 * np.array([3.0, 2.6, -3.0, -2.6, 2.4, 0.0])
    y = reference - side * 1e-3 * np.array([0.5, 0.7, -0.1, -0.3, 9.0, 9.0])
    assert probe.shortfall(pd.DataFrame({"front.y_ref": reference, "front.y": y})) == pytest.approx(0.6e-3)
    assert probe.shortfall(pd.DataFrame({"front.y_ref": reference, "front.y": 1.1 * reference})) < 0


def test_yaw_against_the_track_over_its_heading():
    heading = np.linspace(0.0, 0.1, 50)
    rows = pd.DataFrame({"front.psi_Ax": heading, "front.psi_TrAx": 0 * heading})
    assert probe.path_error(rows) == 0.0
    assert probe.path_error(rows.assign(**{"front.psi_Ax": 0.0, "front.psi_TrAx": -heading})) == pytest.approx(1.0)


@pytest.mark.parametrize(("gain", "noise", "growth"), [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (0.7, 2.0, 2.0)])
def test_an_oscillation_about_the_set_point(gain, noise, growth):
    """Three waves of the set point from 240 m on; an error of another wavelength that may grow with the way."""
    p = np.arange(0.0, 690.0, 0.5)
    reference = 2e-3 * np.sin(2 * np.pi * p / 150)
    wobble = 1e-3 * noise * np.sin(2 * np.pi * p / 15) * np.where(p < 465, 1.0, growth)
    y = np.where(p < 240, 9.0, gain * reference + wobble)
    found = probe.oscillation(pd.DataFrame({"front.p": p, "front.y_ref": reference, "front.y": y}))
    assert found["set_point_gain"] == pytest.approx(gain, abs=0.02)
    assert found["error_growth"] == pytest.approx(growth, rel=0.15)


def test_a_mean_fails_if_one_of_the_perturbed_runs_fails():
    found = probe._mean([{"failed": 0.0, "rmse_y": 1.0, "a": 1.0}, {"failed": 0.0, "rmse_y": 3.0, "a": 2.0}])
    assert found == {"failed": 0.0, "rmse_y": 2.0, "a": 1.5}
    assert probe._mean([found, {"failed": 1.0, "a": 2.5}]) == {"failed": 1.0, "a": 2.0}


@pytest.mark.parametrize(("shares", "enough"), [(probe.SHARES, True), ((0.0, 0.02, 0.07), False)])
def test_the_smallest_fixed_share_is_found_by_halving(shares, enough, monkeypatch):
    """Guidance needs 7.5 % of the torque; a large share lengthens the distance, and the error grows again."""

    def braked(_world, fixed_share=0.1):
        error = 1.05e-3 if 0.075 <= fixed_share < 0.2 else 5e-3
        return {"rmse_y": error, "stopping_distance": 1000 / (1 - fixed_share)}

    monkeypatch.setattr(probe, "_braked", braked)
    monkeypatch.setattr(probe, "SHARES", shares)
    found = probe._allocated(setup({}))
    assert enough == (found["rmse_y"] < np.inf)
    assert not enough or 0.075 <= found["share"] < 0.078 and found["stopping_distance"] == pytest.approx(1082, abs=3)


@pytest.mark.parametrize(("speed", "failed", "way"), [(0.1, False, 900.0), (0.3, False, np.inf), (0.1, True, np.inf)])
def test_a_run_that_does_not_stop_has_no_stopping_distance(speed, failed, way):
    row = {"rmse_y": 1e-3, "stopping_distance": 900.0}
    run = SimpleNamespace(failed=failed, series=pd.DataFrame({"front.v": [50.0, speed]}))
    found, _ = probe.braked(run, SimpleNamespace(values=lambda _: row))
    assert found == {"rmse_y": 1e-3 if way == 900.0 else np.inf, "stopping_distance": way}


def macro_slips(adhesion, slip, torque=lambda t: 1000.0 - 200 * (t > 1) - 200 * (t > 2)):
    """4 s at 100 m/s from 240 m on, a row per 10 ms; adhesion of both wheels, slip of the left one."""
    t = 0.01 * np.arange(400)
    columns = {"t_s": t, "front.p": 240 + 100 * t, "front.u_d": torque(t), "front_ri.sx": 0.0, "front_le.sx": -slip(t)}
    columns |= dict.fromkeys(("front_ri.adhesion", "front_le.adhesion"), adhesion(t))
    return probe.macro_slips(pd.DataFrame(columns), 0.1, 0.02)


def test_macro_slips_with_recovery_and_approaches():
    """Slips of 0.1 s after 0.95 s and of 0.3 s after 1.9 s; the peak is approached before both, and at the end."""

    def slip(t):
        return 0.03 * (((t > 0.95) & (t < 1.05)) | ((t > 1.9) & (t < 2.3)))

    found = macro_slips(lambda t: 0.1 * (np.mod(t, 1) > 0.8) * (slip(t) == 0), slip)
    assert found == {"macro_slips": 2, "recovered": 1, "approaches": 3, "approached": 3}
    held = macro_slips(lambda t: 0.1 * ((t > 0.8) & (t < 1)) * (slip(t) == 0), slip, lambda t: 1000.0 + 0 * t)
    assert (held["approaches"], held["approached"]) == (3, 1), "1.7 s are enough for another approach"
    assert held["recovered"] == 0, "the torque does not fall"


@pytest.mark.parametrize(
    ("adhesion", "slip", "expected"),
    [
        (lambda t: 0.09001 * (t < 3), lambda t: 0.03 * ((t > 3.0) & (t < 3.05)), (1, 0, 1, 1)),  # the end cuts the last
        (lambda t: 0.0899 + 0 * t, lambda t: 0 * t, (0, 0, 1, 0)),
        (lambda t: 0.1 + 0 * t, lambda t: 0.03 + 0 * t, (1, 0, 1, 0)),
    ],
)
def test_an_approach_counts_when_it_comes_near_the_peak_without_macro_slip(adhesion, slip, expected):
    assert tuple(macro_slips(adhesion, slip).values()) == expected


def test_excessive_slip_lies_on_the_falling_branch():
    scenario, car = load_scenario("adhesion_loss"), load_vehicle()
    peak, slip = probe.adhesion_peak(scenario, car)
    assert 0.09 < peak < 0.11 and slip == pytest.approx(0.018, abs=1e-3)
    assert probe.excessive_slip(scenario, car) == pytest.approx(0.040, abs=1e-3)


def test_deviation_in_regular_operation():
    rows = pd.DataFrame({"front.p": [10.0, 110.0, 129.0, 130.0], "front.f_star": 0.05})
    rows = rows.assign(**{"front_ri.adhesion": [9.0, 0.05, 0.06, 9.0], "front_le.adhesion": [9.0, 0.04, 0.07, 9.0]})
    assert probe.deviation(rows, 110.0, 130.0) == pytest.approx((0.1 + 0.3) / 2)
    assert probe.deviation(rows[rows["front.p"] < 80], 110.0, 130.0) == np.inf


def test_a_running_gear_at_y_0():
    found = probe.nothing(load_scenario("sine_tracking").but(end_m=600.0))
    assert found["rmse_y"] == pytest.approx(3e-3 / np.sqrt(2), rel=0.02)
    assert found["largest_error"] == pytest.approx(3e-3, rel=1e-3) and found["shortest_wave"] == 150.0


def test_a_probe_decides_statements():
    evidence = statements.Evidence(probe.probe(setup({}), ["curve", "causes"]))
    assert statements.find("C13", evidence).value == pytest.approx(0.26, abs=0.05)  # cones that nearly roll drift less
    assert 1.3 < statements.find("C35", evidence).value < 1.5  # S1002 wheels follow worse than cones
    for identity in ("C04", "C05", "C08", "C09", "C10", "C11", "C12", "C42"):
        assert np.isfinite(statements.find(identity, evidence).value), identity
    assert statements.load()["C10"].judge(statements.find("C10", evidence)) == "reproduced"
    with pytest.raises(statements.MissingEvidence):
        statements.find("C30", evidence)


SCALED = {"r", "pole", "frequency", "damping", "horizon_s"}  # parameters of a tuned set that sweeps change


@pytest.mark.parametrize("setting", COLUMNS)
def test_a_probe_runs_the_controllers_of_the_setting_that_its_rows_name(setting, monkeypatch):
    made = []
    names = ("rmse_y", "stopping_distance", "regular_deviation", "largest_slip", "set_point_gain", "error_growth")

    def measured(experiment, measure):
        made.append(experiment)
        return dict.fromkeys(names, 1.0) | ({} if measure is probe.braked else {"failed": 0.0}), None

    monkeypatch.setattr(probe.Experiment, "measured", measured)
    rows = probe.nominal([setting])
    assert set(rows["setting"]) == {setting} and set(rows["swarm"]) == {0, 1, 2}
    braked = rows[rows["scenario"] == probe.BRAKE]
    assert set(braked["swarm"]) == {0} and braked["seed"].nunique() == 1, "once per setting"
    assert {e.controller for e in made} == set(PAPER_TRIO)
    for experiment in made:
        searched = setting == SWARM and experiment.controller == "ndi"
        tuned = sets.load(f"{experiment.controller}{'_swarm' if searched else ''}", setting_of(setting))
        known = [tuned["parameters"], *(swarm["parameters"] for swarm in tuned.get("swarms", []))]
        kept = {key: value for key, value in experiment.parameters.items() if key not in SCALED}
        assert experiment.setting == setting_of(setting) and any(kept.items() <= one.items() for one in known)
        assert bool(experiment.sensors) == (setting == LOOP)
