"""The filter of a running gear: its model, its estimates of creep and force, and its part in closed loop."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from railrepro.control import law
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.ndi import NDI
from railrepro.estimation import observers
from railrepro.estimation.observers import LATERAL, FilterState, lateral_matrices
from railrepro.estimation.sensors import Latency, Readings, load_loop
from railrepro.quantities import names, unpack
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

VEHICLE, LOOP = load_vehicle(), load_loop()
QUIET = LOOP.perfect()
MODERATE = NDI(pole=50.0, frequency=24.0, damping=0.7, rates=True)


@pytest.fixture(scope="module")
def gains():
    """Gains of a law with sensors, among them those of its filter."""
    limits = dict.fromkeys(("lateral_limit", "track_end", "stop_speed"), 1.0)
    control = law.control_law(VEHICLE, sensors=Readings(LOOP), **limits)
    return unpack(control.signature.Gains, control.gains)


def following(gains, psi_CB=0.0, dphi_dp=0.0, **states):
    """State of the filter one cycle after some states, without torque, on a track of constant heading."""
    track = SimpleNamespace(psi_Tr=0.0, psi_CB=psi_CB, dpsi_dp=0.0, dpsi_dp_CB=0.0, dphi_dp=dphi_dp)
    x = replace(unpack(FilterState, [0.0] * len(names(FilterState))), **states)
    return observers.advance(x, 2 * [[0.0] * 21], track, gains.front, gains)


def drive(loop, name="curve_entry_T3", guidance=MODERATE, **changes):
    return simulate.run(load_scenario(name).but(**changes), guidance, sensors=Readings(loop, 1))


@pytest.mark.parametrize("speed", observers.SPEEDS)
def test_the_filter_is_stable_and_observes_every_state(gains, speed):
    """Its gains are for the system that `advance` steps on straight track."""
    a, c = lateral_matrices(VEHICLE, speed)
    x = ca.SX.sym("x", len(LATERAL))
    after = following(gains, v=speed, **dict(zip(LATERAL, ca.vertsplit(x), strict=True)))
    step = np.array(ca.evalf(ca.jacobian(ca.vertcat(*(getattr(after, name) for name in LATERAL)), x)))
    assert step == pytest.approx(np.eye(5) + 1e-3 * a, abs=1e-12)
    observed = np.vstack([c @ np.linalg.matrix_power(a / np.abs(a).max(), k) for k in range(5)])
    assert np.linalg.matrix_rank(observed * 1e3) == len(LATERAL)
    gain = np.array(gains.filter.lateral).reshape(5, 3, -1)[:, :, observers.SPEEDS.index(speed)]
    assert np.abs(np.linalg.eigvals(step - step @ gain @ c)).max() < 1


@pytest.mark.parametrize(("course", "cant_rate"), [(0.0, 4e-4), (3e-3, 0.0), (-3e-3, 4e-4)])
def test_the_filter_has_the_gyroscopic_moment_of_rolling_wheels(gains, course, cant_rate):
    """Nothing else acts: the angular momentum of wheels and yaw together is constant while the gear rolls."""
    after = following(gains, 2e-3, cant_rate, v=100.0, psi=2e-3, beta=course - 2e-3)
    # On its way to the right the right wheel climbs on its cone and the left one sinks, by tan(delta) y each over b.
    roll_rate = 100.0 * (cant_rate - 2 * np.tan(VEHICLE.wheel.cone_angle) * course / VEHICLE.gear.contact_base)
    wheels = 2 * VEHICLE.wheel.spin_inertia * np.array([0.0, -100.0 / VEHICLE.wheel.radius, 0.0])
    moment = -np.cross([roll_rate, 0.0, 0.0], wheels)[2]
    assert after.r / 1e-3 == pytest.approx(moment / VEHICLE.gear.inertia_z, rel=0.03)


def test_the_filter_separates_creep_angle_and_yaw_angle_in_a_curve():
    """On T3 the car needs 0.4 mrad of yaw against the track to carry the unbalanced acceleration: creep, not course."""
    run = drive(QUIET, set_point={"kind": "none"})
    tail = run.series.tail(1000)
    assert abs(tail["front.psi_TrAx"].mean()) > 2e-4
    assert run.memory["front.estimated.psi_TrAx"] == pytest.approx(0.0, abs=5e-5)
    assert run.memory["front.filter.beta"] == pytest.approx(-tail["front.psi_TrAx"].iloc[-1], rel=0.1)


def test_the_filter_estimates_the_force_of_a_wheel_from_torque_and_speed():
    run = drive(QUIET, "sine_tracking", set_point={"kind": "none"}, force_kN=[[0, 10]], end_m=500)
    true = run.series["front_le.Fx"].iloc[-1]
    assert run.memory["front.filter.le.force"] == pytest.approx(true, rel=0.01) and true > 3e3


def test_without_prediction_over_the_latency_a_fast_law_oscillates(monkeypatch):
    delayed = load_loop(**{"latency.measurement": 5e-3, "latency.command": 4e-3})
    fast = NDI(pole=40.0, frequency=30.0, damping=0.6, rates=True)
    predicted = drive(delayed, "sine_tracking", guidance=fast, end_m=400)
    gains = observers.stationary_gains
    assert gains(VEHICLE, delayed).prediction == pytest.approx(9e-3)
    monkeypatch.setattr(observers, "stationary_gains", lambda v, loop: replace(gains(v, loop), prediction=0.0))
    without = drive(delayed, "sine_tracking", guidance=fast, end_m=400)
    assert without.failed or metrics.effort(without.series) > 1.5 * metrics.effort(predicted.series)


def test_controllers_follow_the_set_point_where_the_torque_acts_and_the_record_has_it_at_the_true_position():
    """The position is read without delay; 8 ms pass on the way to the inverter, whatever the other latency."""
    series = drive(replace(QUIET, latency=Latency(3e-3, 8e-3)), end_m=120.0).series
    route, now = load_scenario("curve_entry_T3").route(), series["front.p"].to_numpy()
    here, there = (route.reference_at(now + delay * series["front.v"].to_numpy())[0] for delay in (0.0, 8e-3))
    assert series["front.estimated.y_ref"].to_numpy() == pytest.approx(there, abs=1e-6)
    assert series["front.y_ref"].to_numpy() == pytest.approx(here, abs=1e-12) and np.abs(here - there).max() > 1e-5


def test_errors_have_the_standard_deviations_of_the_filter():
    """Displacement, yaw rate and adhesion against the car, when the torque acts."""
    series = drive(LOOP, "sine_tracking", end_m=600).series
    _, covariance = observers.lateral_filter(VEHICLE, LOOP, 400 / 3.6)
    deviation = dict(zip(LATERAL, np.sqrt(np.diag(covariance)), strict=True))
    delay = round(1e3 * LOOP.latency.command)
    estimate, true = series.iloc[1000:-delay], series.iloc[1000 + delay :]
    for state, estimated, column in (("y", "y_TrAx", "y"), ("r", "psidot_Ax", "psidot_Ax")):
        error = estimate[f"front.estimated.{estimated}"].to_numpy() - true[f"front.{column}"].to_numpy()
        assert 0.7 * deviation[state] < error.std() < 1.6 * deviation[state]
    adhesion = series["front.estimated.f_le"] - series["front_le.Fx"] / VEHICLE.wheel_load
    assert 1e-4 < adhesion.iloc[1000:].std() < 0.01


def test_with_noise_the_adhesion_law_still_holds_its_set_point():
    scenario = load_scenario("adhesion_loss").but(end_m=120.0)
    adhesion = {}
    for settings in (None, AdhesionSettings()):
        run = simulate.run(scenario, NDI(20.0, 20.0), sensors=Readings(LOOP, 5), adhesion=settings)
        tail = run.series[run.series["front.p"] > 80].mean()
        adhesion[settings] = (tail["front_le.adhesion"] + tail["front_ri.adhesion"]) / 2
    assert tail["front.f_star"] == pytest.approx(0.05, abs=0.005)
    assert adhesion[None] == pytest.approx(tail["front.f_star"], rel=0.15)
    assert adhesion[AdhesionSettings()] < 0.2 * tail["front.f_star"]


def test_with_noise_the_brake_is_not_released_as_the_car_slows_down():
    """The noise of slip grows as one over the speed; a law that took it for the falling branch would release wheels."""
    run = drive(LOOP, "braking", speed_kmh=80)
    released = drive(load_loop(**{"adhesion.noise_speed": 0.0}), "braking", speed_kmh=80)
    assert run.ended.startswith("stop speed reached") and released.ended.startswith("end of the run")
    exact = simulate.run(load_scenario("braking").but(speed_kmh=80), MODERATE)
    assert run.series["front.p"].iloc[-1] == pytest.approx(exact.series["front.p"].iloc[-1], rel=0.05)
