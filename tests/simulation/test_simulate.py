"""Co-simulation: whole runs, endings, warnings, scenario files."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest

from railrepro.car import equations
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.interface import MEASURED
from railrepro.control.mpc import NMPC
from railrepro.control.ndi import NDI
from railrepro.control.problem import MPCSettings
from railrepro.data import InputError
from railrepro.estimation.sensors import Latency, Readings, load_loop
from railrepro.quantities import GEARS
from railrepro.simulation import closed_loop, metrics, scenarios, simulate
from railrepro.track.rough import LateralOffset
from railrepro.track.route import COLUMNS, INDEX, irregularity_in
from railrepro.vehicle.parameters import load_vehicle


@pytest.mark.parametrize("guidance", [NMPC, NDI(pole=40, frequency=40)])
def test_a_run_ends_with_a_reason_and_without_warnings(guidance):
    run = simulate.run(scenarios.load_scenario("curve_entry_T3").but(end_m=100), guidance)
    assert run.ended.startswith("end of the run") and not run.failed
    assert run.warnings == () and np.isfinite(run.series.to_numpy()).all()


def test_offset_observer_removes_the_drift_in_the_curve():
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=450.0)
    drift = []
    for observer in (0.0, 0.05):
        settings = MPCSettings(period=0.005, r=1e-11, observer=observer)
        run = simulate.run(scenario, lambda v, w, g, s=settings: NMPC(v, w, g, s, solver="rti"))
        drift.append(abs(np.mean(metrics.lateral_error(run.series)[-1500:])))
    assert drift[0] > 5e-4 > 4 * drift[1]


@pytest.mark.parametrize(
    ("period", "solver", "sentence"),
    [(0.01, "magic", "NMPC solver 'magic' is not known"), (0.0105, "rti", r"whole number of ms; found \[10.5\] ms")],
)
def test_a_wrong_controller_is_refused_before_the_car_is_compiled(period, solver, sentence, monkeypatch):
    class Own(NMPC):
        period = property(lambda self: period)

    monkeypatch.setattr(simulate, "start", lambda *_: pytest.fail("the car is compiled"))
    with pytest.raises(InputError, match=sentence):
        simulate.run(scenarios.load_scenario("sine_tracking"), lambda v, w, g: Own(v, w, g, solver=solver))


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
        assert np.array(states) == pytest.approx(
            series[[name for name in MEASURED if name.startswith(f"{gear}.")]].to_numpy()[::4], rel=1e-12
        )
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
def test_the_delay_that_is_reported_is_the_age_of_the_readings_when_their_torque_acts(measurement, command):
    """Counted in the log: the row whose displacement was read before the step, and the row in which torque rises."""
    loop = replace(load_loop().perfect(), latency=Latency(1e-3 * measurement, 1e-3 * command))
    scenario = scenarios.load_scenario("sine_tracking").but(end_m=22.0, set_point={"kind": "none"})
    run = simulate.run(scenario, lambda v, w, gear: Step(), sensors=Readings(loop))
    guided, y = run.controllers[0], run.series["front.y"].to_numpy()
    last = guided.seen[149][0]  # of the first torque that steps; there is no reading before the first cycle
    seen = int(np.argmin(np.abs(y - last)))
    assert y[seen] == pytest.approx(last, abs=1e-12) and (np.diff(y[100:170]) != 0).all()
    acts = int(np.flatnonzero(run.series["front_le.tau"] > 20.01)[0]) - 1
    assert guided.delays == {acts - seen}


def test_sensors_measure_against_the_rails_wherever_these_lie():
    """A bend of 3 mm to the right and back; the reading is that of the cycle before."""
    p = np.arange(0.0, 80.0, 0.5)
    rails = LateralOffset(5.0, 30.0, 3e-3, transition=8.0).at(p)
    scenario = scenarios.load_scenario("sine_tracking").but(end_m=22.0, set_point={"kind": "none"})
    sensors = Readings(load_loop().perfect())
    run = simulate.run(scenario, lambda v, w, gear: Step(), sensors=sensors, irregularities=rails)
    place, (y, psi) = run.series["front.p"], run.series[["front.y", "front.psi_TrAx"]].to_numpy().T
    cells = dict(zip(COLUMNS, scenario.route(rails).rows_at(place).T, strict=True))
    aside, slope = irregularity_in(cells, "lateral", place.to_numpy())[:2]
    assert aside == pytest.approx(np.interp(place, p, rails["lateral_m"]), abs=2e-4)
    read = np.array(run.controllers[0].seen)[:, :2].T
    assert read == pytest.approx(np.array([y - aside, psi - slope])[:, : read.shape[1]], abs=1e-9)
    assert aside.max() > 2e-3 and slope.max() > 4e-4


def braked(**changes):
    """A car whose front gear brakes it to rest from 6 km/h within three metres of level straight track."""
    slow = {"track": "T5", "speed_kmh": 6.0, "end_m": 4.0, "force_kN": [[0, -20.0]]}
    brisk = AdhesionSettings(active=False, raise_step=100.0)
    return simulate.run(scenarios.load_scenario("sine_tracking").but(**slow | changes), NDI(), adhesion=brisk)


def test_a_step_of_the_demand_comes_where_it_is_stated_and_lasts_to_the_next():
    route = scenarios.load_scenario("sine_tracking").but(force_kN=[[10, 4.0], [20, -6.0]]).route()
    force = route.rows_at(np.array([0.0, 9.9, 10.0, 19.9, 20.0, 90.0]))[:, INDEX["force"]]
    assert force == pytest.approx([0.0, 0.0, 4e3, 4e3, -6e3, -6e3])


def test_a_set_point_has_the_amplitude_period_and_start_that_are_stated():
    sine = {"kind": "sine", "amplitude_mm": 2.0, "period_m": 50.0, "start_m": 10.0, "end_m": 200.0, "fade_m": 20.0}
    route = scenarios.load_scenario("sine_tracking").but(set_point=sine).route()
    assert route.reference_at(np.array([47.5, 5.0, 205.0]))[0] == pytest.approx([-2e-3, 0.0, 0.0])


def test_a_run_that_comes_to_rest_ends_after_ten_times_its_way_at_the_initial_speed():
    run = braked(set_point={"kind": "none"})
    assert run.ended.startswith("time limit reached at t = 23.999 s, p = ")
    assert not run.failed
    assert run.series["front.v"].iloc[-1] == pytest.approx(0.0, abs=0.02)
    slow = run.series[run.series["front.v"] < 1.0].iloc[0]
    said = f"front gear is slower than the slip regularisation at t = {slow['t_s']:.3f} s, p = {slow['front.p']:.1f} m"
    assert said in run.warnings


def test_a_run_ends_at_its_stop_speed_and_at_its_end():
    stopped = braked(set_point={"kind": "none"}, stop_kmh=1.8)
    assert stopped.ended.startswith("stop speed reached at t = ")
    assert not stopped.failed
    assert stopped.series["front.v"].iloc[-1] == pytest.approx(0.5, abs=2e-3)
    passed = braked(set_point={"kind": "none"}, end_m=1.5)
    assert passed.ended.startswith("end of the run at t = ")
    assert not passed.failed
    assert passed.series["front.p"].iloc[-2] < 1.5 <= passed.series["front.p"].iloc[-1]


def test_a_derailment_tells_which_gear_left_the_rail_how_far_and_where():
    cone = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
    run = simulate.run(scenarios.load_scenario("curve_entry_T2"), NDI(pole=1e-3, frequency=1e-3), vehicle=cone)
    last = run.series.iloc[-1]
    gear = "front" if abs(last["front.y"]) >= simulate.DERAILED else "rear"
    assert run.failed
    assert run.ended == (
        f"{gear} gear derailed, |y| = {1e3 * abs(last[gear + '.y']):.1f} mm "
        f"at t = {last['t_s']:.3f} s, p = {last['front.p']:.1f} m"
    )
    assert np.abs(run.series[["front.y", "rear.y"]].iloc[:-1].to_numpy()).max() < 0.030


def test_the_plant_may_differ_from_what_the_controllers_believe():
    scenario = scenarios.load_scenario("sine_tracking").but(end_m=2.0, force_kN=[[0, 8.0]])
    heavy, seen = load_vehicle(**{"body.mass": 28_000.0}), []

    def factory(vehicle, route, gear):
        seen.append(vehicle.body.mass)
        return Counting(gear)

    loads = [
        simulate.run(scenario, factory, **bodies).series["front_le.N"].iloc[0]
        for bodies in (
            {},
            {"plant_vehicle": heavy},
            {"vehicle": heavy},
            {"vehicle": heavy, "plant_vehicle": load_vehicle()},
        )
    ]
    assert np.diff(loads)[0] == pytest.approx(500 * 9.81 / np.cos(0.025), rel=1e-3)
    assert loads[2] == pytest.approx(loads[1]) and loads[3] == pytest.approx(loads[0])
    assert seen[::2] == [26_000.0, 26_000.0, 28_000.0, 28_000.0]


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
        ("rear_le.angle", -0.7, "rear_le wheel touches with its flange"),
        ("rear.yaw_to_body", 0.0501, "rear gear is on its yaw end stop"),
        ("front.yaw_to_body", -0.0501, "front gear is on its yaw end stop"),
        ("rear.v", 0.99, "rear gear is slower than the slip regularisation"),
        ("rear.y", -7.1e-3, "rear gear is where flanges would touch, cones have none"),
        ("front.rail_y", 7.1e-3, "front gear is where flanges would touch, cones have none"),
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
