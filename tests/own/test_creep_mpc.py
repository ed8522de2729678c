"""The creep-aware predictive controller: optimum, reach, symmetry, steady error, what it does at the limits."""

import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from symmetry import drive_with, mirrored, turned

from railrepro.contact.table import contact_table
from railrepro.control.registry import tuned
from railrepro.data import InputError
from railrepro.estimation.sensors import readings
from railrepro.own import creep_gains, creep_mpc
from railrepro.own.creep_gains import ALERT, FAST, CreepSettings, Schedule, _riccati, gains
from railrepro.own.creep_model import KNOWN, LEAST_SPEED, STATES, UNKNOWN, Creep, creep_at, lateral_model
from railrepro.own.creep_mpc import CreepGuide, CreepMPC
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.rough import rough_track
from railrepro.track.route import CELL
from railrepro.vehicle.parameters import load_vehicle

V = load_vehicle()
CONE = load_vehicle(**{"contact.profile": "cone"})
"""The car with the wheels of the controller's model."""
T3 = load_scenario("curve_entry_T3")
DRY = creep_at(V, "dry", 20.0)
HOT = CreepSettings(change=1e-4, force_rate=3e5, y_noise=1e-6, psi_noise=1e-6, r_noise=1e-5)


@pytest.mark.parametrize(("delay", "sent"), [(0.0, 1), (0.004, 1), (0.01, 1), (0.025, 3)])
def test_first_move_is_that_of_the_whole_optimisation(delay, sent):
    """Least squares over all moves of a long horizon, with random states, disturbances, torques under way, road and set
    points ahead; the model in steps of a thousandth of a second, so that a delay is a number of steps."""
    settings, horizon, generator = CreepSettings(period=0.01, preview=0.2), 400, np.random.default_rng(4)
    found, fine = gains(V, 30.0, DRY, settings, delay), lateral_model(V, 30.0, DRY).discrete(1e-3)
    scale = [1e-3, 1e-2, 1e-3, 1e-2, 1e-2, 50.0, 1e-2, 1e-2, 1e-3, 1e-3, 500.0, 300.0]
    start, before = generator.normal(0, scale), generator.normal(0, 50.0, sent)
    ahead = generator.normal(0, [0.3, *4 * [1e-2], *6 * [1e-3]], (settings.steps + 1, len(KNOWN) + 1))
    move = found.change @ np.concatenate([start, [7.0], before, ahead.T.ravel()])

    n, late = len(STATES), round(delay / 1e-3)
    free, forced = start[:n].copy(), np.zeros((n, horizon))
    y, by_move = [], []
    for k in range(10 * horizon):
        track_ahead, sample = ahead[min(k // 10, settings.steps)], (k - late) // 10
        old = before[min(-sample - 1, sent - 1)] if sample < 0 else before[0]
        free = fine.a @ free + fine.d @ start[n:] + fine.b * old + fine.e @ track_ahead[: len(KNOWN)]
        torque = (np.arange(horizon) <= sample).astype(float)
        forced = fine.a @ forced + np.outer(fine.b, torque)
        if k % 10 == 9:
            y.append(free[0] - track_ahead[-1])
            by_move.append(forced[0].copy())
    weight = np.sqrt(settings.error)
    system = np.vstack([weight * np.array(by_move), np.sqrt(settings.change) * np.eye(horizon)])
    moves = np.linalg.lstsq(system, np.append(-weight * np.array(y), np.zeros(horizon)), rcond=None)[0]
    assert move == pytest.approx(moves[0], rel=1e-4)
    assert abs(move) > 10.0


@pytest.mark.parametrize("speed", [LEAST_SPEED, 5.0, 125.0])
@pytest.mark.parametrize(
    "creep", [DRY, Creep(3e4, 6e5, 0.09), Creep(3e4, 6e5, -0.09)], ids=["dry", "traction", "braking"]
)
@pytest.mark.parametrize("settings", [CreepSettings(), HOT], ids=["default", "hot"])
def test_controller_and_filter_are_stable(speed, creep, settings):
    found, n = gains(V, speed, creep, settings), len(STATES)
    a, d, b, before, _ = np.split(found.step, [n, n + 2, n + 3, n + 4], axis=1)
    assert not before.any()
    loop = np.block([[a, b], [np.zeros((1, n)), np.eye(1)]])
    loop += np.outer(np.append(b, 1.0), np.delete(found.change[: n + 4], [n, n + 1, n + 2]))
    drift = np.eye(n + 3)
    drift[:n, : n + 2] = np.hstack([a, d])
    seen = np.eye(n + 3)[[STATES.index(name) for name in ("y", "psi", "r")]]
    seen[2, -1] = 1.0
    for matrix in (loop, drift - found.read @ seen @ drift):
        assert np.abs(np.linalg.eigvals(matrix)).max() < 1.0


def test_gains_exist_at_all_speeds_for_sharp_settings():
    """In SI units the Riccati equation of the filter fails at some of the low speeds."""
    assert Schedule(V, HOT, DRY).around(1.0, 0.0, 0.0)[0].read.shape == (len(STATES) + len(UNKNOWN) + 1, 3)


def test_an_unsolvable_riccati_equation_is_told_in_one_sentence():
    with pytest.raises(InputError, match="CreepSettings: the Riccati equation has no usable solution"):
        _riccati(2 * np.eye(1), np.zeros((1, 1)), np.eye(1), np.eye(1), np.ones(1))


@pytest.mark.parametrize(("name", "limit_mm"), [("curve_entry_T3", 0.03), ("sine_tracking", 0.015)])
def test_reach_with_perfect_measurements(name, limit_mm):
    run = simulate.run(load_scenario(name).but(end_m=300.0), CreepMPC(), vehicle=CONE)
    for gear in ("front", "rear"):
        assert metrics.rmse(run.series, gear) < 1e-3 * limit_mm
    assert not run.failed and not any(controller.missed for controller in run.controllers)


def test_without_preview_the_error_grows():
    short, far = (
        metrics.rmse(simulate.run(T3.but(end_m=200.0), CreepMPC(CreepSettings(preview=s))).series) for s in (0.0, 0.6)
    )
    assert short > 5 * far


def test_heading_of_the_track_does_not_matter(monkeypatch):
    straight, turn = (drive_with(CreepMPC(), change, monkeypatch) for change in (lambda route: route, turned))
    assert metrics.rmse(turn) == pytest.approx(metrics.rmse(straight), rel=1e-6)


def test_a_run_on_the_mirrored_track_is_its_mirror_image(monkeypatch):
    right, left = (drive_with(CreepMPC(), change, monkeypatch) for change in (lambda route: route, mirrored))
    for column in ("front.y", "front.du", "rear.du", "rear.psi_TrAx"):
        assert np.abs(right[column] + left[column]).max() < 1e-6 * right[column].abs().max()
    assert right["front.y"].abs().max() > 1e-3


def test_no_steady_error_in_an_arc_with_wrong_creep_on_a_heavier_car():
    scenario = T3.but(set_point={"kind": "none"}, end_m=1200.0)
    heavy = load_vehicle(**{"body.mass": 28_000.0, "suspension.k_x": 50_000.0})
    wrong = Creep(DRY.along / 2, 2 * DRY.across)
    last = simulate.run(scenario, CreepMPC(creep=wrong), plant_vehicle=heavy).series.tail(200).mean()
    for gear in ("front", "rear"):
        assert abs(last[f"{gear}.y"]) < 2e-6
    assert abs(last["front.psi_TrAx"]) > 3e-4 and abs(last["front.du"]) > 10.0


class Blind(CreepGuide):
    """Without use of adhesion and slip."""

    def notice(self, adhesion, slip):
        """Nothing is kept."""


def test_seen_slip_saves_adhesion_on_a_poor_rail():
    """Who takes a slipping wheel for a rolling one wastes the adhesion on a limit cycle of du."""
    scenario = load_scenario("adhesion_loss").but(end_m=500.0)
    seeing = simulate.run(scenario, CreepMPC(), vehicle=CONE).series
    blind = simulate.run(scenario, lambda *on: Blind(*on, CreepSettings(), DRY), vehicle=CONE).series
    assert metrics.effort(seeing) < 0.4 * metrics.effort(blind)
    saved, wasted = (log.loc[log["front.p"] > 300, "front_le.adhesion"].mean() for log in (seeing, blind))
    assert saved > 0.085 > 0.06 > wasted


@pytest.mark.parametrize("worn", [0.99, 1.01])
def test_wheels_of_another_radius_are_not_taken_for_slipping_ones(worn):
    plant, seen = replace(CONE, wheel=replace(CONE.wheel, radius=worn * CONE.wheel.radius)), readings(seed=1)
    settings = CreepSettings(change=0.09, force_rate=1.3e5, y_noise=2.8e-4, psi_noise=2.9e-3, r_noise=4.3e-3)
    scenario = load_scenario("adhesion_loss").but(end_m=350.0)
    run = simulate.run(scenario, CreepMPC(settings), vehicle=CONE, plant_vehicle=plant, sensors=seen)
    assert not run.failed and metrics.rmse(run.series) < 2e-3


def test_it_guides_until_standstill():
    scenario = load_scenario("braking").but(speed_kmh=20, end_m=400.0)
    run = simulate.run(scenario, CreepMPC())
    assert run.ended.startswith("stop speed") and metrics.rmse(run.series) < 1e-4


def test_behind_sensors_it_works_on_the_readings_and_knows_their_age():
    """Late readings are not those of the present; the loop's filter hands on a course for the yaw angle."""
    careful = CreepSettings(change=1e-2, y_noise=1.4e-4, psi_noise=2.4e-4, r_noise=4e-3, r_drift=1e-5)
    scenario, seen = load_scenario("sine_tracking").but(end_m=250.0), readings(seed=1)
    knowing, hasty, deaf = (
        simulate.run(scenario, partial(kind, settings=careful, creep=DRY), sensors=seen).series
        for kind in (CreepGuide, Hasty, Deaf)
    )
    assert metrics.effort(knowing) < 0.8 * metrics.effort(hasty)
    assert metrics.effort(knowing) < 0.8 * metrics.effort(deaf)


class Hasty(CreepGuide):
    """Takes readings for present ones."""

    def read(self, readings, delay):
        """No delay."""
        super().read(readings, 0.0)


class Deaf(CreepGuide):
    """Works on what the filter of the loop found."""

    def read(self, readings, delay):
        """Nothing is taken."""


@pytest.fixture
def guide():
    return CreepMPC()(V, T3.route(), 0)


def measured(v, y=0.0):
    return np.array([100.0, 0.0, v, 0.0, y, 0.0])


def test_torque_keeps_its_limit_and_the_filter_knows():
    guide = CreepMPC(CreepSettings(period=2e-3))(V, T3.route(), 0)
    assert guide.plan(measured(50.0), 0.0) != 0.0
    guide.plan(measured(50.0, 4e-3), 0.0)
    assert abs(guide.plan(measured(50.0, 8e-3), 0.0)) == V.drive.torque_limit
    assert abs(guide.sent[0]) == V.drive.torque_limit


def test_a_measurement_that_is_not_finite_is_bridged_and_counted(guide):
    for _ in range(20):
        before = guide.plan(measured(50.0, 1e-4), 0.0)
    after = guide.plan(np.full(6, np.nan), np.nan)
    assert np.isfinite(after) and abs(after - before) < 0.2 * V.drive.torque_limit
    assert guide.missed == 1
    guide.notice(np.full(2, np.nan), np.zeros(2))
    assert np.isfinite(guide.plan(measured(50.0, 1e-4), 0.0)) and guide.missed == 1


def test_a_filter_that_is_lost_begins_anew_and_counts(guide):
    for y in (0.0, 1e-4, 8e-3):
        torque = guide.plan(measured(50.0, y), 0.0)
    assert guide.restarts == 1 and np.isfinite(torque)
    assert guide.state[STATES.index("y")] == pytest.approx(8e-3, abs=1e-4)
    guide.state[STATES.index("vy")] = np.nan
    assert np.isfinite(guide.plan(measured(50.0, 8e-3), 0.0)) and guide.restarts == 2
    guide.sent[:] = np.nan
    assert np.isfinite(guide.plan(measured(50.0, 8e-3), 0.0)) and guide.restarts == 3


def test_the_track_is_that_under_the_readings_which_are_older_than_the_place(guide):
    """Six milliseconds from reading to torque, one of them the cycle; T3 curves from 25 m on, 423 m to 4250 m."""
    guide.read(np.zeros(3), 6e-3)
    guide.plan(measured(70.0), 0.0)
    (curvature, *_), _ = guide._track_ahead(70.0, 0.0)
    assert curvature == pytest.approx((100.0 - 5e-3 * 70.0 - 25.0) / 423.0 / 4250.0, rel=1e-6)


def test_the_track_ahead_is_passed_at_the_speed_that_braking_leaves(guide):
    """On the clothoid of T3 the curvature grows by one over 423 m times 4250 m in each metre."""
    guide.plan(measured(70.0), 0.0)
    _, ahead = guide._track_ahead(70.0, -1.5)
    middle = (np.arange(ahead.shape[1]) + 0.5) * guide.period
    within = 100.0 + 70.0 * middle < 440.0
    expected = (70.0 - 1.5 * middle) ** 2 / 423.0 / 4250.0
    assert ahead[1, within] == pytest.approx(expected[within], rel=1e-9) and within.sum() > 10


def test_torque_is_held_at_rest(guide):
    held = guide.plan(measured(1.0, 1e-4), 0.0)
    assert held != 0.0
    assert [guide.plan(measured(v, 1e-3), 0.0) for v in (0.4, 0.0, -0.1)] == [held] * 3
    assert CreepMPC()(V, T3.route(), 1).plan(measured(0.0, 1e-3), 0.0) == 0.0


def test_schedule_meets_its_nodes_and_softens_with_slip():
    schedule = Schedule(V, CreepSettings(), DRY)
    low, high, share = schedule.around(LEAST_SPEED, 0.0, 0.0)
    assert share == 0.0
    assert np.array_equal(low.change, gains(V, LEAST_SPEED, DRY, CreepSettings()).change)
    assert schedule.around(1e3, 0.0, 0.0)[2] == 1.0 and schedule.around(-1.0, 0.0, 0.0)[2] == 0.0
    rolling, *_ = schedule.around(100.0, 0.09, 0.001)
    slipping, *_ = schedule.around(100.0, 0.09, 0.012)
    free = len(STATES) + len(UNKNOWN)
    damping = STATES.index("vy"), STATES.index("vy")
    assert slipping.step[damping] > rolling.step[damping]  # less of the lateral speed is lost in a period
    assert slipping.step.shape == (len(STATES), free + 2 + len(KNOWN))


def test_weight_and_walks_follow_speed_slip_and_alertness():
    own = CreepSettings(change=0.2, speed_power=1.5, slip_factor=3.0, quiet=0.01, quiet_change=0.1)
    at = Schedule(V, own, DRY)._settings_at
    assert at(FAST, True, 0.0) == own and at(FAST / 4, True, 0.0).change == pytest.approx(0.2 / 8)
    assert at(FAST / 4, False, 0.0).change == at(FAST, False, 0.0).change == pytest.approx(0.6)
    calm = at(FAST, True, 1.0)
    assert (calm.change, calm.force_rate) == pytest.approx((0.02, 0.01 * own.force_rate))
    assert at(FAST, True, 0.5).moment_rate == pytest.approx(0.1 * own.moment_rate)


def test_slipping_wheels_keep_the_filter_awake():
    schedule = Schedule(V, CreepSettings(quiet=0.01), DRY)
    calm, awake = (schedule.around(FAST, 0.0, 0.0, alert)[0].read for alert in (0, ALERT))
    assert np.abs(calm).max() < 0.5 * np.abs(awake).max()
    assert schedule.around(FAST, 0.09, 0.012, 0)[0] is schedule.around(FAST, 0.09, 0.012, ALERT)[0]


def test_white_innovations_calm_the_filter_and_slow_ones_wake_it(guide):
    generator = np.random.default_rng(2)
    for noise in generator.normal(0.0, 1e-4, 4000):
        guide._notice_colour(noise)
        calm = guide._alertness()
    assert calm == 0
    for k, noise in enumerate(generator.normal(0.0, 1e-4, 300)):
        guide._notice_colour(noise + 1e-4 * np.sin(0.01 * k))
        awake = guide._alertness()
    assert awake == ALERT
    for noise in generator.normal(0.0, 1e-4, 4000):
        guide._notice_colour(noise)
        calm = guide._alertness()
    assert calm <= 1


def test_a_biased_gyro_is_learnt():
    """At 1e-6 rad/s after a second the bias stays in the error for the whole run."""
    scenario, loop = load_scenario("sine_tracking").but(end_m=400.0), {"gyro.bias": 0.003, "lateral.bias": 0.0}
    settings = CreepSettings(
        change=0.2, force_rate=1.3e5, moment_rate=8e3, y_noise=2.8e-4, psi_noise=2.9e-3, r_noise=4e-3
    )
    errors = []
    for drift in (1e-6, 1e-4):
        law = CreepMPC(replace(settings, r_drift=drift))
        series = simulate.run(scenario, law, sensors=readings(seed=3, **loop)).series
        errors.append(abs((series["front.y"] - series["front.y_ref"])[1500:].mean()))
    assert errors[1] < 0.5 * errors[0] > 1e-4


@pytest.mark.parametrize("radius", [0.985, 1.01])
def test_the_radius_of_wheels_is_learnt_while_nothing_is_demanded(radius):
    scenario = load_scenario("sine_tracking").but(end_m=120.0)
    law, plant = tuned("creep_mpc", setting="loop"), load_vehicle(**{"wheel.radius": radius * V.wheel.radius})
    runs = [simulate.run(scenario, law, plant_vehicle=car, sensors=readings(seed=1)) for car in (V, plant)]
    guides = [run.controllers[0] for run in runs]
    assert guides[1]._offset.mean() == pytest.approx(1 / radius - 1, abs=6e-4)
    assert abs(guides[1]._slip[1].mean()) < 3e-4
    assert metrics.rmse(runs[1].series) < 1.15 * metrics.rmse(runs[0].series)


def test_what_slips_under_demand_is_not_learnt_as_a_radius(guide):
    for _ in range(400):
        guide.plan(measured(100.0), 1500.0)
        guide.notice(np.array([0.001, 0.001]), np.array([-0.01, -0.01]))
    middle = guide._profile(np.zeros(2))
    assert not guide._offset.any() and guide._slip[1] == pytest.approx(0.01 + middle, rel=1e-3)


def test_what_the_differential_torque_makes_slip_is_not_learnt_as_a_radius_until_it_has_come_to_rest(guide):
    for torque, learnt in ((1500.0, 0), (0.0, 0), (300.0, 1)):
        guide.sent[:] = torque
        guide.plan(measured(100.0), 0.0)
        guide.notice(np.array([0.03, -0.03]), np.array([-0.01, 0.005]))
        assert (guide._learnt > 0) == learnt
        if torque == 0.0:
            for _ in range(150):
                guide.sent[:] = 0.0
                guide.plan(measured(100.0), 0.0)


def test_wheels_off_the_middle_roll_on_other_radii_and_do_not_slip():
    """At 5 mm on S1002 wheels 461.9 and 459.8 mm: 4 per mille of the speed that no torque makes."""
    vehicle = load_vehicle()
    guide = CreepMPC()(vehicle, T3.route(), 0)
    frame = contact_table("s1002", vehicle).frame
    radii = np.interp([-5e-3, 5e-3], frame["shift_m"], frame["rolling_radius_m"])
    seems = 1 - vehicle.wheel.radius / radii  # as the slip is counted: braking positive
    assert np.ptp(seems) > 4e-3
    for _ in range(200):
        guide.plan(measured(100.0, y=5e-3), 1500.0)
        guide.notice(np.array([1e-3, 1e-3]), seems)
    assert np.abs(guide._slip[1]).max() < 5e-5


def test_slip_that_the_noise_of_a_slow_train_can_make_is_none():
    schedule, damping = Schedule(V, CreepSettings(), DRY), (STATES.index("vy"), STATES.index("vy"))
    slow, still = (schedule.around(11.0, 0.0, slip)[0].step[damping] for slip in (1.5e-3, 0.0))
    assert slow == still
    fast, still = (schedule.around(111.0, 0.0, slip)[0].step[damping] for slip in (1.5e-3, 0.0))
    assert fast != still


def test_wheels_that_slip_in_opposite_directions_are_soft():
    """On the mean of both they roll: a torque beyond the adhesion then looks like one that the wheels carry."""
    schedule, damping = Schedule(V, CreepSettings(), DRY), (STATES.index("vy"), STATES.index("vy"))
    apart, along = np.array([1.0, -1.0]), np.ones(2)
    one, other, rolling = (
        schedule.around(100.0, 0.035 * sides, slip * sides)[0].step[damping]
        for sides, slip in ((apart, 0.01), (along, 0.01), (apart, 5e-4))
    )
    assert one == pytest.approx(other, rel=2e-3) and one > 1.02 * rolling


def test_the_gear_stays_near_its_set_point_on_a_patch_where_both_wheels_slide_apart():
    """200 m of mu = 0.05 at 400 km/h with the paper's adhesion control law; an inversion 2.4 mm."""
    ice = ((0, 0), (200, 0), (201, 1), (400, 1), (401, 0))
    scenario = load_scenario("adhesion_loss").but(end_m=450.0, good="dry", poor="very_poor", poor_share=ice)
    plant = load_vehicle(**{"adhesion.very_poor.mu0": 0.05})
    run = simulate.run(scenario, tuned("creep_mpc", setting="equal"), plant_vehicle=plant)
    assert np.abs(metrics.lateral_error(run.series)).max() < 3e-3
    assert np.abs(run.controllers[0]._offset).max() < 1.5e-3


@pytest.mark.parametrize(("adhesion", "slip"), [(True, True), (False, True), (True, False)])
def test_gains_depend_on_what_the_settings_say(adhesion, slip):
    asked, settings = [], CreepSettings(uses_adhesion=adhesion, uses_slip=slip)
    guide = CreepMPC(settings)(V, T3.route(), 0)
    around = guide._schedule.around
    guide._schedule = type("Spy", (), {"around": lambda self, *at: asked.append(at) or around(*at)})()
    guide._slip[:] = [[0.1, 0.2], [0.01, 0.02]]
    guide.plan(np.array([10.0, 0.0, 70.0, 0.0, 0.0, 0.0]), 0.0)
    _, used, slipping, _ = asked[0]
    np.testing.assert_array_equal(used, adhesion * np.array([0.1, 0.2]))
    np.testing.assert_array_equal(slipping, slip * np.array([0.01, 0.02]))


def test_the_rear_gear_knows_the_rails_that_the_front_gear_found():
    scenario, law = load_scenario("curve_entry_T3").but(end_m=200.0), tuned("creep_mpc", setting="loop")
    rough = rough_track(np.arange(0.0, scenario.end_m, CELL), spectrum="en_B_300", seed=201)

    def errors(follows, irregularities=rough):
        guidance = replace(law, settings=replace(law.settings, uses_rails=follows))
        series = simulate.run(scenario, guidance, sensors=readings(seed=201), irregularities=irregularities).series
        series = series[series["rear.p"] > 20.0]
        return np.array([metrics.followed_rmse(series, gear) for gear in ("front", "rear")])

    gain = errors(True) / errors(False)
    assert gain[0] == pytest.approx(1.0, abs=0.02)
    assert gain[1] < 0.9
    ideal = errors(True, None) / errors(False, None)
    np.testing.assert_array_equal(ideal, 1.0)  # noise is not taken for rails


def test_the_bend_of_the_profile_is_known_ahead_and_where_the_gear_is(monkeypatch):
    """Half of it is worth less than all; of a profile that bends the other way it expects the wrong."""
    scenario = load_scenario("sine_tracking").but(end_m=250.0)
    bent = creep_mpc.shifts

    def error(ahead, here):
        def found(vehicle):
            def at(y):
                return (here if np.ndim(y) == 0 else ahead) * bent(vehicle)(y)

            return at

        monkeypatch.setattr(creep_mpc, "shifts", found)
        return metrics.rmse(simulate.run(scenario, tuned("creep_mpc", setting="equal")).series)

    both, neither, one, other, against = (error(*uses) for uses in ((1, 1), (0, 0), (1, 0), (0, 1), (-1, -1)))
    assert both < 0.5 * neither and both < 0.3 * min(one, other) and against > 1.5 * neither
    knowing = tuned("creep_mpc", setting="equal")
    off = replace(knowing, settings=replace(knowing.settings, uses_bend=False))
    monkeypatch.setattr(creep_mpc, "shifts", bent)
    assert metrics.rmse(simulate.run(scenario, off).series) == neither


def test_the_bend_counts_from_the_rails():
    places = []
    for offset in (0.0, 1e-3):
        guide = CreepMPC()(V, T3.route(), 1)
        guide.plan(measured(50.0, 1e-4), 0.0)
        guide._ahead[-2] = offset
        bent = guide._shifts
        guide._shifts = lambda y, bent=bent: places.append(float(y)) or bent(y)
        guide.plan(measured(50.0, 1e-4), 0.0)
    assert places[0] - places[1] == pytest.approx(1e-3, rel=1e-12)


def test_where_one_wheel_slides_the_other_carries_the_torque(monkeypatch):
    shares, schedule = [], Schedule(V, CreepSettings(), DRY)

    def spy(vehicle, speed, creep, *rest):
        shares.append(creep.share)
        return gains(vehicle, speed, creep, *rest)

    monkeypatch.setattr(creep_gains, "gains", spy)
    for adhesion, slip in (((0.09, 0.13), (0.017, 8e-4)), ((0.1, 0.1), (0.03, 8e-3)), ((0.1, 0.1), (8e-4, 8e-4))):
        schedule.around(100.0, np.array(adhesion), np.array(slip))
    one, both, rolling = shares[0], shares[2], shares[4]
    assert one < 0.65 and both == rolling == 1.0


def test_factory_is_picklable():
    assert pickle.loads(pickle.dumps(CreepMPC())) == CreepMPC()
