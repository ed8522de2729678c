"""The quadratic problem of a horizon with the states eliminated: dense, cubic in its length, solved by a QP code.

The second method beside the Riccati recursion: it judges the recursion in the tests, takes over where neither active
sets nor interior points find the minimiser, and serves machines without a C compiler.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.linalg import cho_factor, cho_solve

from railrepro.control.problem import curvature
from railrepro.model.control_model import STATES, Y
from railrepro.threads import one_thread

UNIT = 1e3
"""Differential torques are optimised in kN m, or solvers stop too early."""
COST = 1e6
"""Factor on costs, so that they are of the order of one."""


@dataclass
class CondensedQP:
    """Quadratic model of a problem in the torques alone, about a trajectory.

    minimise 0.5 d^T H d + g^T d + soft/2 |excess of y beyond the bound|^2 over torque steps d (kN m) with
    low <= d <= high; states move by sensitivity @ d + drift, and y = y_free + sensitivity of y @ d.
    """

    hessian: np.ndarray
    gradient: np.ndarray
    low: np.ndarray
    high: np.ndarray
    sensitivity: np.ndarray
    drift: np.ndarray
    y_free: np.ndarray
    y_bound: float
    soft: float


def condense(horizon) -> CondensedQP:
    """Half the stated cost about the trajectory of a linearised horizon (`riccati.PlainHorizon`), times `COST`."""
    s, steps, a, b = horizon.settings, horizon.settings.steps, horizon.matrices, horizon.b * UNIT
    gaps = horizon.x_next - horizon.x[1:]
    sensitivity, drift = np.zeros((steps, len(STATES), steps)), np.empty((steps, len(STATES)))
    block, move = np.zeros((len(STATES), steps)), horizon.x_hat - horizon.x[0]
    for k in range(steps):
        block = a[k] @ block
        block[:, k] = b[k]
        move = a[k] @ move + gaps[k]
        sensitivity[k], drift[k] = block, move
    weights, torque_weight, slack_weight = curvature(s)
    error = (horizon.x - horizon.x_d)[1:] + drift
    used = np.flatnonzero(weights.any(axis=0))
    flat = sensitivity[:, used].reshape(-1, steps)
    hessian = COST * (flat.T @ (flat * weights[:, used].reshape(-1, 1)))
    effort = COST * torque_weight * UNIT**2
    hessian[np.diag_indices(steps)] += effort
    gradient = COST * (flat.T @ (weights * error)[:, used].ravel()) + effort * horizon.u / UNIT
    low, high = (-horizon.bound - horizon.u) / UNIT, (horizon.bound - horizon.u) / UNIT
    soft = COST * slack_weight
    y_free = horizon.x[1:, Y] + drift[:, Y]
    return CondensedQP(hessian, gradient, low, high, sensitivity, drift, y_free, s.lateral_bound, soft)


@one_thread()
def solve(horizon) -> tuple[np.ndarray, np.ndarray]:
    """Steps of the states (L + 1, 6) and torques (L,) that minimise the quadratic problem of a linearised horizon.

    Raises
    ------
    ArithmeticError
        When the active set does not settle or a QP is not solved.
    """
    qp = condense(horizon)
    torque = minimise(qp)
    states = np.vstack([horizon.x_hat - horizon.x[0], qp.sensitivity @ torque + qp.drift])
    return states, UNIT * torque


def minimise(qp: CondensedQP) -> np.ndarray:
    """Torque steps (kN m) that solve a condensed problem.

    The soft bound is piecewise quadratic, so Newton on its active set ends after a few box-constrained solves.

    Raises
    ------
    ArithmeticError
        When the active set does not settle or a QP is not solved.
    """
    y_sensitivity, active = qp.sensitivity[:, Y, :], None
    step = np.zeros(qp.gradient.size)
    for _ in range(20):
        y = qp.y_free + y_sensitivity @ step
        beyond = np.sign(y) * (np.abs(y) > qp.y_bound)
        if active is not None and np.array_equal(beyond, active):
            return step
        active, hessian, gradient = beyond, qp.hessian, qp.gradient
        if active.any():
            rows = y_sensitivity[active != 0]
            excess = (qp.y_free - active * qp.y_bound)[active != 0]
            hessian = hessian + qp.soft * rows.T @ rows
            gradient = gradient + qp.soft * rows.T @ excess
        step = _solve_box(hessian, gradient, qp.low, qp.high)
    raise ArithmeticError("the active set of the lateral bound did not settle")


def _solve_box(hessian: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Minimiser of a strictly convex QP with bounds: one factorisation when no bound is active, else DAQP."""
    step = cho_solve(cho_factor(hessian, lower=True, check_finite=False), -gradient, check_finite=False)
    if np.all((step >= low) & (step <= high)):
        return step
    solver = _daqp(gradient.size)
    solution = solver(h=hessian, g=gradient, lbx=low, ubx=high, x0=np.clip(step, low, high))
    if not solver.stats()["success"]:
        raise ArithmeticError("the box-constrained QP was not solved")
    return np.clip(np.array(solution["x"]).ravel(), low, high)


@lru_cache
def _daqp(n: int) -> ca.Function:
    structure = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity(0, n)}
    return ca.conic("box", "daqp", structure, {"error_on_fail": False})
