"""What a probe measures on runs made by hand, and one small probe of the car that answers statements."""

import numpy as np
import pandas as pd
import pytest

from railrepro.control.registry import PAPER_TRIO
from railrepro.evidence.claims import probe, statements
from railrepro.evidence.claims.setup import setup
from railrepro.evidence.runs import tuning
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle


def torques(later, noise=0.0):
    """Torque of one run over the way, and of another `later` metres behind, with noise."""
    p = np.arange(0.0, 650.0, 0.5)
    scatter = np.random.default_rng(5).normal(0, noise, p.size)

    def shape(place):
        return np.sin(place / 15 + 4 * np.sin(place / 100))

    pairs = (shape(p), shape(p - later) + scatter)
    return [pd.DataFrame({"p_m": p, "du_Nm": du}) for du in pairs]


@pytest.mark.parametrize(
    ("later", "noise", "alike"), [(5.0, 0.0, 1.0), (0.75, 0.0, 1.0), (-12.0, 0.0, 1.0), (5.0, 0.9, 0.6)]
)
def test_by_how_much_a_torque_comes_later(later, noise, alike):
    found = probe.torque_shift(*torques(later, noise))
    assert found["ndi_later"] == pytest.approx(later, abs=0.26)
    assert found["ndi_alike"] == pytest.approx(alike, abs=0.1)


def test_gyroscopic_torque_on_the_cant_ramp_of_t3():
    # v^2/R - 0.4333 m/s2 is balanced by a cant that rises along 423 m; J_Wy 60 kg m2, b 1.5 m
    v = 280 / 3.6
    cant_rate = np.arcsin((v**2 / 4250 - 0.4333) / 9.81) / 423
    found = probe.gyroscopic_torque(load_vehicle(), v, load_track("T3"))
    assert found == pytest.approx(-2 * 60.0 * v**2 * cant_rate / 1.5, rel=0.01)


@pytest.mark.parametrize("side", [1, -1])
def test_torque_over_the_first_wave_less_that_before(side):
    """A wave from 20 to 120 m; tracking has no mean over a whole wave."""
    p = np.arange(0.0, 400.0)
    reference = side * np.where(p < 20, 0.0, np.sin(2 * np.pi * (p - 19.5) / 100))
    du = np.select([p < 20, p < 120], [30.0, 10.0 + 500 * reference], -1e4)
    found = probe.torque_step(pd.DataFrame({"p_m": p, "y_ref_m": reference, "du_Nm": du}))
    assert found == pytest.approx(-20.0, abs=2)


@pytest.mark.parametrize("side", [1, -1])
def test_shortfall_at_the_crests_of_the_worse_side(side):
    reference = side * 1e-3 * np.array([3.0, 2.6, -3.0, -2.6, 2.4, 0.0])
    y = reference - side * 1e-3 * np.array([0.5, 0.7, -0.1, -0.3, 9.0, 9.0])
    assert probe.shortfall(pd.DataFrame({"y_ref_m": reference, "y_m": y})) == pytest.approx(0.6e-3)
    assert probe.shortfall(pd.DataFrame({"y_ref_m": reference, "y_m": 1.1 * reference})) < 0


def test_yaw_against_the_track_over_its_heading():
    heading = np.linspace(0.0, 0.1, 50)
    rows = pd.DataFrame({"psi_ax_rad": heading, "psi_trax_rad": 0 * heading})
    assert probe.path_error(rows) == 0.0
    assert probe.path_error(rows.assign(psi_ax_rad=0.0, psi_trax_rad=-heading)) == pytest.approx(1.0)


@pytest.mark.parametrize(("gain", "noise", "growth"), [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (0.7, 2.0, 2.0)])
def test_an_oscillation_about_the_set_point(gain, noise, growth):
    """Three waves of the set point from 240 m on; an error of another wavelength that may grow with the way."""
    p = np.arange(0.0, 690.0, 0.5)
    reference = 2e-3 * np.sin(2 * np.pi * p / 150)
    wobble = 1e-3 * noise * np.sin(2 * np.pi * p / 15) * np.where(p < 465, 1.0, growth)
    y = np.where(p < 240, 9.0, gain * reference + wobble)
    found = probe.oscillation(pd.DataFrame({"p_m": p, "y_ref_m": reference, "y_m": y}))
    assert found["set_point_gain"] == pytest.approx(gain, abs=0.02)
    assert found["error_growth"] == pytest.approx(growth, rel=0.15)


def test_where_one_of_the_perturbed_runs_fails_all_have():
    found = probe._mean([{"failed": 0.0, "rmse_y": 1.0, "a": 1.0}, {"failed": 0.0, "rmse_y": 3.0, "a": 2.0}])
    assert found == {"failed": 0.0, "rmse_y": 2.0, "a": 1.5}
    one_failed = probe._mean([{"failed": 0.0, "rmse_y": 1.0, "a": 1.0}, {"failed": 1.0, "a": 2.0}])
    assert one_failed == {"failed": 1.0, "a": 1.5}


def test_the_smallest_fixed_share_is_found_by_halving(monkeypatch):
    """Guidance needs 7.5 % of the torque; the distance rises with what is set aside."""

    def braked(_world, fixed_share=None):
        if fixed_share is None:
            return {"rmse_y": 1e-3, "stopping_distance": 1000.0}
        enough = 0.075 <= fixed_share < 0.2  # a longer way has more of the error again
        return {"rmse_y": 1.05e-3 if enough else 5e-3, "stopping_distance": 1000 / (1 - fixed_share)}

    monkeypatch.setattr(probe, "_braked", braked)
    found = probe._allocated(setup({}))
    assert 0.075 <= found["share"] < 0.078 and found["stopping_distance"] == pytest.approx(1082, abs=3)
    assert probe._allocated(setup({}), (0.0, 0.02, 0.07))["rmse_y"] == np.inf, "none is enough"


def approaching(adhesion, slip, torque):
    """4 s at 100 m/s from 240 m on, a row per 10 ms; adhesion of both wheels, slip of the left one."""
    time = 0.01 * np.arange(400)
    columns = {"p_m": 240 + 100 * time, "t_s": time, "u_d_Nm": torque(time), "sx_ri": 0.0, "sx_le": -slip(time)}
    return pd.DataFrame(columns | {"fx_ri": adhesion(time), "fx_le": adhesion(time)})


def macro_slips(adhesion, slip, torque=lambda t: 1000.0 - 200 * (t > 1) - 200 * (t > 2)):
    return probe.macro_slips(approaching(adhesion, slip, torque), 0.1, 0.02)


def test_macro_slips_that_are_left_again_and_approaches():
    """Slips of 0.1 s after 0.95 s and of 0.3 s after 1.9 s; the peak is approached before both, and at the end."""

    def slip(t):
        return 0.03 * (((t > 0.95) & (t < 1.05)) | ((t > 1.9) & (t < 2.3)))

    found = macro_slips(lambda t: 0.1 * (np.mod(t, 1) > 0.8) * (slip(t) == 0), slip)
    assert found == {"macro_slips": 2, "recovered": 1, "approaches": 3, "approached": 3}
    low = macro_slips(lambda t: 0.1 * ((np.mod(t, 1) > 0.8) & (t < 1)) * (slip(t) == 0), slip)
    assert (low["approaches"], low["approached"]) == (3, 1), "1.7 s are enough for another approach"
    held = macro_slips(lambda t: 0.1 * (t < 0.9), slip, lambda t: 1000.0 + 0 * t)
    assert held["recovered"] == 0, "the torque does not fall"


def test_an_approach_that_the_end_of_the_run_cuts_does_not_count():
    def slip(t):
        return 0.03 * ((t > 3.0) & (t < 3.05))

    found = macro_slips(lambda t: 0.09001 * (t < 3), slip)
    assert (found["approaches"], found["approached"]) == (1, 1)
    never = macro_slips(lambda t: 0.0899 + 0 * t, lambda t: 0 * t)
    assert never == {"macro_slips": 0, "recovered": 0, "approaches": 1, "approached": 0}
    sliding = macro_slips(lambda t: 0.1 + 0 * t, lambda t: 0.03 + 0 * t)
    assert sliding == {"macro_slips": 1, "recovered": 0, "approaches": 1, "approached": 0}


def test_excessive_slip_lies_on_the_falling_branch():
    scenario, car = load_scenario("adhesion_loss"), load_vehicle()
    peak, slip = probe.adhesion_peak(scenario, car)
    assert 0.09 < peak < 0.11 and slip == pytest.approx(0.018, abs=1e-3)
    assert probe.excessive_slip(scenario, car) == pytest.approx(0.040, abs=1e-3)


def test_deviation_in_regular_operation():
    p = np.array([10.0, 110.0, 129.0, 130.0])
    rows = pd.DataFrame({"p_m": p, "fx_ri": [9.0, 0.05, 0.06, 9.0], "fx_le": [9.0, 0.04, 0.07, 9.0], "f_star": 0.05})
    assert probe.deviation(rows, 110.0, 130.0) == pytest.approx((0.1 + 0.3) / 2)
    assert probe.deviation(rows[rows["p_m"] < 80], 110.0, 130.0) == np.inf


def test_what_doing_nothing_gives():
    found = probe.nothing(load_scenario("sine_tracking").but(end_m=600.0))
    assert found["rmse_y"] == pytest.approx(3e-3 / np.sqrt(2), rel=0.02)
    assert found["largest_error"] == pytest.approx(3e-3, rel=1e-3) and found["shortest_wave"] == 150.0


def test_what_a_probe_measures_of_a_run_made_by_hand():
    """Nine cycles of 12 m: the error of the last three has the mean 1 mm."""
    error = 1e-3 * np.array([0.0, 9.0, 9.0, 9.0, 9.0, -9.0, 1.0, -2.0, 4.0])
    columns = {"front.p": 12.0 * np.arange(9), "front.y_ref": 2e-3, "front.y": 2e-3 + error, "front.du": 50.0}
    found = probe.lateral(simulate.Run(pd.DataFrame(columns), "end of the run", False, ()))
    expected = {"rmse_y": 6.880e-3, "largest_error": 9e-3, "mean_error_last_third": 1e-3, "effort_du": 50, "failed": 0}
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_probe_answers_statements():
    rows = probe.probe(setup({}), ["curve", "causes"])
    evidence = statements.Evidence({row[:3]: row[3] for row in rows})
    assert statements.find("C13", evidence).value == pytest.approx(0.21, abs=0.05)  # cones that nearly roll drift less
    assert 0.6 < statements.find("C35", evidence).value < 0.75  # S1002 wheels follow worse than cones
    for identity in ("C04", "C05", "C08", "C09", "C10", "C11", "C12", "C42"):
        assert np.isfinite(statements.find(identity, evidence).value), identity
    assert statements.load()["C10"].judge(statements.find("C10", evidence)) == "reproduced"
    with pytest.raises(statements.MissingEvidence):
        statements.find("C30", evidence)


SCALED = {"r", "pole", "frequency", "damping"}
"""What sweeps change of a tuned set."""


@pytest.mark.parametrize("setting", tuning.SETTINGS)
def test_a_probe_runs_the_controllers_of_the_setting_that_its_rows_name(setting, monkeypatch):
    made = []
    values = dict.fromkeys(("rmse_y", "stopping_distance", "regular_deviation", "largest_slip"), 1.0)
    values |= {"set_point_gain": 1.0, "error_growth": 1.0}

    def measured(experiment, measure):
        made.append(experiment)
        return values | ({} if measure is probe.braked else {"failed": 0.0}), None

    monkeypatch.setattr(probe.Experiment, "measured", measured)
    rows = probe.nominal([setting], quiet=True)
    assert set(rows["setting"]) == {setting} and set(rows["swarm"]) == {0, 1, 2}
    braked = rows[rows["scenario"] == probe.BRAKE]
    assert set(braked["swarm"]) == {0} and braked["seed"].nunique() == 1, "once per setting"
    swarms = sorted(tuning.load("nmpc", setting)["swarms"], key=lambda swarm: swarm["cost"])
    of_rank = {tuple(swarm["parameters"].values()) for swarm in swarms}
    assert of_rank <= {tuple(e.parameters.values()) for e in made if e.controller == "nmpc"}
    made.clear()
    probe.probe(setup({}, setting, seed=probe.SEEDS[0]), (*probe.PARTS, *probe.ONCE))
    assert {e.controller for e in made} == set(PAPER_TRIO) and len(made) > 70
    for experiment in made:
        own = tuning.load(experiment.controller, setting)["parameters"]
        swept = {key for key, value in experiment.parameters.items() if own[key] != value}
        assert experiment.setting == setting and swept <= SCALED
        assert bool(experiment.sensors) == (setting == tuning.LOOP)
