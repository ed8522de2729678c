"""The optimal control problem as a nonlinear program for Ipopt, the reference of the other solvers.

Serves the paper's section Nonlinear Model Predictive Control.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.control.solvers.condensed import UNIT
from railrepro.control.solvers.riccati import PlainHorizon, model_function
from railrepro.model.control_model import THETA, Y
from railrepro.model.derivation import PARAMETERS

_SCALE = np.array([1.0, 1e-2, 1.0, 1e-2, 1e-3, 1e-3])
_COST = 1e6


@lru_cache
def _solver(variant: str, discretisation: str, steps: int) -> ca.Function:
    """Multiple-shooting NLP; states as scaled deviations from the desired ones, torques in kN m, slacks in mm."""
    step = model_function(variant, discretisation)
    z, du, slack = ca.MX.sym("z", 6, steps + 1), ca.MX.sym("du", steps), ca.MX.sym("slack", steps)
    x_d, theta = ca.MX.sym("x_d", 6, steps + 1), ca.MX.sym("theta", len(THETA), steps)
    par, q, rest = ca.MX.sym("par", len(PARAMETERS)), ca.MX.sym("q", 6), ca.MX.sym("rest", 6)
    r, q_terminal, period, u_d, bound, soft = ca.vertsplit(rest)
    states = x_d + ca.repmat(ca.DM(_SCALE), 1, steps + 1) * z
    cost, defects, sides = 0, [], []
    for k in range(steps):
        torque = UNIT * du[k]
        x_next, *_ = step(states[:, k], torque, u_d, theta[:, k], par, period, 1)
        defects.append((x_next - states[:, k + 1]) / _SCALE)
        error = states[:, k + 1] - x_d[:, k + 1]
        weight = q * ca.vertcat(0, 0, 0, 0, q_terminal, q_terminal) if k == steps - 1 else q
        cost += period * (ca.dot(weight, error**2) + r * torque**2 + soft * (1e-3 * slack[k]) ** 2)
        y = states[Y, k + 1]
        sides += [1e3 * (y - bound) - slack[k], 1e3 * (-y - bound) - slack[k]]
    problem = {
        "x": ca.vertcat(ca.vec(z), du, slack),
        "p": ca.vertcat(ca.vec(x_d), ca.vec(theta), par, q, rest),
        "f": _COST * cost,
        "g": ca.vertcat(*defects, *sides),
    }
    quiet = {"print_time": False, "expand": True, "error_on_fail": False}
    quiet |= {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9, "ipopt.bound_relax_factor": 0.0}
    return ca.nlpsol("nmpc", "ipopt", problem, quiet)


def solver(settings) -> ca.Function:
    """Ipopt on the problem of some settings, for `solve`."""
    return _solver(settings.variant, settings.discretisation, settings.steps)


def solve(
    function: ca.Function, horizon: PlainHorizon, parameters: np.ndarray, du: np.ndarray
) -> tuple[np.ndarray, int]:
    """Minimise over the problem in a horizon.

    Parameters
    ----------
    function : casadi.Function
        See `solver`.
    horizon : PlainHorizon
        Problem and start; its states become those of the solution.
    parameters : ndarray
        Of the model.
    du : ndarray, shape (L,)
        Torques to start from (N m).

    Returns
    -------
    torques, iterations
        Shape (L,) (N m), and their number.

    Raises
    ------
    ArithmeticError
        When Ipopt does not succeed.
    """
    s, steps = horizon.settings, horizon.settings.steps
    x_d, bound = horizon.x_d, horizon.bound / UNIT
    deviation = (horizon.x - x_d) / _SCALE
    start = np.concatenate([deviation.ravel(), du / UNIT, np.zeros(steps)])
    initial = (horizon.x_hat - x_d[0]) / _SCALE
    free = np.full(6 * steps, np.inf)
    low = np.concatenate([initial, -free, np.full(steps, -bound), np.zeros(steps)])
    high = np.concatenate([initial, free, np.full(steps, bound), np.full(steps, np.inf)])
    p = np.concatenate(
        [x_d.ravel(), horizon.theta[:-1].ravel(), parameters, s.q_diag]
        + [[s.r, s.q_terminal, s.period, horizon.u_d, s.lateral_bound, s.soft_weight / s.period]]
    )
    defects = np.zeros(6 * steps)
    found = function(
        x0=start, p=p, lbx=low, ubx=high,
        lbg=np.concatenate([defects, np.full(2 * steps, -np.inf)]), ubg=np.zeros(8 * steps),
    )  # fmt: skip
    stats = function.stats()
    if not stats["success"]:
        raise ArithmeticError(f"Ipopt ended with {stats['return_status']}")
    solution = np.array(found["x"]).ravel()
    horizon.x[:] = x_d + solution[: 6 * (steps + 1)].reshape(steps + 1, 6) * _SCALE
    return UNIT * solution[6 * (steps + 1) :][:steps], stats["iter_count"]
