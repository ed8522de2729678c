"""Co-simulation: whole runs, endings, warnings, scenario files."""

import signal
from dataclasses import dataclass, replace

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
from railrepro.simulation import closed_loop, scenarios, simulate
from railrepro.track.irregularity import CHANNELS
from railrepro.track.rough import LateralOffset
from railrepro.track.route import COLUMNS, INDEX, irregularity_in
from railrepro.vehicle.parameters import load_vehicle


@dataclass
class Counting:
    """A slow controller that hands in how often it was asked, in N m, and keeps what it was given."""

    gear: int
    period: float = 0.004

    def __post_init__(self):
        self.given = []

    def plan(self, x_hat, u_d):
        self.given.append((np.array(x_hat), u_d))
        return float(len(self.given) * (1 + self.gear))


def test_a_slow_controller_gets_the_state_of_its_gear_and_its_torque_is_held():
    pull = {"force_kN": [[0, 5.0]], "end_m": 3.0, "set_point": {"kind": "none"}}
    run = simulate.run(scenarios.load_scenario("sine_tracking").but(**pull), lambda v, w, gear: Counting(gear))
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


@dataclass
class Step:
    """A slow controller whose torque steps after some cycles; keeps what it reads."""

    period: float = 1e-3

    def __post_init__(self):
        self.seen, self.delays, self.asked = [], set(), 0

    def read(self, readings, delay):
        self.seen.append(np.array(readings))
        self.delays.add(round(1e3 * delay, 9))

    def plan(self, x_hat, u_d):
        self.asked += 1
        return 20.0 if self.asked <= 150 else 60.0


@pytest.mark.parametrize(("measurement", "command"), [(0, 0), (4, 0), (3, 2)])
def test_readings_are_against_the_rails_and_as_old_as_reported_when_their_torque_acts(measurement, command):
    """On a bend of 3 mm, counted in the log: the row that was read before the step, and that in which torque rises."""
    loop = replace(load_loop().perfect(), latency=Latency(1e-3 * measurement, 1e-3 * command))
    offset, p = LateralOffset(5.0, 30.0, 3e-3, transition=8.0), np.arange(0.0, 80.0, 0.5)
    rails = pd.DataFrame({"p_m": p} | dict.fromkeys(CHANNELS.values(), 0.0) | offset.channels(p))
    scenario = scenarios.load_scenario("sine_tracking").but(end_m=22.0, set_point={"kind": "none"})
    run = simulate.run(scenario, lambda v, w, gear: Step(), sensors=Readings(loop), irregularities=rails)
    place, guided = run.series["front.p"].to_numpy(), run.controllers[0]
    cells = dict(zip(COLUMNS, scenario.route(rails).rows_at(place).T, strict=True))
    aside, slope = irregularity_in(cells, "lateral", place)[:2]
    shown = run.series[["front.y", "front.psi_TrAx"]].to_numpy() - np.transpose([aside, slope])
    last = guided.seen[149]  # of the first torque that steps; there is no reading before the first cycle
    seen = int(np.argmin(np.abs(shown - last[:2]).max(axis=1)))
    assert shown[seen] == pytest.approx(last[:2], abs=1e-12) and aside.max() > 2e-3 and slope.max() > 4e-4
    assert guided.delays == {int(run.series["front_le.tau"][100:].diff().argmax()) + 99 - seen}


@pytest.mark.parametrize("front", [0, 1])
def test_gears_may_have_controllers_of_different_kinds(front):
    """Compiled and called from Python; each gives the first torque that it gives beside one of its own kind."""
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=5.0)
    kinds = [lambda v, w, gear: Counting(gear, 1e-3), LqgPreview()]
    pure = [simulate.run(scenario, kind).series for kind in kinds]
    mixed = simulate.run(scenario, lambda v, w, gear: kinds[front ^ gear](v, w, gear)).series
    for gear, kind in (("front", front), ("rear", 1 - front)):
        assert mixed[f"{gear}.du"][:20].to_numpy() == pytest.approx(pure[kind][f"{gear}.du"][:20], rel=1e-2, abs=0.5)
    assert mixed["rear.du" if front else "front.du"].iloc[19] > 10.0


def braked(**changes):
    """A car whose front gear brakes it to rest from 6 km/h within three metres of level straight track."""
    slow = {"track": "T5", "speed_kmh": 6.0, "end_m": 4.0, "force_kN": [[0, -20.0]]}
    brisk = AdhesionSettings(active=False, raise_step=100.0)
    return simulate.run(scenarios.load_scenario("sine_tracking").but(**slow | changes), NDI(), adhesion=brisk)


def test_demand_and_set_point_lie_on_the_route_where_they_are_stated():
    sine = {"kind": "sine", "amplitude_mm": 2.0, "period_m": 50.0, "start_m": 10.0, "end_m": 200.0, "fade_m": 20.0}
    route = scenarios.load_scenario("sine_tracking").but(force_kN=[[10, 4.0], [20, -6.0]], set_point=sine).route()
    force = route.rows_at(np.array([0.0, 9.9, 10.0, 19.9, 20.0, 90.0]))[:, INDEX["force"]]
    assert force == pytest.approx([0.0, 0.0, 4e3, 4e3, -6e3, -6e3])
    assert route.reference_at(np.array([47.5, 5.0, 205.0]))[0] == pytest.approx([-2e-3, 0.0, 0.0])


def test_a_run_that_comes_to_rest_ends_there():
    run = braked(set_point={"kind": "none"})
    assert run.ended.startswith("the car stands at t = ") and not run.failed
    speed, mean = run.series["front.v"].to_numpy(), 6.0 / 3.6 / 2
    assert speed[-1] <= 0 < speed[-2] and run.series["t_s"].iloc[-1] < 1.5 * run.series["front.p"].iloc[-1] / mean
    slow = run.series[run.series["front.v"] < 1.0].iloc[0]
    said = f"front gear is slower than the slip regularisation at t = {slow['t_s']:.3f} s, p = {slow['front.p']:.1f} m"
    assert said in run.warnings


def test_a_run_ends_at_its_stop_speed_and_at_its_end():
    stopped = braked(set_point={"kind": "none"}, stop_kmh=1.8)
    assert stopped.ended.startswith("stop speed reached at t = ") and not stopped.failed
    assert stopped.series["front.v"].iloc[-1] == pytest.approx(0.5, abs=2e-3)
    passed = braked(set_point={"kind": "none"}, end_m=1.5)
    assert passed.ended.startswith("end of the run at t = ") and not passed.failed
    assert passed.series["front.p"].iloc[-2] < 1.5 <= passed.series["front.p"].iloc[-1]


def test_a_derailment_tells_which_gear_left_the_rail_how_far_and_where():
    cone = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
    run = simulate.run(scenarios.load_scenario("curve_entry_T2"), NDI(pole=1e-3, frequency=1e-3), vehicle=cone)
    last, aside = run.series.iloc[-1], run.series[["front.y", "rear.y"]].abs().max(axis=1)
    gear = "front" if abs(last["front.y"]) >= 0.030 else "rear"
    place = f"at t = {last['t_s']:.3f} s, p = {last['front.p']:.1f} m"
    assert run.failed and run.ended == f"{gear} gear derailed, |y| = {1e3 * aside.iloc[-1]:.1f} mm {place}"
    assert aside.iloc[:-1].max() < 0.030


def test_the_plant_may_differ_from_what_the_controllers_believe():
    scenario = scenarios.load_scenario("sine_tracking").but(end_m=2.0, force_kN=[[0, 8.0]])
    heavy, seen = load_vehicle(**{"body.mass": 28_000.0}), []

    def factory(vehicle, route, gear):
        seen.append(vehicle.body.mass)
        return Counting(gear)

    given = {"plant_vehicle": heavy}, {"vehicle": heavy}, {"vehicle": heavy, "plant_vehicle": load_vehicle()}
    loads = [simulate.run(scenario, factory, **bodies).series["front_le.N"].iloc[0] for bodies in given]
    assert loads[0] == loads[1] == pytest.approx(loads[2] + 500 * 9.81 / np.cos(0.025), rel=1e-4)
    assert seen[::2] == [26_000.0, 28_000.0, 28_000.0]


def calm_series():
    """Four rows within the validity of all models."""
    columns = {f"{wheel}.{name}": value for wheel in equations.WHEELS for name, value in (("N", 7e4), ("angle", 0.03))}
    columns |= {f"{gear}.{name}": value for gear in GEARS for name, value in (("yaw_to_body", 0.01), ("v", 20.0))}
    columns |= {f"{gear}.{name}": 0.0 for gear in GEARS for name in ("y", "rail_y")}
    return pd.DataFrame({"t_s": [0.0, 0.5, 1.0, 1.5], "front.p": [0.0, 10.0, 20.0, 30.0]} | columns)


@pytest.mark.parametrize(
    ("column", "value", "sentence"),
    [
        ("front_le.N", 0.0, "front_le wheel lifts"),
        ("rear_ri.angle", 0.7, "rear_ri wheel touches with its flange"),
        ("front.yaw_to_body", -0.0501, "front gear is on its yaw end stop"),
        ("rear.v", 0.99, "rear gear is slower than the slip regularisation"),
        ("rear.y", -7.1e-3, "rear gear is where flanges would touch, cones have none"),
    ],
)
def test_the_first_place_outside_the_validity_of_a_model_is_told(column, value, sentence):
    series = calm_series()
    cone, worn = (load_vehicle(**{"contact.profile": profile}) for profile in ("cone", "s1002"))
    assert simulate._warnings(series, cone) == ()
    series.loc[2:, column] = value
    assert simulate._warnings(series, cone) == (f"{sentence} at t = 1.000 s, p = 20.0 m",)
    assert simulate._warnings(series, worn) == (() if "cones" in sentence else simulate._warnings(series, cone))


def test_blocks_of_the_log_leave_no_seam(monkeypatch):
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=20)
    whole = simulate.run(scenario, NDI()).series
    monkeypatch.setattr(closed_loop, "_BLOCK", 7)
    assert simulate.run(scenario, NDI()).series.equals(whole)


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
    """The interrupt comes from a clock that runs with the processor, so that a busy machine decides nothing."""
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
