"""Solvers on one horizon: compiled and plain agree, linear MPC is a least-squares problem, iterations start warm."""

import time
from dataclasses import replace

import numpy as np
import pytest

from railrepro.compile import codegen
from railrepro.control.ltv_mpc import LTVMPC
from railrepro.control.nmpc import NMPC
from railrepro.control.problem import MPCSettings, dynamics
from railrepro.control.registry import guidance
from railrepro.control.solvers import condensed, ipopt, riccati
from railrepro.control.solvers.planner import Planner
from railrepro.control.solvers.riccati import MOST_SETS, Horizon, PlainHorizon
from railrepro.errors import InputError
from railrepro.evidence.runs import tuning
from railrepro.model.control_model import STATES, control_model, discretise
from railrepro.model.forecast import forecast, nominal_values
from railrepro.simulation import scenarios, simulate
from railrepro.vehicle.parameters import load_vehicle

Q = (2e-3, 3e2, 5e-3, 7e1, 1.0, 1.1e2)
SETTINGS = MPCSettings(Q, r=3e-11, q_terminal=4.0, steps=10, lateral_bound=5e-4, bound_weight=30.0)
WIDE = MPCSettings((0.0, 0.0, 0.0, 2e-4, 1.0, 5.0), r=1e-12, q_terminal=3.0, steps=12, lateral_bound=1.0)
SPEED, BASE = 77.0, 500.0
AT = {name: i for i, name in enumerate(STATES)}
needs_compiler = pytest.mark.skipif(codegen.compiler() is None, reason="the recursion is compiled code")


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


@pytest.fixture(scope="module")
def way():
    return scenarios.load_scenario("curve_entry_T3").route()


def measured(way, p=200.0, **values):
    """On the clothoid, along the track but for `values`."""
    psi, kappa = way.track_at(p)[:2, 0]
    state = {"x": p, "psi_Ax": psi, "xdot": SPEED, "psidot_Ax": kappa * SPEED, "y_TrAx": 0.0, "psi_TrAx": 0.0}
    return np.array(list((state | values).values()))


STATE = {"y_TrAx": 2e-3, "psi_TrAx": 3e-4}


def horizons(vehicle, way, settings=SETTINGS):
    """A compiled horizon and a plain one with the same problem and the same trajectory."""
    arguments = settings, nominal_values(vehicle, 0), control_model().parameter_vector(vehicle), way
    both = riccati.horizon(*arguments), PlainHorizon(*arguments)
    assert isinstance(both[0], Horizon)
    generator = np.random.default_rng(4)
    u, scatter = generator.normal(0, 300, settings.steps), generator.normal(0, 1e-5, (settings.steps + 1, len(STATES)))
    for horizon in both:
        horizon.sample(measured(way, **STATE), BASE, 4000.0)
        horizon.forecast()
        horizon.u[:], horizon.x[:] = u, horizon.x_d + scatter
    return both


@needs_compiler
@pytest.mark.parametrize("affine", [1.0, 0.0])
@pytest.mark.parametrize("bound", [4000.0, 200.0])
def test_compiled_and_plain_horizon_are_the_same(vehicle, way, affine, bound):
    compiled, plain = both = horizons(vehicle, way)
    for horizon in both:
        horizon.affine = affine
        horizon.sample(horizon.x_hat.copy(), BASE, bound)
        horizon.linearise()
        horizon.solve()
    names = ("x_d", "theta", "x_next", "matrices", "b", "dx", "du")
    for name in names:
        ours, other = (np.array(getattr(horizon, name)) for horizon in both)
        assert ours.shape == other.shape
        assert np.abs(ours - other).max() <= 1e-7 * np.abs(other).max(), name
    wanted = plain.u + plain.du
    for horizon in both:
        before = horizon.x.copy()
        horizon.apply()
        assert horizon.x == pytest.approx(before + plain.dx, rel=1e-6, abs=1e-9)
        assert horizon.u == pytest.approx(np.clip(wanted, -bound, bound), rel=1e-6, abs=1e-4)
    assert (compiled.u_d, compiled.bound, compiled.affine) == (plain.u_d, plain.bound, plain.affine)


@needs_compiler
def test_compiled_and_plain_horizon_converge_alike(vehicle, way):
    both = horizons(vehicle, way)
    counts = [horizon.iterate(20, 1e-4) for horizon in both]
    assert counts[0] == counts[1] in (3, 4, 5)
    assert both[0].u == pytest.approx(both[1].u, rel=1e-6, abs=1e-4)
    assert both[0].x == pytest.approx(both[1].x, rel=1e-6, abs=1e-8)
    for horizon in both:
        assert horizon.iterate(20, 1e-4) == 1
        horizon.linearise()
        assert np.abs(horizon.x_next - horizon.x[1:]).max() < 1e-9
        assert horizon.x[0] == pytest.approx(measured(way, **STATE))


@needs_compiler
@pytest.mark.parametrize("which", [0, 1])
def test_iterations_end_when_torque_and_trajectory_rest(vehicle, way, which):
    horizon = horizons(vehicle, way)[which]
    assert horizon.iterate(1, 1e-4) == 1
    with pytest.raises(ArithmeticError, match="horizon: no convergence"):
        horizon.iterate(4, 0.0)
    horizon.iterate(20, 1e-4)
    horizon.x[3:, AT["x"]] += 1e-3
    assert horizon.iterate(20, 1e9) == 2, "a trajectory that broke the model took no second iteration"


@needs_compiler
@pytest.mark.parametrize("weight", [3e-11, 3e-9])
@pytest.mark.parametrize("fixed", [0.0, 1.0, -1.0, "alternating"])
def test_the_recursion_finds_the_active_set_from_any_start_by_itself(vehicle, way, fixed, weight, monkeypatch):
    compiled, plain = horizons(vehicle, way, replace(SETTINGS, r=weight))
    for horizon in (compiled, plain):
        horizon.linearise()
    plain.solve()
    bound = 0.5 * np.abs(plain.u + plain.du).max()
    for horizon in (compiled, plain):
        horizon.sample(horizon.x_hat.copy(), BASE, bound)
    plain.solve()
    at_bound = np.isclose(np.abs(plain.u + plain.du), bound)
    assert 0 < at_bound.sum() < at_bound.size

    def refused(horizon):
        raise AssertionError("the recursion handed its problem over")

    monkeypatch.setattr(condensed, "solve", refused)
    compiled.fixed[:] = (-1.0) ** np.arange(compiled.fixed.size) if fixed == "alternating" else fixed
    compiled.solve()
    assert compiled.du == pytest.approx(plain.du, rel=1e-6, abs=1e-4)
    assert np.array_equal(compiled.fixed != 0, at_bound)


@needs_compiler
def test_one_iteration_is_one_newton_step(vehicle, way):
    for stepwise, at_once in zip(horizons(vehicle, way), horizons(vehicle, way), strict=True):
        stepwise.linearise()
        stepwise.solve()
        stepwise.apply()
        at_once.iterate(1, 1e-4)
        assert at_once.u == pytest.approx(stepwise.u, rel=1e-12)
        assert at_once.x == pytest.approx(stepwise.x, rel=1e-12)


@needs_compiler
@pytest.mark.parametrize("bound", [4000.0, 150.0, 20.0])
@pytest.mark.parametrize("lateral_bound", [5e-4, 1.0])
def test_active_sets_that_do_not_settle_are_found_by_interior_points(vehicle, way, bound, lateral_bound, monkeypatch):
    compiled, plain = horizons(vehicle, way, replace(SETTINGS, steps=40, lateral_bound=lateral_bound))
    compiled.c.most_sets, compiled.fixed[::3] = 1, -1.0
    for horizon in (compiled, plain):
        horizon.sample(horizon.x_hat.copy(), BASE, bound)
        horizon.u[:] = horizon.u.clip(-bound, bound)
        horizon.linearise()
    plain.solve()
    monkeypatch.setattr(condensed, "solve", None)
    compiled.solve()
    assert compiled.du == pytest.approx(plain.du, rel=1e-7, abs=1e-6 * bound)
    assert compiled.dx == pytest.approx(plain.dx, rel=1e-6, abs=1e-9)
    at_bound = np.isclose(np.abs(plain.u + plain.du), bound, rtol=1e-9)
    assert np.array_equal(compiled.fixed != 0, at_bound) and at_bound.any() == (bound < 4000.0)
    assert 4 < compiled.passes[0] <= 40


@needs_compiler
@pytest.mark.parametrize(("name", "solver"), [("nmpc", "gauss_newton"), ("nmpc_observer", "rti")])
def test_no_sample_on_poor_rail_needs_more_than_compiled_code(name, solver, monkeypatch):
    """With tuning for dry rail the gear leaves the poor one, nearly all torques and positions at their bounds."""
    most, solve, plan = [], Horizon.solve, Planner.plan

    def counted(horizon):
        solve(horizon)
        most.append(horizon.passes[0])

    def planned(planner, *arguments):
        found = plan(planner, *arguments)
        most.append(planner.horizon.passes[0])
        return found

    monkeypatch.setattr(condensed, "solve", None)
    monkeypatch.setattr(Horizon, "solve", counted)
    monkeypatch.setattr(Planner, "plan", planned)
    if solver == "gauss_newton":
        monkeypatch.setattr(Horizon, "iterate", PlainHorizon.iterate)
    controller = guidance(name, tuning.load(name, "paper")["parameters"], {"solver": solver})
    cone = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
    run = simulate.run(scenarios.load_scenario("adhesion_loss"), controller, plant_vehicle=cone)
    assert run.failed and not any(record.fallback for guided in run.controllers for record in guided.stats)
    assert np.mean(np.array(most) > MOST_SETS) > 0.02
    assert max(most) < 60


@needs_compiler
def test_a_problem_without_interior_is_solved_densely(vehicle, way):
    compiled, plain = horizons(vehicle, way)
    compiled.c.most_sets = 0
    for horizon in (compiled, plain):
        horizon.sample(horizon.x_hat.copy(), BASE, 0.0)
        horizon.linearise()
        horizon.solve()
    assert compiled.du == pytest.approx(plain.du, rel=1e-9)
    assert compiled.du == pytest.approx(-compiled.u)
    assert compiled.dx == pytest.approx(plain.dx, rel=1e-9, abs=1e-12)
    assert compiled.iterate(20, 1e-4) == plain.iterate(20, 1e-4) > 1
    assert compiled.u == pytest.approx(plain.u, rel=1e-9)


@needs_compiler
@pytest.mark.parametrize("which", [0, 1])
def test_a_horizon_with_nan_fails_and_recovers(vehicle, way, which):
    horizon = horizons(vehicle, way)[which]
    horizon.x[2, AT["y_TrAx"]] = np.nan
    with pytest.raises((ArithmeticError, np.linalg.LinAlgError)):
        horizon.iterate(3, 1e-4)
    horizon.x[:], horizon.u[:] = horizon.x_d, 0.0
    reference = horizons(vehicle, way)[which]
    reference.iterate(20, 1e-4)
    horizon.iterate(20, 1e-4)
    assert horizon.u == pytest.approx(reference.u, rel=1e-6, abs=1e-4)


def least_squares(vehicle, problem, x_lin, affine):
    """Torques of a linear MPC: slopes by differences of the discretised model, one least-squares problem in numpy."""
    s, n = problem.settings, len(STATES)
    step, parameters = discretise(control_model(), s.discretisation), problem.parameters

    def model(x, du, k):
        torques = [problem.u_d - du, problem.u_d + du]
        return np.array(step(x, torques, problem.ahead.theta[k], parameters, s.period)).ravel()

    size = np.array([1.0, 1e-3, 0.1, 1e-3, 1e-4, 1e-4])
    free, forced = problem.x_hat.copy(), np.zeros((n, s.steps))
    rows, targets = [], []
    for k, at in enumerate(x_lin[:-1]):
        a = np.transpose([(model(at + d, 0.0, k) - model(at - d, 0.0, k)) / (2 * d.sum()) for d in np.diag(size)])
        b = (model(at, 1.0, k) - model(at, -1.0, k)) / 2
        free = a @ free + ((model(at, 0.0, k) - a @ at) if affine else 0.0)
        forced = a @ forced
        forced[:, k] = b
        last = k == s.steps - 1
        scale = [0, 0, 0, 0, s.q_terminal, s.q_terminal] if last else np.ones(n)
        root = np.sqrt(np.array(s.q_diag) * scale)
        rows.append(root[:, None] * forced)
        targets.append(root * (problem.ahead.x_d[k + 1] - free))
    rows.append(np.sqrt(s.r) * np.eye(s.steps))
    targets.append(np.zeros(s.steps))
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)[0]


@pytest.mark.parametrize(("name", "place", "printed"), [("T3", 200, False), ("T1", 100, False), ("T3", 200, True)])
def test_linear_mpc_is_least_squares_about_centred_riding(vehicle, name, place, printed):
    """About the track's heading and turn rate; as printed about heading zero and without the affine term (D6).

    The turn rate about which it is linearised matters by 0.4 N m on T1 and by 2 mN m on T3.
    """
    way = scenarios.load_scenario(f"curve_entry_{name}").route()
    guided = LTVMPC(vehicle, way, 0, WIDE, printed=printed)
    problem = guided.problem(measured(way, place, **STATE), 0.0)
    x_d, theta = problem.ahead.x_d, problem.ahead.theta
    about = np.zeros_like(x_d)
    about[:, AT["x"]], about[:, AT["xdot"]] = x_d[:, AT["x"]], x_d[:, AT["xdot"]]
    if not printed:
        psi, kappa = way.track_at(x_d[:, AT["x"]])[:2]
        about[:, AT["psi_Ax"]], about[:, AT["psidot_Ax"]] = psi, kappa * x_d[:, AT["xdot"]]
    expected = least_squares(vehicle, problem, about, not printed)
    found, iterations = guided.optimise(problem, np.zeros(WIDE.steps))
    assert iterations == 1
    assert np.abs(theta[:, 0]).min() > 1e-3
    assert found == pytest.approx(expected, rel=1e-7, abs=1e-3)


def after(x, torque, guided):
    """State one sample later by the controller's own model."""
    s = guided.settings
    theta = forecast(guided.route, nominal_values(guided.vehicle, 0), x, 0.0, s.period, 1).theta[0]
    found, *_ = dynamics("corrected", s.discretisation)(x, torque, 0.0, theta, guided.parameters, s.period, 1.0)
    return np.array(found).ravel()


def follow(guided, x, samples, push=0.0):
    """A controller on its own model, with a push on the yaw rate every sample: last state and torques."""
    torques = []
    for _ in range(samples):
        torques.append(guided.plan(x, 0.0))
        x = after(x, torques[-1], guided)
        x[AT["psidot_Ax"]] += push
    return x, np.array(torques)


@pytest.mark.parametrize(("kind", "options"), [(NMPC, {}), (NMPC, {"solver": "ipopt"}), (LTVMPC, {})])
def test_the_expected_state_is_where_the_model_goes(vehicle, way, kind, options):
    guided, x = kind(vehicle, way, 0, WIDE, **options), measured(way, **STATE)
    following = after(x, guided.plan(x, 0.0), guided)
    lateral = [AT[name] for name in ("psi_Ax", "psidot_Ax", "y_TrAx", "psi_TrAx")]
    moved = (following - x)[lateral]
    assert (guided.expected_state() - x)[lateral] == pytest.approx(moved, rel=2e-3, abs=1e-6)
    assert np.abs(moved).min() > 1e-4


@pytest.mark.parametrize("solver", ["gauss_newton", "ipopt"])
def test_a_solve_starts_from_the_trajectory_before_one_sample_later(vehicle, way, solver, monkeypatch):
    guided, starts = NMPC(vehicle, way, 0, WIDE, solver=solver), []
    where, name = (ipopt, "solve") if solver == "ipopt" else (guided.horizon, "iterate")
    original = getattr(where, name)

    def spied(*arguments):
        torques = arguments[-1] if solver == "ipopt" else guided.horizon.u
        starts.append((guided.horizon.x.copy(), torques.copy()))
        return original(*arguments)

    monkeypatch.setattr(where, name, spied)
    x = measured(way, **STATE)
    guided.plan(x, 0.0)
    planned, torques = guided.horizon.x.copy(), guided.plan_du.copy()
    assert starts[0][0][1:] == pytest.approx(guided.horizon.x_d[1:])
    guided.plan(planned[1], 0.0)
    states, warm = starts[1]
    assert states[1:-1] == pytest.approx(planned[2:])
    assert states[0] == pytest.approx(planned[1])
    assert states[-1] == pytest.approx(guided.horizon.x_d[-1])
    assert warm == pytest.approx([*torques[1:], torques[-1]])
    if solver == "gauss_newton":
        assert starts[0][0][0] == pytest.approx(x)
        assert guided.stats[1].iterations <= 3


def test_after_a_failure_a_solve_starts_afresh(vehicle, way):
    guided, x = NMPC(vehicle, way, 0, WIDE), measured(way, **STATE)
    first = guided.plan(x, 0.0)
    guided.plan(np.full(len(STATES), np.nan), 0.0)
    assert guided.stats[-1].fallback and np.isfinite(guided.plan_du).all()
    assert guided.plan(x, 0.0) == pytest.approx(first, abs=0.1)
    assert not guided.stats[-1].fallback


@pytest.mark.parametrize("solver", ["gauss_newton", "rti", "ipopt"])
def test_while_measurements_are_broken_the_old_plan_plays_on(vehicle, way, solver):
    guided, x = NMPC(vehicle, way, 0, WIDE, solver=solver), measured(way, **STATE)
    guided.plan(x, 0.0)
    planned = guided.plan_du.copy()
    assert [guided.plan(x * np.nan, 0.0) for _ in range(4)] == pytest.approx(planned[1:5])
    assert [record.fallback for record in guided.stats] == [False, True, True, True, True]


@needs_compiler
@pytest.mark.parametrize("change", [{"observer": 0.3}, {"yielding": False}, {"informed": False}, {"steps": 41}])
@pytest.mark.parametrize(("kind", "options"), [(NMPC, {"solver": "rti"}), (LTVMPC, {}), (LTVMPC, {"printed": True})])
def test_a_compiled_sample_is_the_one_done_step_by_step(kind, options, change, vehicle, way):
    """To the bit: torques, plans, offsets and failures over samples with pushes, base torques and broken readings."""
    settings = replace(WIDE, lateral_bound=1.5e-3, bound_weight=30.0, **change)
    compiled, by_step = (kind(vehicle, way, 0, settings, **options) for _ in range(2))
    by_step._samples = None
    random, x = np.random.default_rng(4), measured(way, **STATE)
    for sample in range(40):
        seen = x * np.nan if sample in (16, 17) else x
        base = 3990.0 if sample % 5 == 0 else random.uniform(-4200, 4200)
        assert compiled.plan(seen, base) == by_step.plan(seen, base)
        assert np.array_equal(compiled.plan_du, by_step.plan_du) and compiled.offset == by_step.offset
        assert np.array_equal(compiled.horizon.fixed, by_step.horizon.fixed)
        x = after(x, compiled.plan_du[0], compiled) + random.normal(0, 1, 6) * [0, 0, 0, 1e-3, 5e-4, 1e-4]
    failed = [[record.fallback for record in guided.stats] for guided in (compiled, by_step)]
    assert failed[0] == failed[1] and failed[0].count(True) == 2
    assert (compiled.offset != 0.0) == (settings.observer > 0.0)


@pytest.mark.parametrize(("push", "tolerance"), [(0.0, 1e-6), (2e-4, 1e-2)])
def test_real_time_iteration_prepared_ahead_is_the_iteration_done_at_once(vehicle, way, push, tolerance):
    """Recording switches the preparation off. Both are one Newton step; only the forecast's place differs by a push."""
    x = measured(way, **STATE)
    ahead, at_once = (NMPC(vehicle, way, 0, WIDE, recorded, solver="rti") for recorded in (None, []))
    found, reference = (follow(guided, x, 6, push)[1] for guided in (ahead, at_once))
    assert np.abs(reference).max() > 50
    assert found == pytest.approx(reference, rel=0, abs=tolerance * np.abs(reference).max())
    assert [s.iterations for s in ahead.stats + at_once.stats] == [1] * 12


def test_real_time_iteration_approaches_the_converged_optimum(vehicle, way):
    guided = NMPC(vehicle, way, 0, WIDE, solver="rti")
    x, _ = follow(guided, measured(way, **STATE), 4)
    converged = NMPC(vehicle, way, 0, WIDE)
    assert guided.plan(x, 0.0) == pytest.approx(converged.plan(x, 0.0), rel=1e-3, abs=0.1)


def test_real_time_iteration_keeps_its_bound_counts_its_time_and_falls_back(vehicle, way):
    begin = time.perf_counter()
    strict = MPCSettings(WIDE.q_diag, WIDE.r, WIDE.q_terminal, steps=12, lateral_bound=1.0, yielding=False)
    guided, x = NMPC(vehicle, way, 0, strict, solver="rti"), measured(way, y_TrAx=5e-3)
    guided.plan(x, 0.0)
    assert abs(guided.plan(x, 3950.0)) <= 50.0
    kept = guided.plan_du.copy()
    guided.plan(x * np.nan, -3960.0)
    assert guided.plan_du[:-1] == pytest.approx(np.clip(kept[1:], -40, 40))
    spent = [record.seconds + record.preparation for record in guided.stats]
    assert sum(spent) < time.perf_counter() - begin
    assert min(min(record.seconds, record.preparation) for record in guided.stats) > 0
    assert [record.fallback for record in guided.stats] == [False, False, True]
    assert np.isfinite(guided.plan(x, 0.0))


def test_ipopt_falls_back_and_starts_afresh(vehicle, way):
    guided, x = NMPC(vehicle, way, 0, WIDE, solver="ipopt"), measured(way, **STATE)
    first = guided.plan(x, 0.0)
    assert first == pytest.approx(NMPC(vehicle, way, 0, WIDE).plan(x, 0.0), abs=0.1)
    assert guided.stats[0].iterations > 3
    guided.plan(x * np.nan, 0.0)
    assert guided.stats[1].fallback
    assert guided.plan(x, 0.0) == pytest.approx(first, abs=0.1)


def test_a_solver_that_is_not_known_is_refused(vehicle, way):
    with pytest.raises(InputError, match="NMPC solver 'sqp' is not known; there are"):
        NMPC(vehicle, way, 0, WIDE, solver="sqp")
