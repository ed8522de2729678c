"""What tuning never sees and a scenario or a vehicle can ask for: wheels of their own radius, force on the car body."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.control.ndi import NDI
from railrepro.errors import InputError
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

STRAIGHT = load_scenario("sine_tracking").but(set_point={"kind": "none"}, end_m=60.0, speed_kmh=100.0)
LAW = NDI(pole=30.0, frequency=24.0, damping=0.7)


@pytest.mark.parametrize("wheel", equations.WHEELS)
def test_a_worn_wheel_stands_on_its_rail_from_the_start_and_turns_faster(wheel):
    """Rolling without torque, its speed is that of the others times r / (r - wear)."""
    # Tilted by 3 mrad, S1002 would roll on another radius, too.
    worn = load_vehicle(**{f"wear.{wheel}": 5e-3, "contact.profile": "cone"})
    gear, side = wheel.split("_")
    series = simulate.run(STRAIGHT, LAW, plant_vehicle=worn).series
    other = f"{gear}_{'ri' if side == 'le' else 'le'}"
    ratio = (series[f"{wheel}.w"] / series[f"{other}.w"]).tail(500).mean()
    assert ratio == pytest.approx(0.46 / 0.455, abs=2e-4)
    load = series[f"{wheel}.N"]
    assert load.min() > 0.8 * load.iloc[0] and load.iloc[0] == pytest.approx(load_of(worn), rel=0.1)
    roll = series[f"{gear}.phi"].tail(500).mean() * worn.gear.contact_base
    assert roll == pytest.approx(5e-3 if side == "ri" else -5e-3, rel=0.05)


def load_of(vehicle):
    return (vehicle.body.mass / 4 + vehicle.gear.mass / 2) * vehicle.gravity


def test_wheels_worn_alike_are_wheels_of_a_smaller_radius_on_a_lower_car():
    """The springs stand as high above the rails as before only with a smaller radius: 1e-3 of the motion tells both."""
    alike = load_vehicle(**{f"wear.{wheel}": 5e-3 for wheel in equations.WHEELS})
    small = load_vehicle(**{"wheel.radius": 0.455})
    scenario = load_scenario("sine_tracking").but(end_m=150.0, speed_kmh=160.0)
    one, other = (simulate.run(scenario, LAW, plant_vehicle=car).series for car in (alike, small))
    n = min(len(one), len(other))
    assert np.abs(one["front.y"][:n] - other["front.y"][:n]).max() < 0.02 * one["front.y"].abs().max()
    assert one["front_le.w"].iloc[-1] == pytest.approx(other["front_le.w"].iloc[-1], rel=1e-4)


def test_a_side_force_is_carried_by_both_gears_in_halves():
    """Held by the gears, the body sways by F over the stiffness of both pairs of springs, plus its roll."""
    scenario = STRAIGHT.but(side_force_kN=((0.0, 4.0),), end_m=250.0)
    last = simulate.run(scenario, LAW).series.tail(1000).mean()
    lateral = sum(last[f"{wheel}.Fy"] - last[f"{wheel}.N"] * side(wheel, last) for wheel in equations.WHEELS)
    assert lateral == pytest.approx(-4000.0, rel=0.05)
    assert last["body.y"] > 1e-3 and last["body.phi"] > 0


def side(wheel, last):
    """Lateral share of the normal force, to the left positive for the right wheel."""
    return np.tan(last[f"{wheel}.angle"]) * (1 if wheel.endswith("ri") else -1)


def test_nothing_asked_for_changes_no_bit():
    plain = simulate.run(STRAIGHT, LAW).series
    asked = simulate.run(STRAIGHT.but(side_force_kN=((0.0, 0.0),)), LAW).series
    assert np.array_equal(plain.to_numpy(), asked.to_numpy())


def test_impossible_wear_and_side_force_are_named():
    with pytest.raises(InputError, match="wear.front_le"):
        load_vehicle(**{"wear.front_le": 0.2})
    with pytest.raises(InputError, match="side force outside"):
        STRAIGHT.but(side_force_kN=((0.0, 3e4),))
