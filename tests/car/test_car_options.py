"""Irregular rails, flanges and the floor of the car; preview of irregular rails."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies.experiment import Experiment
from railrepro.track import route
from railrepro.track.irregularity import CHANNELS
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle


def lay(**channels):
    """T5 with irregularities that rise from p = 30 m to 50 m and stay."""
    p = np.arange(0.0, 900.0, route.CELL)
    rise = np.clip((p - 30) / 20, 0, 1)
    frame = pd.DataFrame({"p_m": p} | {c: channels.get(name, 0.0) * rise for name, c in CHANNELS.items()})
    return route.lay(load_track("T5"), irregularities=frame)


def thrown(sideways):
    """A car at 400 km/h whose running gears start with a speed to the right (m/s)."""
    car = SteppedCar("T5", 111.0)
    car.state[equations.indices("front.vy", "rear.vy")] = sideways
    return car


@pytest.mark.parametrize(
    ("car", "steps", "period", "tolerance"),
    [
        (lambda: SteppedCar(lay(lateral=2e-3), 30.0), 2500, 1e-3, 0.03),
        (lambda: SteppedCar(lay(gauge=4e-3), 30.0), 2500, 1e-3, 0.03),
        (lambda: SteppedCar(lay(vertical=3e-3), 30.0), 2500, 1e-3, 0.03),
        (lambda: thrown(0.1), 600, 5e-5, 1e-3),
        (lambda: thrown(0.5), 600, 5e-5, 0.035),
    ],
    ids=["lateral", "gauge", "vertical", "towards the flange", "through a hit"],
)
def test_energy_balances_on_rails_that_move_and_at_the_flange(car, steps, period, tolerance):
    """In a hit the angle turns within a tenth of a millimetre, which the normal force follows to some percent."""
    car, rows = car(), []
    for _ in range(steps):
        rows.append(car.energies)
        car.step(period=period)
    table = pd.DataFrame([*rows, car.energies])
    work = np.trapezoid(table["motor_W"] - table["damping_W"] - table["creep_W"], dx=period)
    change = table["mechanical_J"].iloc[-1] - table["mechanical_J"].iloc[0]
    assert change == pytest.approx(work, rel=tolerance, abs=1.0)
    assert np.abs(car.state[equations.indices("front.y", "rear.y")]).max() < 8e-3  # the flange holds it


def test_floor_accelerations_are_those_of_points_in_space():
    """Second differences of a point of the floor less gravity, in axes of the body, while the car sways."""
    vehicle = load_vehicle()
    car = SteppedCar(lay(lateral=8e-3, crosslevel=4e-3), 30.0, vehicle)
    car.step(steps=1200)
    lever = np.array([vehicle.body.gear_spacing / 2, 0.0, vehicle.body.cg_height - vehicle.body.floor_height])
    centre = equations.indices("body.s", "body.y", "body.z")
    angles = equations.indices("body.psi", "body.pitch", "body.phi")
    points, attitudes, felt, h = [], [], [], 1e-3
    for _ in range(3):
        attitudes.append(Rotation.from_euler("ZYX", car.state[angles]).as_matrix())
        points.append(car.state[centre] + attitudes[-1] @ lever)  # on a straight level track
        felt.append(car.outputs)
        car.step(period=h)
    acceleration = (points[0] - 2 * points[1] + points[2]) / h**2
    expected = attitudes[1].T @ (acceleration - [0, 0, vehicle.gravity])
    assert [felt[1][f"floor_front.a{axis}"] for axis in "xyz"] == pytest.approx(expected, abs=2e-3)
    assert abs(expected[1]) > 0.02


def test_a_planned_line_is_added_to_the_set_point():
    at = np.arange(20.0, 60.0, 2.0)
    cubic = np.outer([1e-3, 2e-5, -1e-6, 3e-8], np.ones(len(at)))
    reference = route.reference(route.SetPoint(1, 2e-3, 150.0, 150.0, 0.0, 1e6, 30.0))
    plain, both = (route.lay(load_track("T5"), reference, line=line) for line in (None, (at, cubic)))
    inside, outside = np.array([31.25]), np.array([10.0, 70.0])
    d = 1.25  # from the node at 30 m
    expected = 1e-3 + 2e-5 * d - 1e-6 * d**2 / 2 + 3e-8 * d**3 / 6
    added = both.reference_at(inside)[0] - plain.reference_at(inside)[0]
    assert added == pytest.approx([expected], rel=1e-9)
    assert np.array_equal(both.reference_at(outside), plain.reference_at(outside))


def test_preview_makes_the_set_point_follow_the_rails():
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=160, end_m=200)
    given = {"parameters": {"pole": 30.0, "frequency": 30.0, "damping": 1.0}, "irregular": {"spectrum": "en_B_300"}}
    errors = {}
    for name, known in (("none", {}), ("exact", {"share": 1.0}), ("late", {"localisation_error_m": 10.0})):
        experiment = Experiment(scenario, "ndi_feedforward", preview=known, **given)
        errors[name] = experiment()[0]["rail_rmse_y"]
    assert errors["exact"] < 0.6 * errors["none"] and errors["late"] > 1.5 * errors["exact"]
