"""The car as a component: stepping, linearisation, FMI unit."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.clock import CONTROL_PERIOD
from railrepro.control import law
from railrepro.simulation import closed_loop
from railrepro.track import route
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

TORQUE = np.array([300.0, -300.0, 150.0, -150.0])


@pytest.mark.parametrize("substeps", [1, 4])
def test_stepping_gives_what_the_closed_loop_gives(substeps):
    car = SteppedCar("T3", 50.0)
    control = law.control_law(load_vehicle(), None, lateral_limit=0.03, track_end=car.route.length, stop_speed=-1.0)
    coupled = closed_loop.ClosedLoop(SteppedCar("T3", 50.0, substeps=substeps), control)
    coupled.held[:] = 20.0
    log = coupled.run(500)
    for row in log:
        front, rear = (row[coupled.columns.index(f"{gear}.du")] for gear in equations.GEARS)
        car.step([front, -front, rear, -rear], substeps, CONTROL_PERIOD / substeps)
    assert np.allclose(car.state, coupled.state, rtol=1e-12, atol=1e-12)


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
    """S1002, whose nodes are 0.1 mm apart; a tie of the clamps at a node would halve slopes. Cells differ by 13 %."""
    car = SteppedCar("T5", 20.0, load_vehicle(**{"contact.profile": "s1002"}))
    state, places, slopes = car.state.copy(), equations.indices("front.y", "rear.y"), []
    for apart in (-1e-7, 0.0, 1e-7):
        car.state[:] = state
        car.state[places] = y + apart
        slopes.append(car.linearise().a.loc[[f"w.{wheel}" for wheel in equations.WHEELS], ["front.y", "rear.y"]])
    before, at, after = (slope.to_numpy() for slope in slopes)
    scale = np.abs(at).max()
    low, high = np.minimum(before, after) - 2e-3 * scale, np.maximum(before, after) + 2e-3 * scale
    assert ((at >= low) & (at <= high)).all()
    assert np.abs(after - before).max() < 0.15 * scale


@pytest.mark.parametrize(("profile", "tolerance"), [("cone", 0.005), ("s1002", 0.03)])
def test_linearised_wheelset_runs_in_the_wave_of_klingel(profile, tolerance):
    """Frequency v sqrt(2 conicity / (b r)) at low speed; the spin moment of S1002 slows it by 2 %."""
    vehicle, speed = load_vehicle(**{"contact.profile": profile, "gear.axle_damping": 1e8}), 2.0
    car = SteppedCar("T5", speed, vehicle)
    names = [f"front.{name}" for name in ("y", "psi", "z", "phi", "vy", "vz", "wx", "wz")]
    names += ["w.front_le", "w.front_ri"]
    poles = np.linalg.eigvals(car.linearise().a.loc[names, names].to_numpy())
    found = poles.imag[(poles.imag > 1e-3) & (np.abs(poles.real) < 0.1)]
    table = car.table.frame[car.table.frame["shift_m"].abs() < 1.5e-4]
    radius, shift = table["rolling_radius_m"], table["shift_m"]
    conicity = np.ptp(radius) / np.ptp(shift)
    expected = speed * np.sqrt(2 * conicity / (vehicle.gear.contact_base * radius.mean()))
    assert found == pytest.approx([expected], rel=tolerance)


def test_time_counts_the_steps_and_torques_are_held():
    car = SteppedCar("T5", 50.0)
    car.step(TORQUE, steps=3)
    car.step(period=2e-4, steps=5)
    assert car.time == pytest.approx(3e-3 + 5 * 2e-4)
    assert car.torque.tolist() == TORQUE.tolist()
    assert car.outputs["front.p"] == pytest.approx(50.0 * 4e-3, rel=1e-3)


def test_the_car_is_that_of_the_vehicle_on_the_route_it_is_given():
    way = route.lay(load_track("T3"))
    light, heavy = (SteppedCar(way, 50.0, load_vehicle(**{"body.mass": mass})) for mass in (22_000.0, 28_000.0))
    assert light.route is way
    gained = heavy.outputs["rear_le.N"] - light.outputs["rear_le.N"]
    assert gained == pytest.approx(6000 * 9.81 / 4 / np.cos(heavy.outputs["rear_le.angle"]), rel=1e-4)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_state_that_leaves_all_bounds_is_named_and_kept_out(sign):
    car = SteppedCar("T5", 50.0)
    car.step(steps=10)
    good = car.state.copy()
    car.torque[0] = np.nan
    with pytest.raises(ArithmeticError, match=r"left all bounds at t = 0\.010 s, p = "):
        car.step(steps=5)
    assert np.array_equal(car.state, good)
    car.torque[0], car.state[equations.INDEX["w.rear_ri"]] = 0.0, sign * 1.2e7
    named = rf"w\.rear_ri = {'-' if sign < 0 else ''}1\.2e\+07 left all bounds at t = 0\.010 s, p = 0\.5 m"
    with pytest.raises(ArithmeticError, match=named):
        car.step(steps=3)
