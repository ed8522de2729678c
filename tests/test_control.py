"""Integration rule, adhesion law, inversion, predictive controllers, preview."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from railrepro.control.adhesion import AdhesionSettings, base_torque
from railrepro.control.allocation import allocate
from railrepro.control.ltv_mpc import LTVMPC
from railrepro.control.nmpc import NMPC
from railrepro.control.problem import MPCSettings
from railrepro.errors import InputError
from railrepro.model.forecast import forecast, nominal_values
from railrepro.simulation import scenarios
from railrepro.vehicle.parameters import load_vehicle

LIMIT = 4000.0


def allocated(u_d, du, share=0.0):
    return [float(value) for value in map(ca.evalf, map(ca.SX, allocate(ca.SX(u_d), ca.SX(du), LIMIT, share)))]


@pytest.mark.parametrize("u_d", [-9000, -4000, -100, 0, 100, 3900, 9000])
@pytest.mark.parametrize("du", [-5000, -500, 0, 3, 4000])
def test_motors_never_exceed_their_limit_and_steering_is_kept(u_d, du):
    le, ri, _, kept = allocated(u_d, du)
    assert max(abs(le), abs(ri)) <= LIMIT + 1e-9
    assert (le - ri) / 2 == pytest.approx(np.clip(du, -LIMIT, LIMIT))
    assert kept == pytest.approx((le - ri) / 2)


def test_longitudinal_torque_takes_what_is_left():
    assert allocated(-9000, 500)[2] == -3500
    assert allocated(3000, 500)[2] == 3000
    assert allocated(-9000, 2500, share=0.25)[2:] == [-3000, 1000]


def drive(law, adhesion, demand, milliseconds, speed=100.0, load=78e3, inertia=60.0, radius=0.46):
    """One wheel on a bare characteristic under the adhesion law; returns adhesion and slip over time."""
    gain = law.gains() | {"adhesion.torque_per_adhesion": load * radius}
    gain_ = {key: ca.SX(value) for key, value in gain.items()}
    f, s, f_star = ca.SX.sym("f"), ca.SX.sym("s"), ca.SX.sym("f_star")
    names = ("u", "f_0", "f_1", "s_0", "s_1")
    memory = ca.SX.sym("memory", 5)
    old = dict(zip(names, ca.vertsplit(memory), strict=True))
    u, new, segment = base_torque([f, f], [s, s], f_star, speed, old, gain_, 1e5)
    step = ca.Function("law", [f, s, f_star, memory], [u, ca.vertcat(*(new[n] for n in names)), segment])
    state, slip, rows = np.zeros(5), 0.0, []
    for _ in range(milliseconds):
        grip = adhesion(slip)
        u, state, segment = (np.array(v).ravel() for v in step(grip, -slip, demand, state))
        for _ in range(10):
            slip += 1e-4 * radius / (inertia * speed) * (u[0] - radius * load * adhesion(slip))
        rows.append((adhesion(slip), slip, u[0]))
    return np.array(rows)


def characteristic(slip):
    """Adhesion with maximum 0.1 at a slip of 2 % and a falling branch."""
    return 0.1 * 2 * (slip / 0.02) / (1 + (slip / 0.02) ** 2)


@pytest.mark.parametrize("sign", [1, -1])
def test_set_point_below_the_maximum_is_held(sign):
    rows = drive(AdhesionSettings(), characteristic, sign * 0.05, 3000)
    assert np.abs(rows[-500:, 0] - sign * 0.05).max() < 0.006


@pytest.mark.parametrize("sign", [1, -1])
def test_maximum_is_sought_without_macro_slip(sign):
    rows = drive(AdhesionSettings(), characteristic, sign * 0.2, 8000)
    assert np.mean(sign * rows[-2000:, 0]) > 0.9 * 0.1
    assert np.abs(rows[:, 1]).max() < 0.06


def test_without_slip_control_the_wheel_spins():
    rows = drive(AdhesionSettings(active=False), characteristic, 0.2, 8000)
    assert np.abs(rows[:, 1]).max() > 0.5


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


def recorded_problems(vehicle, name="curve_entry_T3", count=12, u_d=0.0, scale=1.0):
    """Problems at random states along a scenario."""
    route = scenarios.load_scenario(name).route()
    controller = NMPC(vehicle, route, 0, MPCSettings())
    generator, speed = np.random.default_rng(7), scenarios.load_scenario(name).speed
    problems = []
    for p in np.linspace(10, 500, count):
        psi, kappa = route.track_at(p)[:2, 0]
        psi_r = generator.normal(0, 2e-4) * scale
        y = generator.normal(0, 2e-3) * scale
        problems.append(controller.problem(np.array([p, psi + psi_r, speed, kappa * speed, y, psi_r]), u_d))
    return route, problems


@pytest.mark.parametrize(("u_d", "scale"), [(0.0, 1.0), (-3950.0, 4.0), (3990.0, 6.0)])
def test_fast_path_finds_the_optimum_of_ipopt(vehicle, u_d, scale):
    route, problems = recorded_problems(vehicle, count=4, u_d=u_d, scale=scale)
    for problem in problems:
        fast, reference = (NMPC(vehicle, route, 0, MPCSettings(), solver=s) for s in ("gauss_newton", "ipopt"))
        start = np.zeros(problem.settings.steps)
        ours, exact = fast.optimise(problem, start)[0], reference.optimise(problem, start)[0]
        assert np.abs(ours - exact).max() < 1e-4 * LIMIT
        assert problem.cost(problem.roll_out(ours), ours) == pytest.approx(
            problem.cost(problem.roll_out(exact), exact), rel=1e-6
        )
        if u_d:
            assert np.abs(ours).max() <= problem.bound + 1e-9


def test_bounded_torques_are_used_when_they_must(vehicle):
    route, problems = recorded_problems(vehicle, count=3, u_d=-3990.0, scale=6.0)
    active = [np.abs(NMPC(vehicle, route, 0).optimise(p, np.zeros(30))[0]).max() > 0.999 * p.bound for p in problems]
    assert any(active)


def test_lateral_bound_yields_instead_of_failing(vehicle):
    route, problems = recorded_problems(vehicle, count=3, scale=8.0)
    for problem in problems:
        tight = replace(problem, settings=replace(problem.settings, lateral_bound=1e-3))
        du, _ = NMPC(vehicle, route, 0, tight.settings).optimise(tight, np.zeros(30))
        assert np.isfinite(du).all()


def test_ltv_equals_nmpc_at_small_angles(vehicle):
    route, problems = recorded_problems(vehicle)
    for problem in problems:
        linear = LTVMPC(vehicle, route, 0).optimise(problem, np.zeros(30))[0]
        nonlinear = NMPC(vehicle, route, 0).optimise(problem, np.zeros(30))[0]
        assert np.abs(linear - nonlinear).max() < 0.05 * max(np.abs(nonlinear).max(), 50)


def test_printed_linearisation_differs_in_a_curve(vehicle):
    route, problems = recorded_problems(vehicle)
    ours, printed = (
        LTVMPC(vehicle, route, 0, printed=p).optimise(problems[-1], np.zeros(30))[0] for p in (False, True)
    )
    assert np.abs(ours - printed).max() > 10


def test_a_failing_solver_falls_back_on_the_shifted_plan(vehicle, monkeypatch):
    route, problems = recorded_problems(vehicle, count=1)
    controller = NMPC(vehicle, route, 0)
    controller.plan(problems[0].x_hat, 0.0)
    planned = controller.plan_du.copy()
    monkeypatch.setattr(controller, "solve", lambda du: (du * np.nan, 1))
    assert controller.plan(problems[0].x_hat, 0.0) == pytest.approx(planned[1])
    assert [solve.fallback for solve in controller.stats] == [False, True]


def test_forecast_drives_both_wheels_and_stops_at_rest(vehicle):
    route = scenarios.load_scenario("braking").route()
    x = np.array([100.0, 0, 40.0, 0, 0, 0])
    here = nominal_values(vehicle, 0)
    rate = np.diff(forecast(route, here, x, -1000.0, 0.02, 20).x_d[:, 2]) / 0.02
    assert rate == pytest.approx(-2000 / vehicle.wheel.radius / vehicle.effective_longitudinal_mass)
    printed = forecast(route, nominal_values(vehicle, 0, printed=True), x, -1000.0, 0.02, 20)
    assert printed.x_d[-1, 2] > x[2]
    x[2] = 0.1
    assert forecast(route, here, x, -4000.0, 0.02, 50).x_d[:, 2].min() == pytest.approx(0.0, abs=1e-12)


def test_forecast_at_rest_and_coasting_is_finite(vehicle):
    route = scenarios.load_scenario("curve_entry_T3").route()
    ahead = forecast(route, nominal_values(vehicle, 1), np.array([300.0, 0.02, 77.0, 0.01, 0, 0]), 0.0, 0.01, 10)
    assert np.isfinite(ahead.x_d).all()
    partner = route.track_at(ahead.x_d[:, 0] + vehicle.body.gear_spacing)[0]
    assert ahead.theta[:, 6] == pytest.approx((ahead.theta[:, 0] + partner) / 2)


def test_unknown_solver_is_refused(vehicle):
    with pytest.raises(InputError, match="'simplex' is not known"):
        NMPC(vehicle, scenarios.load_scenario("sine_tracking").route(), 0, solver="simplex")


def test_real_time_iteration_survives_a_broken_measurement(vehicle):
    route, problems = recorded_problems(vehicle, count=2)
    controller = NMPC(vehicle, route, 0, solver="rti")
    controller.plan(problems[0].x_hat, 0.0)
    broken = problems[0].x_hat * np.nan
    assert np.isfinite(controller.plan(broken, 0.0))
    assert np.isfinite(controller.plan(problems[0].x_hat, 0.0))
    assert [solve.fallback for solve in controller.stats] == [False, True, False]
