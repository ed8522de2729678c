"""The car as a component: stepping, arrays, copies, linearisation."""

import copy
import pickle

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.table import contact_table
from railrepro.control import law
from railrepro.simulation import closed_loop
from railrepro.vehicle.parameters import load_vehicle


@pytest.mark.parametrize("substeps", [1, 4])
def test_stepping_gives_what_the_closed_loop_gives(substeps):
    car = SteppedCar("T3", 50.0)
    control = law.control_law(load_vehicle(), None, lateral_limit=0.03, track_end=car.route.length, stop_speed=-1.0)
    coupled = closed_loop.ClosedLoop(SteppedCar("T3", 50.0, substeps=substeps), control)
    coupled.car.step(period=5e-3, steps=0)
    coupled.held = [20.0, 20.0]
    log = coupled.run(500)
    for row in log:
        front, rear = (row[coupled.columns.index(f"{gear}.du")] for gear in equations.GEARS)
        car.step([front, -front, rear, -rear], substeps, CONTROL_PERIOD / substeps)
    assert np.allclose(car.state, coupled.state, rtol=1e-12, atol=1e-12)


def test_assigned_arrays_are_those_that_the_car_steps_with():
    car, other = SteppedCar("T5", 50.0), SteppedCar("T5", 50.0)
    car.state, car.parameters = car.state.copy(), car.parameters.copy()
    car.torque = np.full(4, 2000.0)
    car.step(steps=1000)
    other.step([2000.0] * 4, 1000)
    assert np.array_equal(car.state, other.state) and 50.1 < car.outputs["front.v"] < 51.0
    car.state = SteppedCar("T5", 20.0).state
    assert (car.outputs["front.p"], car.outputs["front.v"]) == (0.0, 20.0)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_a_copy_of_a_car_moves_by_itself_and_as_the_car_does(copied):
    car = SteppedCar("T3", 50.0)
    car.step([100.0, -100.0, 0.0, 0.0], steps=300)
    state, other = car.state.copy(), copied(car)
    other.step(steps=100)
    assert np.array_equal(car.state, state) and (car.time, other.time) == (0.3, 0.4)
    car.step(steps=100)
    assert np.array_equal(car.state, other.state) and car.outputs == other.outputs
    with pytest.raises(TypeError, match="a SteppedCar cannot be pickled: send its route, speed and vehicle"):
        pickle.dumps(car)


def test_linearisation_names_its_rows_and_columns():
    """A motor's torque lags behind its command by 5 ms, and a displacement is an output of its own gear."""
    car = SteppedCar("T3", 60.0)
    model = car.linearise()
    assert model.b.loc["tau.rear_le", "rear_le"] == pytest.approx(200.0) and np.count_nonzero(model.b) == 4
    assert model.a.loc["tau.rear_le", "tau.rear_le"] == pytest.approx(-200.0)
    assert model.c.loc["rear.y", "rear.y"] == model.c.loc["front_ri.tau", "tau.front_ri"] == 1.0
    assert list(model.d.index) == list(equations.car().outputs) and not model.d.to_numpy().any()


@pytest.mark.parametrize("y", [0.0, 1e-4, 3e-4, 1e-3, -2e-3])
def test_linearisation_at_a_node_of_the_contact_table_is_that_beside_it(y):
    """Nodes of S1002 are 0.1 mm apart, and cells differ by 13 %. A tie of the clamps at a node would halve slopes."""
    car, lateral, slopes = SteppedCar("T5", 20.0), ["front.y", "rear.y"], []
    for apart in (-1e-7, 0.0, 1e-7):
        car.state[equations.indices(*lateral)] = y + apart
        slopes.append(car.linearise().a.loc[[f"w.{wheel}" for wheel in equations.WHEELS], lateral].to_numpy())
    before, at, after = slopes
    scale = np.abs(at).max()
    low, high = np.minimum(before, after) - 2e-3 * scale, np.maximum(before, after) + 2e-3 * scale
    assert ((at >= low) & (at <= high)).all()
    assert np.abs(after - before).max() < 0.15 * scale


def test_time_counts_the_steps_torques_are_held_and_the_state_that_leaves_all_bounds_is_named_and_kept_out():
    car = SteppedCar("T5", 50.0)
    car.step([300.0, -300.0, 150.0, -150.0], steps=3)
    car.step(period=1e-3 / 5, steps=35)
    assert car.time == pytest.approx(0.01) and car.outputs["front.p"] == pytest.approx(50.0 * car.time, rel=1e-3)
    assert car.torque.tolist() == [300.0, -300.0, 150.0, -150.0]
    good, car.torque[0] = car.state.copy(), np.nan
    with pytest.raises(ArithmeticError, match=r"left all bounds at t = 0\.010 s, p = "):
        car.step(steps=5)
    assert np.array_equal(car.state, good)
    car.torque[0], car.state[equations.INDEX["w.rear_ri"]] = 0.0, -1.2e7
    named = r"w\.rear_ri = -1\.2e\+07 left all bounds at t = 0\.010 s, p = 0\.5 m"
    with pytest.raises(ArithmeticError, match=named):
        car.step(steps=3)


def test_an_edited_contact_table_moves_the_wheels_at_rest():
    """The state at rest is stored by the content of the table, not by the object."""
    table = contact_table("cone", load_vehicle())
    before = SteppedCar("T1", 20.0, table=table).state.copy()
    table.frame["normal_stiffness"] *= 0.5
    sunk = SteppedCar("T1", 20.0, table=table).state - before
    assert 1e-5 < sunk[equations.STATES.index("body.z")] < 1e-3
