"""The optimal control problem as a nonlinear program for Ipopt, the reference of the other solvers. Serves the paper's
section Nonlinear Model Predictive Control."""

from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.control import problem
from railrepro.control.solvers.riccati import Horizon
from railrepro.model.control_model import STATES, THETA
from railrepro.model.parameters import PARAMETERS

_N = len(STATES)
SCALE = np.array([1.0, 1e-2, 1.0, 1e-2, 1e-3, 1e-3])
"""Units of the deviations of the states in the NLP, in the order of `control_model.STATES` (SI)."""
UNIT, COST, SLACK = 1e3, 1e6, 1e-3
"""Unit of torques in the NLP (N m), factor on the cost, unit of slacks (m). Without them solvers stop too early."""


@lru_cache
def program(variant: str, discretisation: str, steps: int) -> dict[str, ca.MX]:
    """Nonlinear program (multiple shooting) over L = `steps` time steps, a dict for `casadi.nlpsol` with the keys

    - "x", unknowns: deviations from the desired states over `SCALE`, 6 (L + 1); torques (kN m), L; slacks (mm), L;
    - "p", parameters: desired states, track theta (9 L), model parameters, tuning vector, base torque;
    - "f": `COST` times the cost of `control.problem`;
    - "g": defects of the dynamics over `SCALE`, 6 L, equal to 0; excess over both lateral bounds less slack, 2 L, <= 0.
    """
    step = problem.dynamics(variant, discretisation)
    z, du, slack = ca.MX.sym("z", _N, steps + 1), ca.MX.sym("du", steps), ca.MX.sym("slack", steps)
    x_d, theta = ca.MX.sym("x_d", _N, steps + 1), ca.MX.sym("theta", len(THETA), steps)
    par, tuning, u_d = ca.MX.sym("par", len(PARAMETERS)), ca.MX.sym("tuning", len(problem.TUNING)), ca.MX.sym("u_d")
    t, states = problem.Tuning.of(tuning), x_d + ca.repmat(ca.DM(SCALE), 1, steps + 1) * z
    cost, defects, sides = ca.MX(0), [], []
    for k in range(steps):
        x, x_plus, torque = states[:, k], states[:, k + 1], UNIT * du[k]
        x_next, *_ = step(x, torque, u_d, theta[:, k], par, t.period, 1)
        defects.append((x_next - x_plus) / SCALE)
        of_state = problem.terminal_cost if k == steps - 1 else problem.stage_cost
        cost += of_state(x_plus, x_d[:, k + 1], SLACK * slack[k], t) + problem.effort_cost(torque, t)
        sides += [excess / SLACK - slack[k] for excess in problem.lateral_excess(x_plus, t)]
    return {
        "x": ca.vertcat(ca.vec(z), du, slack),
        "p": ca.vertcat(ca.vec(x_d), ca.vec(theta), par, tuning, u_d),
        "f": COST * cost,
        "g": ca.vertcat(*defects, *sides),
    }


@lru_cache
def _solver(variant: str, discretisation: str, steps: int) -> ca.Function:
    quiet: dict[str, bool | int | float | str] = {"print_time": False, "expand": True, "error_on_fail": False}
    quiet |= {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9, "ipopt.bound_relax_factor": 0.0}
    return ca.nlpsol("nmpc", "ipopt", program(variant, discretisation, steps), quiet)


def solve(horizon: Horizon) -> int | None:
    """Solve the problem of a horizon by Ipopt, write the solution into `horizon.x` and `horizon.u`, and return the
    number of iterations. If Ipopt fails or the state is not finite, both stay as they are, and the result is None."""
    s, steps = horizon.settings, horizon.settings.steps
    x_d, bound = horizon.x_d, horizon.c.bound / UNIT
    initial = (horizon.x_hat - x_d[0]) / SCALE
    if not np.isfinite(initial).all():
        return None
    deviation = (horizon.x - x_d) / SCALE
    free = np.full(_N * steps, np.inf)
    numbers = horizon.tables["par"], s.tuning(), [horizon.c.u_d]
    function = _solver(s.variant, s.discretisation, steps)
    solution = function(
        x0=np.concatenate([deviation.ravel(), horizon.u / UNIT, np.zeros(steps)]),
        p=np.concatenate([x_d.ravel(), horizon.theta[:-1].ravel(), *numbers]),
        lbx=np.concatenate([initial, -free, np.full(steps, -bound), np.zeros(steps)]),
        ubx=np.concatenate([initial, free, np.full(steps, bound), np.full(steps, np.inf)]),
        lbg=np.concatenate([np.zeros(_N * steps), np.full(2 * steps, -np.inf)]),
        ubg=np.zeros((_N + 2) * steps),
    )
    if not function.stats()["success"]:
        return None
    deviation, torques, _ = np.split(np.array(solution["x"]).ravel(), [_N * (steps + 1), _N * (steps + 1) + steps])
    horizon.x[:] = x_d + deviation.reshape(steps + 1, _N) * SCALE
    horizon.u[:] = UNIT * torques
    return function.stats()["iter_count"]
