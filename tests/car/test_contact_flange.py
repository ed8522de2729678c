"""Flange contact on real profiles: runs stay finite, energy balances, a cell goes on as it should beyond its ends."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.contact.table import CELL_COLUMNS, contact_table, in_cell
from railrepro.vehicle.parameters import load_vehicle

VEHICLE = load_vehicle(**{"contact.profile": "s1002"})


def thrown(sideways, speed=111.0):
    """A car whose gears are thrown to the right (m/s)."""
    car = SteppedCar("T5", speed, VEHICLE)
    for gear in equations.GEARS:
        car.state[equations.INDEX[f"{gear}.vy"]] = sideways
    return car


@pytest.mark.parametrize("sideways", [0.15, 0.3, 0.5, 0.8])
def test_a_car_that_hits_its_flange_goes_on(sideways):
    car, farthest = thrown(sideways), 0.0
    for _ in range(1000):
        car.step()
        farthest = max(farthest, abs(car.state[equations.INDEX["front.y"]]))
    assert 5e-3 < farthest < 8e-3


@pytest.mark.parametrize(("sideways", "tolerance"), [(0.1, 1e-3), (0.5, 0.035)])
def test_energy_balances_towards_the_flange_and_through_a_hit(sideways, tolerance):
    """In the hit the angle turns within a tenth of a millimetre, which the normal force follows to some percent."""
    car, period = thrown(sideways), 5e-5
    rows = [car.energies]
    for _ in range(600):
        car.step(period=period)
        rows.append(car.energies)
    energy, *powers = (np.array([row[name] for row in rows]) for name in rows[0])
    motor, damping, creep = (np.trapezoid(power, dx=period) for power in powers)
    assert creep > 40
    assert energy[-1] - energy[0] == pytest.approx(motor - damping - creep, rel=tolerance)


def test_a_cell_goes_on_along_its_tangent_and_holds_the_rest():
    table = contact_table("s1002", VEHICLE)
    cells = dict(zip(CELL_COLUMNS, table.cells().T, strict=True))
    for beyond in (-30.0, -2.0, 3.0, 40.0):
        offset, small = beyond * table.step, 1e-8
        low, here, high = (in_cell(cells, offset + d) for d in (-small, 0.0, small))
        climb = (high["effective_radius"] - low["effective_radius"]) / (2 * small)
        assert climb == pytest.approx(here["slope"], abs=2e-7)
        end = in_cell(cells, 0.0 if beyond < 0 else table.step)
        for name in ("slope", "rail_contact", "semi_axis_x", "semi_axis_y", "c11", "c33"):
            assert np.allclose(here[name], end[name], rtol=1e-7, atol=1e-9), name  # but for a picometre
        assert here["semi_axis_y"].min() > 0
        further = here["effective_radius"] - end["effective_radius"]
        assert here["rolling_radius"] - end["rolling_radius"] == pytest.approx(further, abs=1e-10)
