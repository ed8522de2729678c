"""Co-simulation: whole runs, endings, warnings, scenario files."""

import signal
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

from railrepro.car import equations
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.interface import MEASURED
from railrepro.control.ndi import NDI
from railrepro.estimation.sensors import Latency, Readings, load_loop
from railrepro.own.lqg import LqgPreview
from railrepro.quantities import GEARS
from railrepro.simulation import scenarios, simulate
from railrepro.track.irregularity import CHANNELS
from railrepro.track.rough import LateralOffset
from railrepro.track.route import COLUMNS, INDEX, irregularity_in
from railrepro.vehicle.parameters import load_vehicle

NO_SET_POINT = {"set_point": {"kind": "none"}}


class Slow:
    """A slow controller that keeps what it gets; its torque (N m) is a function of how often it was asked."""

    def __init__(self, torque, period=0.004):
        self.torque, self.period, self.given, self.read_before = torque, period, [], []

    def read(self, readings, delay):
        self.read_before.append((np.array(readings), round(1e3 * delay, 9)))

    def plan(self, x_hat, u_d):
        self.given.append((np.array(x_hat), u_d))
        return self.torque(len(self.given))


def counting(vehicle, route, gear, **options):
    """Slow controller of a gear whose torque is how often it was asked, in N m, doubled for the rear gear."""
    return Slow(lambda n: float(n * (1 + gear)), **options)


def test_a_slow_controller_gets_the_state_of_its_gear_and_its_torque_is_held():
    pull = {"force_kN": [[0, 5.0]], "end_m": 3.0} | NO_SET_POINT
    run = simulate.run(scenarios.load_scenario("sine_tracking").but(**pull), counting)
    series, samples = run.series, len(run.series[::4])
    assert series["t_s"].to_numpy() == pytest.approx(1e-3 * np.arange(len(series)))
    asked = 1 + np.arange(len(series)) // 4
    for g, gear in enumerate(GEARS):
        assert series[f"{gear}.du"].to_numpy() == pytest.approx((1 + g) * asked)
        states, base = zip(*run.controllers[g].given, strict=True)
        assert len(states) == samples
        columns = [name for name in MEASURED if name.startswith(f"{gear}.")]
        assert np.array(states) == pytest.approx(series[columns].to_numpy()[::4], rel=1e-12)
        before = np.append(0.0, series[f"{gear}.u_d"].to_numpy()[3::4])[:samples]
        assert np.array(base) == pytest.approx(before, rel=1e-12)
    assert series["front.u_d"].max() > 20.0


@pytest.mark.parametrize(("measurement", "command"), [(0, 0), (4, 0), (3, 2)])
def test_readings_are_against_the_rails_and_as_old_as_reported_when_their_torque_acts(measurement, command):
    """On a bend of 3 mm, counted in the log: from the row that was read before the torque steps to the row in which it
    rises."""
    loop = replace(load_loop().perfect(), latency=Latency(1e-3 * measurement, 1e-3 * command))
    offset, p = LateralOffset(5.0, 30.0, 3e-3, transition=8.0), np.arange(0.0, 80.0, 0.5)
    rails = pd.DataFrame({"p_m": p} | dict.fromkeys(CHANNELS.values(), 0.0) | offset.channels(p))
    scenario = scenarios.load_scenario("sine_tracking").but(end_m=22.0, **NO_SET_POINT)
    slow = [Slow(lambda n: 20.0 if n <= 150 else 60.0, period=1e-3) for _ in GEARS]
    run = simulate.run(scenario, lambda v, w, g: slow[g], sensors=Readings(loop), irregularities=rails)
    p = run.series["front.p"].to_numpy()
    cells = dict(zip(COLUMNS, scenario.route(rails).rows_at(p).T, strict=True))
    rail, slope = irregularity_in(cells, "lateral", p)
    true = run.series[["front.y", "front.psi_TrAx"]].to_numpy() - np.transpose([rail, slope])
    last, delay = slow[0].read_before[149]  # before the first torque that steps; nothing is read before the first cycle
    row = int(np.argmin(np.abs(true - last[:2]).max(axis=1)))
    assert true[row] == pytest.approx(last[:2], abs=1e-12) and rail.max() > 2e-3 and slope.max() > 4e-4
    assert delay == int(run.series["front_le.tau"][100:].diff().argmax()) + 99 - row


@pytest.mark.parametrize("front", [0, 1])
def test_gears_may_have_controllers_of_different_kinds(front):
    """Compiled and called from Python: each starts with the torques that it has next to one of its own kind."""
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=5.0)
    kinds = [partial(counting, period=1e-3), LqgPreview()]
    pure = [simulate.run(scenario, kind).series for kind in kinds]
    mixed = simulate.run(scenario, lambda v, w, gear: kinds[front ^ gear](v, w, gear)).series
    for gear, kind in (("front", front), ("rear", 1 - front)):
        assert mixed[f"{gear}.du"][:20].to_numpy() == pytest.approx(pure[kind][f"{gear}.du"][:20], rel=1e-2, abs=0.5)
    assert mixed["rear.du" if front else "front.du"].iloc[19] > 10.0


def test_demand_and_set_point_lie_on_the_route_where_they_are_stated():
    sine = {"kind": "sine", "amplitude_mm": 2.0, "period_m": 50.0, "start_m": 10.0, "end_m": 200.0, "fade_m": 20.0}
    route = scenarios.load_scenario("sine_tracking").but(force_kN=[[10, 4.0], [20, -6.0]], set_point=sine).route()
    force = route.rows_at(np.array([0.0, 9.9, 10.0, 19.9, 20.0, 90.0]))[:, INDEX["force"]]
    assert force == pytest.approx([0.0, 0.0, 4e3, 4e3, -6e3, -6e3])
    assert route.reference_at(np.array([47.5, 5.0, 205.0]))[0] == pytest.approx([-2e-3, 0.0, 0.0])


@pytest.mark.parametrize(
    ("changes", "column", "limit", "sentence"),
    [
        ({}, "front.v", 0.0, "the car stands"),
        ({"stop_kmh": 1.8}, "front.v", 0.5, "stop speed reached"),
        ({"end_m": 1.5}, "front.p", 1.5, "end of the run"),
    ],
)
def test_a_run_ends_in_the_first_row_beyond_a_limit(changes, column, limit, sentence):
    """A car that brakes from 6 km/h to rest within three metres of level straight track."""
    slow = {"track": "T5", "speed_kmh": 6.0, "end_m": 4.0, "force_kN": [[0, -20.0]]} | NO_SET_POINT | changes
    brisk = AdhesionSettings(active=False, raise_step=100.0)
    run = simulate.run(scenarios.load_scenario("sine_tracking").but(**slow), NDI(), adhesion=brisk)
    last = run.series.iloc[-1]
    assert run.ended == f"{sentence} at t = {last['t_s']:.3f} s, p = {last['front.p']:.1f} m" and not run.failed
    before, after = (run.series[column] - limit).tail(2)
    assert before * after <= 0 and before != 0
    if column == "front.v":
        assert last["t_s"] < 1.5 * last["front.p"] / (6.0 / 3.6 / 2)
        row = run.series[run.series["front.v"] < 1.0].iloc[0]
        place = f"at t = {row['t_s']:.3f} s, p = {row['front.p']:.1f} m"
        assert f"front gear is slower than the slip regularisation {place}" in run.warnings


def test_a_derailment_names_gear_displacement_and_place():
    cone = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
    run = simulate.run(scenarios.load_scenario("curve_entry_T2"), NDI(pole=1e-3, frequency=1e-3), vehicle=cone)
    last, y = run.series.iloc[-1], run.series[["front.y", "rear.y"]].abs().max(axis=1)
    gear = "front" if abs(last["front.y"]) >= 0.030 else "rear"
    place = f"at t = {last['t_s']:.3f} s, p = {last['front.p']:.1f} m"
    assert run.failed and run.ended == f"{gear} gear derailed, |y| = {1e3 * y.iloc[-1]:.1f} mm {place}"
    assert y.iloc[:-1].max() < 0.030


def test_the_plant_may_differ_from_the_vehicle_of_the_controllers():
    scenario = scenarios.load_scenario("sine_tracking").but(end_m=2.0, force_kN=[[0, 8.0]])
    heavy, seen = load_vehicle(**{"body.mass": 28_000.0}), []

    def factory(vehicle, route, gear):
        seen.append(vehicle.body.mass)
        return counting(vehicle, route, gear)

    given = {"plant_vehicle": heavy}, {"vehicle": heavy}, {"vehicle": heavy, "plant_vehicle": load_vehicle()}
    loads = [simulate.run(scenario, factory, **bodies).series["front_le.N"].iloc[0] for bodies in given]
    assert loads[0] == loads[1] == pytest.approx(loads[2] + 500 * 9.81 / np.cos(0.025), rel=1e-4)
    assert seen[::2] == [26_000.0, 28_000.0, 28_000.0]


@pytest.mark.parametrize(
    ("column", "value", "sentence"),
    [
        ("front_le.N", 0.0, "front_le wheel lifts"),
        ("rear_ri.angle", 0.7, "rear_ri wheel: its flange touches the rail"),
        ("front.yaw_to_body", -0.0501, "front gear is on its yaw end stop"),
        ("rear.v", 0.99, "rear gear is slower than the slip regularisation"),
        ("rear.y", -7.1e-3, "rear gear is where flanges would touch, cones have none"),
    ],
)
def test_a_warning_names_the_first_place_outside_the_validity_of_a_model(column, value, sentence):
    calm = {f"{wheel}.{name}": value for wheel in equations.WHEELS for name, value in (("N", 7e4), ("angle", 0.03))}
    calm |= {f"{gear}.{name}": 0.0 for gear in GEARS for name in ("y", "rail_y", "yaw_to_body")}
    calm |= {"front.v": 20.0, "rear.v": 20.0, "t_s": [0.0, 0.5, 1.0, 1.5], "front.p": [0.0, 10.0, 20.0, 30.0]}
    series = pd.DataFrame(calm)
    cone, worn = (load_vehicle(**{"contact.profile": profile}) for profile in ("cone", "s1002"))
    assert simulate._warnings(series, cone) == ()
    series.loc[2:, column] = value
    assert simulate._warnings(series, cone) == (f"{sentence} at t = 1.000 s, p = 20.0 m",)
    assert simulate._warnings(series, worn) == (() if "cones" in sentence else simulate._warnings(series, cone))


def test_a_run_ends_before_what_is_not_finite(monkeypatch):
    drive = simulate._drive

    def broken(*of):
        log = drive(*of)
        log[50, 3] = np.nan
        return log

    monkeypatch.setattr(simulate, "_drive", broken)
    run = simulate.run(scenarios.load_scenario("curve_entry_T3").but(end_m=20), NDI())
    assert run.failed and len(run.series) == 50 and " is not a finite number at t = 0.050 s" in run.ended


def test_ctrl_c_is_seen_while_a_second_of_the_run_takes_seconds():
    """The interrupt comes from a clock of processor time, so that the load of the machine does not matter."""
    scenario, vehicle = scenarios.load_scenario("curve_entry_T3"), load_vehicle()
    loop = simulate.start(scenario, NDI(), scenario.route(), vehicle, vehicle, substeps=2000)
    before = signal.signal(signal.SIGVTALRM, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.5)
        with pytest.raises(KeyboardInterrupt):
            loop.run(1000)
    finally:
        signal.signal(signal.SIGVTALRM, before)
    assert loop.state[equations.indices("body.s")] < 0.5 * scenario.speed
