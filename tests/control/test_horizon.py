"""The compiled horizon against a dense quadratic program; samples against each other and the model; fallbacks."""

import ctypes
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from railrepro.control import problem
from railrepro.control.mpc import LTVMPC, NMPC
from railrepro.control.problem import MPCSettings, Tuning, dynamics
from railrepro.control.registry import guidance, with_r_times
from railrepro.control.solvers.ipopt import COST, SLACK, UNIT
from railrepro.control.solvers.riccati import MOST_SETS, Horizon
from railrepro.model.control_model import STATES, parameter_vector
from railrepro.model.forecast import nominal_values
from railrepro.simulation import scenarios, simulate
from railrepro.tuning import sets
from railrepro.vehicle.parameters import load_vehicle

Q = (2e-3, 3e2, 5e-3, 7e1, 1.0, 1.1e2)
SETTINGS = MPCSettings(Q, r=3e-11, q_terminal=4.0, steps=10, lateral_bound=5e-4, bound_weight=30.0)
WIDE = MPCSettings((0.0, 0.0, 0.0, 2e-4, 1.0, 5.0), r=1e-12, q_terminal=3.0, steps=12, lateral_bound=1.0)
SPEED, BASE = 77.0, 500.0
AT = {name: i for i, name in enumerate(STATES)}
V, ROUTE = load_vehicle(), scenarios.load_scenario("curve_entry_T3").route()
PARAMETERS, NOMINAL = parameter_vector(V), nominal_values(V, 0)
RTI = (NMPC, {"solver": "rti"})
CONTROLLERS = [(NMPC, {}), RTI, (NMPC, {"solver": "ipopt"}), (LTVMPC, {})]
_PSI, _KAPPA = ROUTE.track_at(200.0)[:2, 0]
X = np.array([200.0, _PSI, SPEED, _KAPPA * SPEED, 2e-3, 3e-4])  # on the clothoid, off centre and yawed


def horizon_of(settings=SETTINGS, bound=4000.0):
    """A horizon with a problem, a forecast and a trajectory that does not obey the model."""
    horizon, generator = Horizon(settings, NOMINAL, PARAMETERS, ROUTE), np.random.default_rng(4)
    u, scatter = generator.normal(0, 300, settings.steps), generator.normal(0, 1e-5, (settings.steps + 1, len(STATES)))
    horizon.forecast(X, BASE)
    horizon.c.bound = bound
    horizon.u[:], horizon.x[:] = u, horizon.x_d + scatter
    return horizon


def linearise(horizon):
    """Model along the trajectory: next states (L, 6), nonzeros of A, B (L, 6)."""
    horizon.library.horizon_linearise(horizon.pointer)
    return [horizon.stages[name][:-1] for name in ("x_next", "a", "b")]


def minimiser(horizon):
    """Steps of the states (L + 1, 6) and torques (L,) that minimise the stated cost about a linearised horizon. The
    states are eliminated and the program is dense, so that it shares nothing with the recursion but the cost."""
    s, steps = horizon.settings, horizon.settings.steps
    t, model = Tuning.of(ca.DM(s.tuning())), dynamics(s.variant, s.discretisation)
    du, slack = ca.SX.sym("du", steps), ca.SX.sym("slack", steps)
    dx, cost, sides = [ca.SX(horizon.x_hat - horizon.x[0])], 0, []
    for k, (x_next, nonzeros, b) in enumerate(zip(*linearise(horizon), strict=True)):
        a, gap = ca.DM(model.sparsity_out(1), nonzeros), x_next - horizon.x[k + 1]
        dx.append(a @ dx[k] + b * UNIT * du[k] + gap)
        state = horizon.x[k + 1] + dx[k + 1]
        of_state = problem.terminal_cost if k == steps - 1 else problem.stage_cost
        cost += of_state(state, horizon.x_d[k + 1], SLACK * slack[k], t)
        cost += problem.effort_cost(horizon.u[k] + UNIT * du[k], t)
        sides += [excess / SLACK - slack[k] for excess in problem.lateral_excess(state, t)]
    program = {"x": ca.vertcat(du, slack), "f": COST * cost, "g": ca.vertcat(*sides)}
    low, high = ((sign * horizon.c.bound - horizon.u) / UNIT for sign in (-1, 1))
    solver = ca.qpsol("judge", "daqp", program)
    found = solver(lbx=[*low, *-np.full(steps, np.inf)], ubx=[*high, *np.full(steps, np.inf)], ubg=0)["x"][:steps]
    states = ca.Function("states", [du], [ca.horzcat(*dx)])
    return np.array(states(found)).T, UNIT * np.array(found).ravel()


@pytest.mark.parametrize(
    ("most_sets", "start"),
    [(MOST_SETS, 0.0), (MOST_SETS, -1.0), (MOST_SETS, "alternating"), (1, 1.0), (1, "alternating")],
)
@pytest.mark.parametrize(
    ("bound", "changes", "affine"),
    [
        (4000.0, {}, 1.0),
        (4000.0, {"lateral_bound": 1.0}, 0.0),
        (200.0, {}, 0.0),
        (30.0, {"lateral_bound": 1.0, "r": 3e-10}, 1.0),
        (1000.0, {"steps": 40, "bound_weight": 3e3}, 1.0),
    ],
)
def test_the_problem_is_linearised_and_its_minimiser_is_found_from_any_start(bound, changes, affine, start, most_sets):
    horizon = horizon_of(replace(SETTINGS, **changes), bound)
    horizon.u[:] = horizon.u.clip(-bound, bound)
    horizon.c.affine, horizon.c.most_sets = affine, most_sets
    s = horizon.settings
    for k, found in enumerate(zip(*linearise(horizon), strict=True)):
        numbers = horizon.theta[k], PARAMETERS, s.period, affine
        expected = dynamics(s.variant, s.discretisation)(horizon.x[k], horizon.u[k], BASE, *numbers)
        for ours, other in zip(found, expected, strict=True):
            assert np.abs(ours - other.nonzeros()).max() <= 1e-7 * np.abs(other.nonzeros()).max()
    dx, du = minimiser(horizon)
    alternating = (-1.0) ** np.arange(len(horizon.stages))
    horizon.stages["fixed"] = alternating if start == "alternating" else start
    assert horizon.library.horizon_solve(horizon.pointer) == 0
    assert horizon.stages["du"][:-1] == pytest.approx(du, rel=1e-6, abs=1e-6 * bound)
    assert horizon.stages["dx"] == pytest.approx(dx, rel=1e-6, abs=1e-9)
    fixed = horizon.stages["fixed"][:-1] != 0
    assert np.array_equal(fixed, np.isclose(np.abs(horizon.u + du), bound, rtol=1e-8))
    assert fixed.any() == (bound < 4000.0) and horizon.c.passes <= 40


@pytest.mark.parametrize(("name", "solver"), [("nmpc", "gauss_newton"), ("nmpc_observer", "rti")])
def test_no_sample_on_poor_rail_falls_back(name, solver):
    """With tuning for dry rail the gear leaves the poor one, nearly all torques and positions at their bounds."""
    weights = with_r_times(sets.load(name, "paper")["parameters"], 0.01)  # as a cost without a margin asks for
    built, most = guidance(name, weights, {"solver": solver}), []

    class Counting(NMPC):
        def plan(self, x_hat, u_d):
            torque = super().plan(x_hat, u_d)
            most.append(self.c.passes)
            return torque

    cone = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
    run = simulate.run(
        scenarios.load_scenario("adhesion_loss"), replace(built, controller=Counting), plant_vehicle=cone
    )
    assert run.failed and not any(guided.fallbacks for guided in run.controllers) and max(most) < 60
    # the last problem of a converged sample starts from its solution
    assert solver != "rti" or np.mean(np.array(most) > MOST_SETS) > 0.02


@pytest.mark.parametrize(("kind", "options"), [RTI, (NMPC, {}), (LTVMPC, {"printed": True})])
def test_the_loop_runs_the_sample_that_plan_runs(kind, options):
    class Planned(kind):
        def plan(self, x_hat, u_d):
            return super().plan(x_hat, u_d)

    scenario, settings = scenarios.load_scenario("braking").but(end_m=80.0), replace(WIDE, observer=0.3)
    fast, slow = (simulate.run(scenario, lambda *of, c=c: c(*of, settings, **options)) for c in (kind, Planned))
    assert fast.series.equals(slow.series) and fast.series["front.du"].abs().max() > 10
    for one, other in zip(fast.controllers, slow.controllers, strict=True):
        assert not one.stats and len(other.stats) > 100
        assert np.array_equal(one.plan_du, other.plan_du) and one.c.offset == other.c.offset != 0


def after(x, torque, guided):
    """State one sample later by the controller's own model."""
    s = guided.settings
    theta = Horizon(s, NOMINAL, PARAMETERS, ROUTE).forecast(x, 0.0).theta[0]
    following, *_ = dynamics("corrected", s.discretisation)(x, torque, 0.0, theta, PARAMETERS, s.period, 1.0)
    return np.array(following).ravel()


@pytest.mark.parametrize(("kind", "options"), CONTROLLERS)
def test_the_observer_learns_nothing_on_the_model_itself_and_the_angle_behind_a_push(kind, options):
    offsets = []
    for push in (0.0, 1e-4):
        guided = kind(V, ROUTE, 0, replace(WIDE, observer=1.0), **options)
        following = after(X, guided.plan(X, 0.0), guided)
        assert abs(following[AT["y_TrAx"]] - X[AT["y_TrAx"]]) > 1e-4
        following[AT["y_TrAx"]] += push
        guided.plan(following, 0.0)
        offsets.append(guided.c.offset)
    assert offsets == pytest.approx([0.0, 1e-4 / SPEED / WIDE.period], abs=2e-6)


@pytest.mark.parametrize(("kind", "options"), CONTROLLERS)
def test_while_measurements_are_broken_or_no_torque_is_left_the_old_plan_plays_on(kind, options):
    guided, broken = kind(V, ROUTE, 0, WIDE, **options), X * np.nan
    guided.plan(X, 0.0)
    planned, sample = guided.plan_du.copy(), (ctypes.c_void_p(broken.ctypes.data), ctypes.c_double(0.0))
    assert [guided._torque(*sample) for _ in range(4)] == pytest.approx(planned[1:5])  # as compiled loops call it
    assert guided.plan(X, 0.0) == pytest.approx(planned[0], rel=0.1 if "rti" in options.values() else 1e-4)
    assert guided.fallbacks == 4 and len(guided.stats) == 2
    guided.c.most_sets, guided.drive[0] = 0, 0.0
    assert guided.plan(X, 0.0) == 0.0 and guided.fallbacks == 4 + ("ipopt" not in options.values())


@pytest.mark.parametrize(
    ("kind", "options", "push", "apart"), [(*RTI, 0.0, 1e-3), (*RTI, 1.0, 20.0), (LTVMPC, {}, 1.0, 0.2)]
)
def test_real_time_iteration_and_linear_mpc_are_near_the_converged_plan(kind, options, push, apart):
    """In N m of up to 4000, in closed loop on the model, with pushes and base torques that jump and without them."""
    settings = replace(WIDE, lateral_bound=1.5e-3, bound_weight=30.0, observer=0.3)
    converged, near = NMPC(V, ROUTE, 0, settings), kind(V, ROUTE, 0, settings, **options)
    random, x = np.random.default_rng(4), X
    for _ in range(40):
        base = push * random.uniform(-1500, 1500)
        torque = converged.plan(x, base)
        assert near.plan(x, base) == pytest.approx(torque, abs=apart)
        x = after(x, torque, converged) + push * random.normal(0, 1, 6) * [0, 0, 0, 1e-3, 5e-4, 1e-4]
    assert near.c.offset == pytest.approx(converged.c.offset, rel=1e-3, abs=1e-9)
    assert abs(converged.c.offset) > push * 1e-5


@pytest.mark.parametrize(("kind", "options"), [(NMPC, {}), RTI, (LTVMPC, {})])
def test_a_base_torque_leaves_less_as_printed_and_is_left_out_when_unknown(kind, options):
    def torque(base, **changes):
        return kind(V, ROUTE, 0, replace(WIDE, **changes), **options).plan(X, base)

    assert abs(torque(-3990.0, r=1e-14, yielding=False)) == pytest.approx(10.0)
    assert abs(torque(-3990.0, r=1e-14)) > 100.0
    assert torque(-3990.0, informed=False) == torque(0.0) != torque(-3990.0)


def test_without_preview_the_forecast_keeps_the_present_set_point_and_knows_the_track():
    x_d, theta = (getattr(NMPC(V, ROUTE, 0, WIDE).problem(X, 0.0).ahead, name) for name in ("x_d", "theta"))
    held = NMPC(V, ROUTE, 0, replace(WIDE, previewed=False)).problem(X, 0.0).ahead
    assert np.ptp(x_d[:, AT["y_TrAx"]]) > 1e-5 and x_d[:, AT["psi_TrAx"]].any(), "a set point that moves"
    assert held.x_d[:, AT["y_TrAx"]] == pytest.approx(x_d[0, AT["y_TrAx"]]) and not held.x_d[:, AT["psi_TrAx"]].any()
    heading, curvature, *_ = ROUTE.track_at(held.x_d[:, AT["x"]])
    assert held.x_d[:, AT["psi_Ax"]] == pytest.approx(heading) and (held.theta == theta).all()
    assert held.x_d[:, AT["psidot_Ax"]] == pytest.approx(curvature * held.x_d[:, AT["xdot"]])


@pytest.mark.parametrize("printed", [False, True])
def test_the_linear_problem_linearises_along_the_track_and_as_printed_at_no_heading(printed):
    guided = LTVMPC(V, ROUTE, 0, WIDE, printed=printed)
    guided.plan(X, 0.0)
    heading = np.array(ROUTE.track_at(guided.horizon.x_d[:, AT["x"]])[0])
    assert guided.horizon.x[:, AT["psi_Ax"]] == pytest.approx(0.0 if printed else heading, rel=1e-9)
