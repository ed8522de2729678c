"""The filter of a running gear: its model against the car, what it finds of creep and force, and in closed loop."""

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
from railrepro.model.control_model import STATES
from railrepro.quantities import names, pack, unpack
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

QUIET = load_loop().perfect()
MODERATE = NDI(pole=50.0, frequency=24.0, damping=0.7, rates=True)


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


def gains_of_the_law(vehicle):
    """Gains of a law behind sensors, those of its filter among them."""
    limits = dict.fromkeys(("lateral_limit", "track_end", "stop_speed"), 1.0)
    control = law.control_law(vehicle, sensors=Readings(load_loop()), **limits)
    return unpack(control.signature.Gains, control.gains)


def drive(loop, name="curve_entry_T3", seed=1, guidance=MODERATE, vehicle=None, **changes):
    sensors = None if loop is None else Readings(loop, seed)
    return simulate.run(load_scenario(name).but(**changes), guidance, vehicle=vehicle, sensors=sensors)


@pytest.mark.parametrize("speed", observers.SPEEDS)
def test_the_filter_is_stable_and_sees_every_state(vehicle, speed):
    """Its gains are for the system that `advance` steps on straight track."""
    a, c = lateral_matrices(vehicle, speed)
    gains = gains_of_the_law(vehicle)
    x = ca.SX.sym("x", len(LATERAL))
    still = SimpleNamespace(psi_Tr=0.0, psi_CB=0.0, dpsi_dp=0.0, dpsi_dp_CB=0.0, dphi_dp=0.0)
    rest = unpack(FilterState, [0.0] * len(names(FilterState)))
    state = replace(rest, **dict(zip(LATERAL, ca.vertsplit(x), strict=True)), v=speed)
    following = observers.advance(state, 2 * [[0.0] * 21], still, gains.front, gains)
    step = np.array(ca.evalf(ca.jacobian(ca.vertcat(*(getattr(following, name) for name in LATERAL)), x)))
    assert step == pytest.approx(np.eye(5) + 1e-3 * a, abs=1e-12)
    seen = np.vstack([c @ np.linalg.matrix_power(a / np.abs(a).max(), k) for k in range(5)])
    assert np.linalg.matrix_rank(seen * 1e3) == len(LATERAL)
    k = observers.SPEEDS.index(speed)
    gain = np.array(gains.filter.lateral).reshape(5, 3, -1)[:, :, k]
    assert np.abs(np.linalg.eigvals(step - step @ gain @ c)).max() < 1


@pytest.mark.parametrize(("course", "cant_rate"), [(0.0, 4e-4), (3e-3, 0.0), (-3e-3, 4e-4)])
def test_the_filter_feels_the_gyroscopic_moment_of_rolling_wheels(vehicle, course, cant_rate):
    """Nothing else acts: the angular momentum of both wheels and that of yaw stay together while the gear rolls."""
    x = replace(unpack(FilterState, [0.0] * len(names(FilterState))), v=100.0, psi=2e-3, beta=course - 2e-3)
    track = SimpleNamespace(psi_Tr=0.0, psi_CB=2e-3, dpsi_dp=0.0, dpsi_dp_CB=0.0, dphi_dp=cant_rate)
    gains = gains_of_the_law(vehicle)
    turned = observers.advance(x, 2 * [[0.0] * 21], track, gains.front, gains).r / 1e-3
    # Running to the right the right wheel climbs on its cone and the left one sinks, by tan(delta) y each over b.
    roll_rate = 100.0 * (cant_rate - 2 * np.tan(vehicle.wheel.cone_angle) * course / vehicle.gear.contact_base)
    wheels = 2 * vehicle.wheel.spin_inertia * np.array([0.0, -100.0 / vehicle.wheel.radius, 0.0])
    moment = -np.cross([roll_rate, 0.0, 0.0], wheels)[2]
    assert turned == pytest.approx(moment / vehicle.gear.inertia_z, rel=0.03)


def test_creep_angle_and_gyro_bias_are_told_apart_in_a_curve():
    """On T3 the car needs 0.4 mrad of yaw against the track to carry the unbalanced acceleration: creep, not course."""
    run = drive(QUIET, set_point={"kind": "none"})
    tail = run.series.tail(1000)
    assert abs(tail["front.psi_TrAx"].mean()) > 2e-4
    seen = {name: run.memory[f"front.estimated.{name}"] for name in STATES}
    assert seen["psi_TrAx"] == pytest.approx(0.0, abs=5e-5)
    assert run.memory["front.filter.beta"] == pytest.approx(-tail["front.psi_TrAx"].iloc[-1], rel=0.1)


def test_force_of_a_wheel_is_found_from_torque_and_speed():
    run = drive(QUIET, "sine_tracking", set_point={"kind": "none"}, force_kN=[[0, 10]], end_m=500)
    true = run.series["front_le.Fx"].iloc[-1]
    assert run.memory["front.filter.le.force"] == pytest.approx(true, rel=0.01) and true > 3e3


def test_prediction_pays(monkeypatch):
    """Without prediction over the latency a fast law oscillates."""
    late = load_loop(**{"latency.measurement": 5e-3, "latency.command": 4e-3})
    fast = NDI(pole=40.0, frequency=30.0, damping=0.6, rates=True)
    with_it = drive(late, "sine_tracking", guidance=fast, end_m=400)
    gains = observers.stationary_gains
    assert gains(load_vehicle(), late).prediction == pytest.approx(9e-3)
    monkeypatch.setattr(observers, "stationary_gains", lambda v, loop: replace(gains(v, loop), prediction=0.0))
    without = drive(late, "sine_tracking", guidance=fast, end_m=400)
    effort = [metrics.effort(run.series) for run in (with_it, without)]
    assert without.failed or effort[1] > 1.5 * effort[0]


def test_controllers_follow_the_set_point_where_the_torque_will_act_and_the_record_has_that_of_the_true_place():
    """The position is read for now; 8 ms pass on the way to the inverter, however old the other readings are."""
    series = drive(replace(QUIET, latency=Latency(3e-3, 8e-3)), end_m=120.0).series
    route, now = load_scenario("curve_entry_T3").route(), series["front.p"].to_numpy()
    here, there = (route.reference_at(now + late * series["front.v"].to_numpy())[0] for late in (0.0, 8e-3))
    assert series["front.estimated.y_ref"].to_numpy() == pytest.approx(there, abs=1e-6)
    assert series["front.y_ref"].to_numpy() == pytest.approx(here, abs=1e-12) and np.abs(here - there).max() > 1e-5


def test_errors_are_of_the_size_that_the_filter_says():
    """Standard deviations of displacement, yaw rate and adhesion against the car, when the torque arrives."""
    loop, vehicle = load_loop(), load_vehicle()
    series = drive(loop, "sine_tracking", end_m=600).series
    _, covariance = observers.lateral_filter(vehicle, loop, 400 / 3.6)
    said = dict(zip(LATERAL, np.sqrt(np.diag(covariance)), strict=True))
    delay = round(1e3 * loop.latency.command)

    def error(seen, true):
        return (
            series[f"front.estimated.{seen}"].to_numpy()[1000:-delay]
            - series[f"front.{true}"].to_numpy()[1000 + delay :]
        )

    assert 0.7 * said["y"] < error("y_TrAx", "y").std() < 1.6 * said["y"]
    assert 0.7 * said["r"] < error("psidot_Ax", "psidot_Ax").std() < 1.6 * said["r"]
    load = (vehicle.body.mass / 2 + vehicle.gear.mass) * vehicle.gravity / 2
    adhesion = series["front.estimated.f_le"] - series["front_le.Fx"] / load
    assert 1e-4 < adhesion.iloc[1000:].std() < 0.01


def test_behind_noise_the_adhesion_law_still_holds_its_set_point():
    scenario = load_scenario("adhesion_loss").but(end_m=120.0)
    held = {}
    for own in (None, AdhesionSettings()):
        run = simulate.run(scenario, NDI(20.0, 20.0), sensors=Readings(load_loop(), 5), adhesion=own)
        late = run.series[run.series["front.p"] > 80]
        held[own] = float((late["front_le.adhesion"] + late["front_ri.adhesion"]).mean() / 2)
    demand = float(late["front.f_star"].mean())
    assert demand == pytest.approx(0.05, abs=0.005)
    assert held[None] == pytest.approx(demand, rel=0.15)
    assert held[AdhesionSettings()] < 0.2 * demand


def test_behind_noise_the_brake_is_not_let_go_as_the_car_slows_down():
    """The noise of slip grows as one over the speed; taken for the falling branch it would release the wheels."""
    run = drive(load_loop(), name="braking", guidance=MODERATE, speed_kmh=80)
    still = drive(load_loop(**{"adhesion.noise_speed": 0.0}), name="braking", guidance=MODERATE, speed_kmh=80)
    assert run.ended.startswith("stop speed reached")
    assert still.ended.startswith("end of the run")
    free = simulate.run(load_scenario("braking").but(speed_kmh=80), MODERATE)
    assert run.series["front.p"].iloc[-1] == pytest.approx(free.series["front.p"].iloc[-1], rel=0.05)
