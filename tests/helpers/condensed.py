"""Judges of the compiled horizon: the problem with the states eliminated, and a sample step by step in Python.

The condensed problem is dense and solved by a QP code, so that it shares nothing with the Riccati recursion but the
stated cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.linalg import cho_factor, cho_solve

from railrepro.control.problem import curvature, dynamics
from railrepro.control.solvers.ipopt import COST, UNIT
from railrepro.model.control_model import DPSI_DP, PSI_AX, PSI_TR, PSI_TRAX, PSIDOT_AX, STATES, XDOT, X, Y


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


def matrices(horizon) -> np.ndarray:
    """A of all stages of a linearised horizon with its zeros, shape (L, 6, 6)."""
    model = dynamics(horizon.settings.variant, horizon.settings.discretisation)
    row, column = (np.array(index) for index in model.sparsity_out(1).get_triplet())
    dense = np.zeros((horizon.settings.steps, len(STATES), len(STATES)))
    dense[:, row, column] = horizon.a
    return dense


def condense(horizon) -> CondensedQP:
    """Half the stated cost about the trajectory of a linearised horizon, times `COST`."""
    s, steps, a, b = horizon.settings, horizon.settings.steps, matrices(horizon), horizon.b * UNIT
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
    low, high = (-horizon.c.bound - horizon.u) / UNIT, (horizon.c.bound - horizon.u) / UNIT
    soft = COST * slack_weight
    y_free = horizon.x[1:, Y] + drift[:, Y]
    return CondensedQP(hessian, gradient, low, high, sensitivity, drift, y_free, s.lateral_bound, soft)


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


def iterate(horizon, most: int, tolerance: float, step=solve) -> int | None:
    """Newton iterations on a horizon until no torque moves by more than `tolerance`; their number, None without an end.

    `step` finds `dx`, `du`, by default from the condensed problem.
    """
    for iteration in range(1, most + 1):
        horizon.linearise()
        horizon.dx[:], horizon.du[:] = step(horizon)
        gap, moved = np.abs(horizon.x_next - horizon.x[1:]).max(), np.abs(horizon.du).max()
        apply(horizon)
        if moved < tolerance and gap < 1e-9:
            return iteration
    return None


def apply(horizon) -> None:
    """Take the steps `dx`, `du`; torques stay within their bound."""
    horizon.x += horizon.dx
    horizon.u[:] = np.clip(horizon.u + horizon.du, -horizon.c.bound, horizon.c.bound)


def recursion(horizon) -> tuple[np.ndarray, np.ndarray]:
    """Steps that the compiled recursion finds."""
    horizon.solve()
    return horizon.dx, horizon.du


class ByStep:
    """Samples of a controller, done in Python on a horizon of its own.

    Parameters
    ----------
    controller : NMPC or LTVMPC
        Whose vehicle, route, gear, settings and way to solve it takes.
    """

    def __init__(self, controller):
        self.like, self.horizon = controller, controller.horizon
        self.settings, self.linear = controller.settings, hasattr(controller, "printed")
        self.solver = getattr(controller, "solver", None)
        self.plan_du, self.offset, self.expected, self.fallbacks = np.zeros(self.settings.steps), 0.0, None, []

    def enter(self, x_hat, u_d):
        bound = self.settings.torque_bound(u_d, self.like.vehicle.drive.torque_limit)
        self.horizon.sample(x_hat, u_d, bound)

    def later(self):
        """The plan before, one step later."""
        return np.append(self.plan_du[1:], self.plan_du[-1]).clip(-self.horizon.c.bound, self.horizon.c.bound)

    def prepare(self):
        horizon = self.horizon
        horizon.forecast()
        x, x_d, theta = horizon.x, horizon.x_d, horizon.theta
        if self.linear:
            x[:], horizon.u[:] = 0.0, 0.0
            x[:, X], x[:, XDOT] = x_d[:, X], x_d[:, XDOT]
            if not self.like.printed:
                x[:, PSI_AX], x[:, PSIDOT_AX] = theta[:, PSI_TR], theta[:, DPSI_DP] * x_d[:, XDOT]
            return
        if self.expected is None:
            x[:] = x_d
        else:
            x[:-1], x[-1] = x[1:].copy(), x_d[-1]
        x[0], horizon.u[:] = horizon.x_hat, self.later()

    def plan(self, x_hat, u_d):
        settings, horizon, x_hat = self.settings, self.horizon, np.array(x_hat)
        if settings.observer > 0:
            if self.expected is not None and x_hat[XDOT] > 1:
                error = x_hat[Y] - self.expected[Y]
                self.offset += settings.observer * error / (x_hat[XDOT] * settings.period)
            x_hat[PSI_TRAX] += self.offset
        prepared = self.solver == "rti" and self.expected is not None
        self.enter(x_hat, u_d if settings.informed else 0.0)
        if not prepared:
            self.prepare()
            if self.solver != "gauss_newton":
                horizon.linearise()
        self.plan_du = self.later()
        try:
            self.solve()
        except ArithmeticError:
            self.expected, horizon.fixed[:], horizon.side[:] = None, 0.0, 0.0
        self.fallbacks.append(self.expected is None)
        self.plan_du = self.plan_du.clip(-horizon.c.bound, horizon.c.bound)
        torque = self.plan_du[0]
        if self.solver == "rti" and self.expected is not None:
            self.enter(self.expected, horizon.c.u_d)
            self.prepare()
            horizon.linearise()
        return torque

    def solve(self):
        horizon = self.horizon
        if self.linear:
            recursion(horizon)
            self.plan_du, self.expected = horizon.du.copy(), horizon.x[1] + horizon.dx[1]
            return
        if self.solver == "rti":
            recursion(horizon)
            apply(horizon)
        elif iterate(horizon, 30, 1e-4, recursion) is None:
            raise ArithmeticError("no convergence")
        self.plan_du, self.expected = horizon.u.copy(), horizon.x[1].copy()
