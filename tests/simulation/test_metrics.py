"""Figures of merit on series made by hand, with known answers."""

import numpy as np
import pandas as pd
import pytest

from railrepro.contact.creep import adhesion_maximum
from railrepro.contact.table import middle_patch
from railrepro.simulation import metrics
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

WHEELS = ("front_le", "front_ri", "rear_le", "rear_ri")


def frame(**columns):
    """Series with `_` after the gear or wheel read as a dot: front__y is front.y; scalars fill the column."""
    named = {name.replace("__", "."): value for name, value in columns.items()}
    return pd.DataFrame(named)


def waves(shift, length=600.0, start=0.0, trend=0.0, gear="front"):
    """A set point with a wavelength that changes, and y that comes `shift` metres after it."""
    p = start + np.arange(0.0, length, 0.05)

    def wave(place):
        return 3e-3 * np.sin(place / 15 + 4 * np.sin(place / 100))

    named = {"p": p, "y_ref": wave(p) + trend * (p - start), "y": wave(p - shift) - 2 * trend * (p - start) + 1e-3}
    return pd.DataFrame({f"{gear}.{name}": value for name, value in named.items()})


@pytest.mark.parametrize("shift", [-12.5, -3.0, 0.0, 0.7, 3.0, 12.5])
def test_delay_has_the_sign_of_coming_after(shift):
    assert metrics.delay(waves(shift)) == pytest.approx(shift, rel=0.03, abs=0.11)


def test_delay_weighs_each_lag_by_its_own_overlap():
    """Long lags have fewer samples; with sums in place of means a rising signal would be drawn to zero lag."""
    p = np.arange(0.0, 100.0, 0.05)

    def bump(centre):
        return np.exp(-(((p - centre) / 5) ** 2))

    series = frame(front__p=p, front__y_ref=bump(30.0), front__y=bump(70.0))
    assert metrics.delay(series) == pytest.approx(40.0, abs=1.0)


def test_a_set_point_at_rest_has_no_delay():
    series = waves(2.0)
    series["front.y_ref"] = 1e-3
    assert np.isnan(metrics.delay(series))
    series["front.y_ref"] = 1e-3 + 2e-8 * np.sin(series["front.p"] / 15)
    assert np.isfinite(metrics.delay(series))


def test_saturated_share_counts_rows_with_a_motor_at_its_limit():
    series = frame(
        front__tau_long=[3000.0, -3000.0, 3000.0, -3000.0, 3000.0, 3000.0, 0.0, 2000.0],
        front__du=[1000.0, 1000.0, -1000.0, -1000.0, 997.0, 995.0, 0.0, 400.0],
    )
    assert metrics.saturated_share(series, 4000.0) == pytest.approx(5 / 8)
    assert (
        metrics.saturated_share(series.rename(columns=lambda name: name.replace("front", "rear")), 4000.0, "rear") > 0
    )


def test_summary_of_a_lateral_run():
    series = waves(2.0).assign(**{"front.tau_long": 0.0, "front.du": 0.0, "rear.y_ref": 0.0, "rear.y": 2e-3})
    series.loc[0, ["front.y", "front.du"]] = series.loc[0, "front.y_ref"] - 7e-2, -4000.0
    series["front.rail_y"] = series["front.y"] - 4e-3
    found = metrics.summary(series, 4000.0)
    n = len(series)
    assert found["rail_rmse_y"] == (pytest.approx(4e-3), "m")
    assert found["rmse_y"] == (metrics.rmse(series), "m")
    assert found["rmse_y_rear"] == (pytest.approx(2e-3), "m")
    assert found["largest_error"] == (pytest.approx(7e-2), "m")
    assert found["delay"] == (pytest.approx(2.0, abs=0.11), "m")
    assert found["effort_du"] == (pytest.approx(4000.0 / np.sqrt(n)), "N m")
    assert found["largest_du"] == (4000.0, "N m")
    assert found["saturated_share"] == (pytest.approx(1 / n), "-")


def test_mean_error_of_the_last_third():
    columns = {"front.p": np.arange(9.0), "front.y_ref": 0.0, "front.y": [0.0, 9.0, 9.0, 9.0, 9.0, 9.0, 1.0, -2.0, 4.0]}
    still = dict.fromkeys(("front.du", "front.tau_long", "front.rail_y", "rear.y", "rear.y_ref"), 0.0)
    found = metrics.summary(pd.DataFrame(columns | still), 4000.0)
    assert found["mean_error_last_third"] == (pytest.approx(1.0), "m")


def peak(vehicle, name, speed):
    """Largest adhesion of an adhesion set at nominal load."""
    load = (26000.0 / 2 + 3000.0) * 9.81 / 2
    return adhesion_maximum(vehicle.adhesion[name], speed, load, *middle_patch(vehicle), 8.2e10)[0]


def braking(**columns):
    """Four rows of a run at 100 m/s and below."""
    still = {f"{wheel}.sx": 0.0 for wheel in WHEELS} | {f"front_{side}.adhesion": 0.0 for side in ("le", "ri")}
    base = {"front.p": [0.0, 10.0, 20.0, 30.0], "front.v": [100.0, 100.0, 100.0, 1.0], "front.tau_long": 0.0}
    base["front.f_star"] = 0.0
    named = {name.replace("__", "."): value for name, value in columns.items()}
    return pd.DataFrame(base | still | named)


@pytest.fixture(scope="module")
def poor():
    """Poor rail on the left from the start, on the right never."""
    scenario = load_scenario("adhesion_loss")
    return scenario.but(poor_share=(), poor_share_left=((0.0, 1.0),), poor_share_right=((0.0, 0.0),))


def test_longitudinal_metrics(poor):
    series = braking(front__tau_long=[100.0, 200.0, 300.0, 0.0])
    found = metrics.longitudinal(series, poor, load_vehicle())
    assert found["stopping_distance"] == (30.0, "m")
    assert found["final_speed"] == (1.0, "m/s")
    assert found["mean_longitudinal_torque"] == (150.0, "N m")
    assert found["largest_slip"] == (0.0, "-")
    assert np.isnan(found["utilisation"][0])  # the demand stays below the limit
    assert "utilisation" not in metrics.longitudinal(series, poor.but(force_kN=()), load_vehicle())


@pytest.mark.parametrize("wheel", WHEELS)
def test_largest_slip_is_that_of_any_wheel_while_it_moves(wheel):
    coasting, vehicle = load_scenario("sine_tracking"), load_vehicle()
    series = braking(**{f"{wheel}.sx": [0.01, -0.04, 0.02, 0.9]})  # the last row stands still
    for speed, largest in (([100.0, 100.0, 100.0, 1.9], 0.04), ([100.0, 100.0, 100.0, 2.1], 0.9), ([2.0] * 4, np.nan)):
        found = metrics.longitudinal(series.assign(**{"front.v": speed}), coasting, vehicle)
        assert found["largest_slip"] == (pytest.approx(largest, nan_ok=True), "-")


@pytest.mark.parametrize("sign", [1, -1])
def test_utilisation_is_the_mean_adhesion_over_the_largest_where_more_is_asked(sign, poor):
    vehicle = load_vehicle()
    limit = (peak(vehicle, "poor", 100.0) + peak(vehicle, "dry", 100.0)) / 2
    series = braking(
        front__f_star=sign * np.array([1.01 * limit, 0.99 * limit, 1.0, 1.0]),
        front_le__adhesion=sign * np.array([0.4 * limit, 0.0, 0.8 * limit, 0.0]),
        front_ri__adhesion=sign * np.array([0.6 * limit, 0.0, 1.0 * limit, 0.0]),
    )
    found, unit = metrics.longitudinal(series, poor, vehicle)["utilisation"]
    assert (found, unit) == (pytest.approx((0.5 + 0.9) / 2), "-")
    assert metrics.longitudinal(
        series.assign(**{"front_le.adhesion": 0.0, "front_ri.adhesion": -sign * limit}), poor, vehicle
    )["utilisation"][0] == pytest.approx(-0.5)


def test_the_share_of_poor_rail_counts_where_the_gear_is():
    vehicle = load_vehicle()
    scenario = load_scenario("adhesion_loss").but(poor_share=((10.0, 0.0), (20.0, 1.0)))
    series = braking(front__f_star=1.0, **{"front_le.adhesion": 0.05, "front_ri.adhesion": 0.05})
    dry, poor = peak(vehicle, "dry", 100.0), peak(vehicle, "poor", 100.0)
    found = metrics.longitudinal(series, scenario, vehicle)["utilisation"][0]
    assert found == pytest.approx((2 * 0.05 / dry + 0.05 / poor) / 3, rel=1e-6)
