"""Judges of the compiled horizon: the problem with the states eliminated, and a sample step by step in Python.

The condensed problem is dense and solved by a QP code, so that it shares nothing with the Riccati recursion but the
stated cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from railrepro.control import problem
from railrepro.control.problem import Tuning, dynamics
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


def curvature(settings) -> tuple[np.ndarray, float, float]:
    """Halved second derivatives of the stated costs: by the states 1 … L (L, 6), by a torque, by a slack."""
    x, du, slack = ca.SX.sym("x", len(STATES)), ca.SX.sym("du"), ca.SX.sym("slack")
    t, x_d = Tuning.of(ca.DM(settings.tuning())), ca.DM.zeros(len(STATES))
    costs = [(of_state(x, x_d, 0, t), x) for of_state in (problem.stage_cost, problem.terminal_cost)]
    costs += [(problem.effort_cost(du, t), du), (problem.slack_cost(slack, t), slack)]
    stage, last, torque, of_slack = (
        np.array(ca.DM(ca.diag(ca.hessian(cost, by)[0]) / 2)).ravel() for cost, by in costs
    )
    return np.vstack([np.tile(stage, (settings.steps - 1, 1)), last]), torque.item(), of_slack.item()


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

    The excess of y beyond its bound is made of further variables. CasADi raises RuntimeError when the QP is not solved.
    """
    qp = condense(horizon)
    n, y = qp.gradient.size, qp.sensitivity[:, Y, :]
    hessian = ca.diagcat(qp.hessian, qp.soft * np.eye(n))
    solver = ca.conic("condensed", "daqp", {"h": hessian.sparsity(), "a": ca.Sparsity.dense(2 * n, 2 * n)})
    free, none = np.full(n, np.inf), np.zeros(n)
    found = solver(
        h=hessian, g=np.append(qp.gradient, none), lbx=np.append(qp.low, none), ubx=np.append(qp.high, free),
        a=np.block([[y, -np.eye(n)], [-y, -np.eye(n)]]), uba=qp.y_bound - np.append(qp.y_free, -qp.y_free),
    )  # fmt: skip
    torque = np.array(found["x"]).ravel()[:n]
    states = np.vstack([horizon.x_hat - horizon.x[0], qp.sensitivity @ torque + qp.drift])
    return states, UNIT * torque


def iterate(horizon) -> None:
    """Newton iterations on a horizon until no torque moves; ArithmeticError when they do not end."""
    for _ in range(30):
        horizon.linearise()
        horizon.solve()
        gap, moved = np.abs(horizon.x_next - horizon.x[1:]).max(), np.abs(horizon.du).max()
        apply(horizon)
        if moved < 1e-4 and gap < 1e-9:
            return
    raise ArithmeticError("no convergence")


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
        else:
            iterate(horizon)
        self.plan_du, self.expected = horizon.u.copy(), horizon.x[1].copy()
