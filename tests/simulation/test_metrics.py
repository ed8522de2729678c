"""Figures of merit on series made by hand, with known answers."""

import numpy as np
import pandas as pd
import pytest

from railrepro.contact.creep import adhesion_maximum
from railrepro.contact.table import middle_patch
from railrepro.quantities import WHEELS
from railrepro.simulation import metrics
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

VEHICLE, LOSS = load_vehicle(), load_scenario("adhesion_loss")


def waves(shift):
    """A set point with a varying wavelength, and y that trails it by `shift` metres with an offset of 1 mm."""
    p = np.arange(0.0, 600.0, 0.05)
    y_ref, y = (3e-3 * np.sin(x / 15 + 4 * np.sin(x / 100)) for x in (p, p - shift))
    return pd.DataFrame({"front.p": p, "front.y_ref": y_ref, "front.y": y + 1e-3})


@pytest.mark.parametrize("shift", [-12.5, 0.0, 0.7, 3.0])
def test_delay_is_positive_where_y_trails_and_undefined_for_a_constant_set_point(shift):
    series = waves(shift)
    assert metrics.delay(series) == pytest.approx(shift, rel=0.03, abs=0.11)
    assert np.isnan(metrics.delay(series.assign(**{"front.y_ref": 1e-3})))


def test_delay_weighs_each_lag_by_its_own_overlap():
    """Long lags have fewer samples; with sums in place of means a rising signal would be drawn to zero lag."""
    p = np.arange(0.0, 100.0, 0.05)
    early, late = (np.exp(-(((p - centre) / 5) ** 2)) for centre in (30.0, 70.0))
    series = pd.DataFrame({"front.p": p, "front.y_ref": early, "front.y": late})
    assert metrics.delay(series) == pytest.approx(40.0, abs=1.0)


def test_summary_of_a_lateral_run():
    series = waves(2.0).assign(**{"front.du": 0.0, "rear.y_ref": 0.0, "rear.y": 2e-3})
    series.loc[0, ["front.y", "front.du"]] = series.loc[0, "front.y_ref"] - 7e-2, -4000.0
    n = len(series)
    series.loc[n - n // 3 - 1 :, "front.y"] = series["front.y_ref"] + 1e-3
    found = metrics.summary(series.assign(**{"front.rail_y": 0.0}))
    assert found["rmse_y"] == (metrics.rmse(series), "m") and found["delay"] == (metrics.delay(series), "m")
    assert found["rmse_y_rear"] == (pytest.approx(2e-3), "m")
    assert found["mean_error_last_third"] == (pytest.approx(1e-3), "m")
    assert found["largest_error"] == (pytest.approx(7e-2), "m")
    assert found["effort_du"] == (pytest.approx(4000.0 / np.sqrt(n)), "N m")
    still = series.assign(**{"front.y": 3e-3, "front.y_ref": 1e-3, "front.rail_y": 5e-3})
    assert metrics.summary(still)["rail_rmse_y"] == (pytest.approx(2e-3), "m")
    assert metrics.followed_rmse(still) == pytest.approx(3e-3)


def peak(name):
    """Largest adhesion of an adhesion set at 100 m/s and nominal load."""
    load = (26000.0 / 2 + 3000.0) * 9.81 / 2
    return adhesion_maximum(VEHICLE.adhesion[name], 100.0, load, *middle_patch(VEHICLE), 8.2e10)[0]


def longitudinal(scenario=LOSS, **columns):
    """Metrics of four rows of a run at 100 m/s and below."""
    base = {"front.p": [0.0, 10.0, 20.0, 30.0], "front.v": [100.0, 100.0, 100.0, 1.0], "front.f_star": 0.0}
    base |= {f"{wheel}.sx": 0.0 for wheel in WHEELS} | {f"front_{side}.adhesion": 0.0 for side in ("le", "ri")}
    return metrics.longitudinal(pd.DataFrame(base | columns), scenario, VEHICLE)


def test_a_run_without_force_demand_has_no_utilisation_and_one_below_the_limit_none_that_counts():
    assert longitudinal(LOSS.but(force_kN=())) == {"stopping_distance": (30.0, "m"), "largest_slip": (0.0, "-")}
    assert np.isnan(longitudinal()["utilisation"][0])


@pytest.mark.parametrize("wheel", WHEELS)
def test_largest_slip_is_that_of_any_wheel_while_it_moves(wheel):
    slip = {f"{wheel}.sx": [0.01, -0.04, 0.02, 0.9]}  # the last row stands still
    for speed, largest in (([100.0, 100.0, 100.0, 1.9], 0.04), ([100.0, 100.0, 100.0, 2.1], 0.9), ([2.0] * 4, np.nan)):
        found = longitudinal(load_scenario("sine_tracking"), **slip, **{"front.v": speed})
        assert found["largest_slip"] == (pytest.approx(largest, nan_ok=True), "-")


@pytest.mark.parametrize("sign", [1, -1])
def test_utilisation_is_the_mean_adhesion_over_the_limit_where_more_is_demanded(sign):
    """Poor rail on the left; the second demand is below the limit, the last row stands still."""
    limit = (peak("poor") + peak("dry")) / 2
    used = {"front_le.adhesion": [0.4, 0.0, 0.8, 0.0], "front_ri.adhesion": [0.6, 0.0, 1.0, 0.0]}
    columns = {name: sign * limit * np.array(values) for name, values in used.items()}
    columns["front.f_star"] = sign * np.array([1.01 * limit, 0.99 * limit, 1.0, 1.0])
    poor_left = LOSS.but(poor_share=(), poor_share_left=((0.0, 1.0),), poor_share_right=((0.0, 0.0),))
    assert longitudinal(poor_left, **columns)["utilisation"] == (pytest.approx((0.5 + 0.9) / 2), "-")


def test_the_share_of_poor_rail_counts_where_the_gear_is():
    columns = {"front.f_star": 1.0, "front_le.adhesion": 0.05, "front_ri.adhesion": 0.05}
    found = longitudinal(LOSS.but(poor_share=((10.0, 0.0), (20.0, 1.0))), **columns)["utilisation"][0]
    assert found == pytest.approx((2 * 0.05 / peak("dry") + 0.05 / peak("poor")) / 3, rel=1e-6)
