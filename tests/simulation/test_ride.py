"""Ride and safety figures: rail forces, sliding means, flange contacts, wear, comfort weightings."""

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.simulation import ride
from railrepro.vehicle.parameters import load_vehicle

RATE, VEHICLE = 1000.0, load_vehicle()
WAVE = 6 / np.sqrt(2)
"""Mean comfort of a sine of 1 m/s2 with a weight of one."""


def time(duration):
    return np.arange(round(duration * RATE)) / RATE


def gain(name, frequency):
    return abs(signal.freqz_sos(ride.weighting_filter(name, RATE), np.atleast_1d(frequency), fs=RATE)[1])


def test_weights_are_those_of_the_standard():
    """Table of weights of ISO 2631-1; at 100 rad/s the reference value of ISO 8041."""
    weights = {0.1: 0.0624, 0.5: 0.853, 1: 1.011, 2: 0.890, 4: 0.512, 8: 0.253, 100 / (2 * np.pi): 0.1261}
    np.testing.assert_allclose(gain("Wd", list(weights)), list(weights.values()), rtol=2e-3)


def test_the_weighting_wb_follows_its_transfer_function():
    """At frequencies that are moved as the bilinear transform moves them, which leaves rounding only."""
    at = np.array([0.3, 0.5, 1, 2, 3, 4, 5, 8, 12, 16, 25, 50, 100, 150])
    f = RATE / np.pi * np.tan(np.pi * at / RATE)

    def size(corner, quality):
        return np.hypot(1 - (f / corner) ** 2, f / corner / quality)

    band = f**2 / np.sqrt(f**4 + 0.4**4) / np.sqrt(1 + (f / 100) ** 4)
    expected = band * 1.024 * np.hypot(1, f / 16) / size(16, 0.63) * (2.5 / 4) ** 2 * size(2.5, 0.8) / size(4, 0.8)
    np.testing.assert_allclose(gain("Wb", at), expected, rtol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mean_comfort_is_a_percentile_of_weighted_blocks_that_overlap(axis):
    """A sine of 5 Hz, then five seconds of it in 111 blocks, of which each half second further off has a tenth less."""
    t, expected = time(60), WAVE * (0.409, 0.409, 0.957)[axis]
    sine = np.sin(2 * np.pi * 5 * t)
    burst = np.where((t >= 30) & (t < 35), sine, 0.0)
    for wave, part, tolerance in ((sine, 1.0, 3e-3), (burst, np.sqrt(0.7), 0.02)):
        directions = np.zeros((3, t.size))
        directions[axis] = wave
        assert ride.mean_comfort(*directions, RATE) == pytest.approx(expected * part, rel=tolerance)
    assert np.isnan(ride.mean_comfort(*directions[:, :4999], RATE))


def test_low_pass_has_its_cut_off_slope_and_no_phase():
    t, middle = time(4), slice(1500, 2500)
    for frequency, level in ((5, 1.0), (20, 1 / np.sqrt(2)), (40, 10 ** (-17.7 / 20))):
        wave = np.sin(2 * np.pi * frequency * t)
        np.testing.assert_allclose(ride.low_pass(wave, RATE)[middle], level * wave[middle], atol=0.003)


def test_sliding_mean_of_a_car_that_swings_back_after_its_stop():
    t = np.linspace(0.0, 2.0, 401)
    p = np.where(t < 1.0, 40 * t, 40 + 2e-3 * np.exp(-3 * (t - 1)) * np.sin(20 * (t - 1)))
    assert (np.diff(p) < 0).any()
    assert ride.sliding_mean(5 * p, p) == pytest.approx(5 * (0.5 * np.arange(77) + 1), abs=0.05)


def test_rail_forces_are_what_accelerates_the_car():
    """The sum of Y is minus mass times lateral acceleration, the sum of Q the weight less mass times vertical one."""
    car, index = SteppedCar("T5", 50.0, VEHICLE), equations.INDEX
    moves = {"front.y": 4e-3, "front.psi": 3e-3, "front.phi": 4e-4, "rear.y": -5e-3, "rear.psi": -2e-3, "body.y": 1e-2}
    for name, value in moves.items():
        car.state[index[name]] += value
    rate, out = np.array(car.model.rate(*car.inputs())).ravel(), car.outputs
    forces = []
    for wheel in equations.WHEELS:
        gear, side = wheel.split("_")
        values = (out[f"{wheel}.{name}"] for name in ("N", "Fy", "angle"))
        forces.append(ride.rail_forces(*values, side, roll=car.state[index[f"{gear}.phi"]]))
    y, q = np.sum(forces, axis=0)
    masses = np.array([VEHICLE.body.mass, VEHICLE.gear.mass, VEHICLE.gear.mass])
    across, down = (masses @ rate[[index[f"{body}.{v}"] for body in equations.BODIES]] for v in ("vy", "vz"))
    assert abs(y) > 5e3 and y == pytest.approx(-across, abs=1.0)
    assert q == pytest.approx(masses.sum() * VEHICLE.gravity - down, abs=5.0)


def test_flange_contacts_less_than_a_metre_apart_are_one():
    p = np.arange(0, 500.01, 0.1)
    angle = np.full(p.size, np.radians(3))
    assert ride.flange_contacts(angle, p) == 0
    for start, end, degrees in ((0, 2, 60), (100, 101, 45), (101.5, 102, -45), (200, 201, 29), (499, 500, 70)):
        angle[(p >= start - 1e-6) & (p <= end + 1e-6)] = np.radians(degrees)
    assert ride.flange_contacts(angle, p) == pytest.approx(6.0)


def test_creep_work_of_all_wheels_is_the_loss_of_the_car_and_t_gamma_leaves_out_spin():
    """On S1002 off centre, yawed and braked; the plant's creep loss over its speed is another expression."""
    car = SteppedCar("T5", 30.0, load_vehicle(**{"contact.profile": "s1002"}))
    car.state[equations.indices("front.y", "rear.y", "front.psi")] = 2e-3, -3e-3, 1e-3
    car.step(np.full(4, -500.0), 50)
    series = pd.DataFrame([car.outputs] * 3).assign(**{f"{gear}.p": [0.0, 1.0, 2.0] for gear in equations.GEARS})
    work = ride.creep_work(series)
    assert 4 * work["creep_work"] == pytest.approx(car.energies["creep_W"] / car.outputs["front.v"], rel=1e-3)
    spin = -sum(car.outputs[f"{wheel}.M_spin"] * car.outputs[f"{wheel}.spin"] for wheel in equations.WHEELS) / 4
    assert work["creep_work"] - work["t_gamma"] == pytest.approx(spin) and spin > 0.01 * work["t_gamma"]
    slow = series.assign(**{f"{gear}.p": [0.0, 1.0, 1.5] for gear in equations.GEARS})
    slow.loc[2, [f"{wheel}.{name}" for wheel in equations.WHEELS for name in ("Fx", "Fy", "M_spin")]] = 0.0
    # rows stand for 1, 3/4 and 1/2 m
    assert ride.creep_work(slow) == pytest.approx({name: 7 / 9 * value for name, value in work.items()})


def steady_series(speed=50.0):
    """A run of known figures: half the static load more on the right, 4 kN of creep, 5 Hz of floor motion."""
    t = time(8.0)
    series = {"t_s": t, "front.p": speed * t + 14, "rear.p": speed * t, "front.phi": 0.0, "rear.phi": 0.0}
    for wheel in equations.WHEELS:
        values = {"Fx": -5e3, "Fy": -2e3, "nu_x": 1e-3, "nu_y": 5e-4, "angle": 0.0, "spin": 0.05}
        values |= {"M_spin": -40.0 * (wheel == "rear_ri"), "N": VEHICLE.wheel_load * (0.5 + wheel.endswith("ri"))}
        series |= {f"{wheel}.{name}": value for name, value in values.items()}
    for point in ride.FLOOR:
        series |= {f"{point}.ax": 0.0, f"{point}.ay": 0.0, f"{point}.az": np.sin(2 * np.pi * 5 * t) - 9.81}
    return pd.DataFrame(series)


def test_summary_names_every_figure_with_its_unit():
    expected = {"sum_y_over_limit": (4.0 / 62.32, "-"), "y_over_q": (2e3 / (1.5 * 78_480), "-")}
    expected |= {"wheel_unloading": (0.5, "-"), "flange_contacts": (0.0, "1/km")}
    expected |= {"t_gamma": (6.0, "N"), "creep_work": (6.5, "N")}
    expected |= {f"n_mv_floor_{name}": (0.957 * WAVE, "-") for name in ("front", "centre", "rear")}
    found = ride.ride_summary(steady_series(), VEHICLE)
    assert found == {name: (pytest.approx(v, rel=5e-3, abs=1e-9), unit) for name, (v, unit) in expected.items()}


def test_summary_takes_the_worst_wheel_the_roll_and_all_flanges():
    plain = steady_series()
    struck, pushed, tilted = plain.copy(), plain.copy(), plain.assign(**{"front.phi": 1e-3, "rear.phi": 1e-3})
    struck.loc[2000:3000, "rear_le.angle"] = np.radians(40)
    pushed.loc[1000:1500, ["front_le.Fy", "front_ri.Fy"]] = 3e3
    figures = ride.ride_summary(struck, VEHICLE)
    assert figures["flange_contacts"][0] == pytest.approx(1e3 / (50 * 7.999)) and figures["y_over_q"][0] > 0.7
    for series, shifting, tolerance in ((pushed, 6.0, 0.03), (tilted, 4 - 2 * 0.07848, 1e-3)):
        share, _ = ride.ride_summary(series, VEHICLE)["sum_y_over_limit"]
        assert share == pytest.approx(shifting / 62.32, rel=tolerance)


def test_forces_are_filtered_before_their_quotient_which_is_finite_when_the_wheel_lifts():
    """Half a wave of 100 Hz is as long as the window, so that the means alone would not remove it."""
    series = steady_series(speed=400.0)
    wave = np.sin(2 * np.pi * 100 * series["t_s"])
    series["rear_ri.Fy"], series["rear_ri.N"] = -30e3 * (1 + wave), 60e3 * (1 - wave)
    figures = ride.ride_summary(series, VEHICLE)
    assert figures["y_over_q"][0] == pytest.approx(0.5, rel=0.15) and figures["wheel_unloading"][0] < 0.55
    series["rear_ri.N"] = 0.0
    assert ride.ride_summary(series, VEHICLE)["y_over_q"][0] == pytest.approx(30.0, rel=0.15)
