"""The second plant: its contact agrees with published solutions, and controllers guide it like the project's car."""

from functools import partial

import exudyn_car
import numpy as np
import pandas as pd
import pytest
import rolling_contact
import second_plant

from railrepro.control.registry import CONTROLLERS, tuned
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle


@pytest.mark.parametrize(("flat", "kalker"), [(1.0, (4.12, 3.67, 1.47, 1.19)), (0.5, (5.20, 4.98, 2.63, 0.823))])
def test_sticking_patches_have_kalkers_coefficients(flat, kalker, monkeypatch):
    """Ellipses with b/a of 1 and .5, Poisson's ratio .25 (Kalker 1990, Table E3); squares affect the moment most."""
    monkeypatch.setattr(rolling_contact, "SQUARE", 0.05)
    x, y = (each.ravel() for each in np.meshgrid(*2 * [np.arange(-1.2, 1.2, 0.05) + 0.025]))
    inside = x**2 + (y / flat) ** 2 < 1
    x, y = x[inside], y[inside]
    one, nothing = np.ones_like(x), np.zeros_like(x)
    slip = np.array([[one, nothing], [nothing, one], [-y, x]])
    forces = -rolling_contact.sticking(x, y, slip, 0.25)
    found = [forces[0, 0] / flat, forces[1, 1] / flat, forces[2, 1] / flat**1.5]
    assert found == pytest.approx(kalker[:3], rel=0.02)
    assert forces[1, 2] == pytest.approx(-forces[2, 1], rel=1e-6)
    assert forces[2, 2] / flat**2 == pytest.approx(kalker[3], rel=0.13)


def test_the_table_of_the_contact_is_that_of_its_patches():
    stored = pd.read_csv(rolling_contact.TABLE).set_index("shift_m").loc[0.002]
    assert stored.to_dict() == pytest.approx(rolling_contact.patch(0.002, load_vehicle())._asdict(), rel=1e-4)


@pytest.mark.parametrize(
    ("shift", "published"), [(0.5e-3, 298.0), (1e-3, 535.0), (2e-3, 943.0), (3e-3, 1217.0), (4e-3, 1852.0)]
)
def test_a_running_gear_of_the_second_car_is_centred_as_published(shift, published):
    """Two free wheels at 80 kN, friction .3; published: CONTACT, 15 % as for the project's contact."""
    law = {"mu0": 0.3, "a_ratio": 1.0, "k_a": 1.0, "k_s": 1.0}
    vehicle = load_vehicle(**{f"adhesion.dry.{name}": value for name, value in law.items()})
    wheels, load, net = exudyn_car.s1002(), 8e4, 0.0
    for side in (1, -1):
        _, rolling, *stiffness = wheels(-side * shift)
        slope = -wheels(-side * shift, 1)[0]
        spin = -np.sin(np.arctan(slope)) / rolling
        _, pushed, _ = exudyn_car.creep(vehicle, exudyn_car.Stiffness(*stiffness), load, 0.0, 0.0, spin, 0.0)
        net += side * (load * slope - float(pushed))
    assert net == pytest.approx(published, rel=0.15)


@pytest.mark.parametrize("controller", ["nmpc", "ndi"])
def test_a_controller_guides_the_second_car_like_the_first(controller):
    """The start of the curve entry on T3; the whole one is in data/results/second_plant.csv."""
    pytest.importorskip("exudyn", reason="the group `bench` is installed by `make test-extras`")
    scenario = load_scenario("curve_entry_T3").but(end_m=150.0)
    guidance = partial(tuned, controller, CONTROLLERS[controller].quick)
    ours, theirs = (drive(scenario, guidance()).series for drive in (simulate.run, second_plant.run))
    assert len(theirs) == len(ours) and not metrics.reaches_flange(theirs)
    assert metrics.rmse(theirs) == pytest.approx(metrics.rmse(ours), rel=0.03)
    assert metrics.delay(theirs) == pytest.approx(metrics.delay(ours), abs=0.5)
    assert metrics.effort(theirs) == pytest.approx(metrics.effort(ours), rel=0.02)
    assert metrics.lateral_error(theirs) == pytest.approx(metrics.lateral_error(ours), rel=0.0, abs=1e-4)
