"""The Riccati recursion as CasADi functions: with bounds as active sets, and with barrier terms for the bounds.

Hessians and gradients are CasADi's derivatives of the costs stated in `railrepro.control.problem`, all of them halved.
Serves the paper's section Nonlinear Model Predictive Control.

Source: Rao, Wright and Rawlings 1998.
"""

from __future__ import annotations

import casadi as ca

from railrepro.compile.codegen import stored
from railrepro.control.problem import (
    TUNING,
    Tuning,
    dynamics,
    effort_cost,
    slack_cost,
    slack_on,
    stage_cost,
    terminal_cost,
)
from railrepro.model.control_model import STATES, Y

_N = len(STATES)


def _halved(cost: ca.SX, by: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Hessian and gradient of a cost, both halved, dense."""
    hessian, gradient = ca.hessian(cost, by)
    return ca.densify(hessian / 2), ca.densify(gradient / 2)


def _back(matrix, vector, a, b, gap, state, torque, free=1, to_bound=0) -> tuple[ca.SX, ...]:
    """One stage backward: cost-to-go (matrix, vector) before it, feedback and feed-forward of its torque.

    `state` and `torque` are Hessian and gradient of what they cost; a torque that is not free goes to its bound.
    """
    (hessian, gradient), (effort, effort_slope) = state, torque
    pb, ahead = ca.mtimes(matrix, b), ca.mtimes(matrix, gap) + vector
    curvature = effort + ca.dot(b, pb)
    coupling = ca.mtimes(a.T, pb)
    feedback = -free * coupling / curvature
    feedforward = -free * (effort_slope + ca.dot(b, ahead)) / curvature + (1 - free) * to_bound
    cost = hessian + ca.mtimes(a.T, ca.mtimes(matrix, a)) + ca.mtimes(coupling, feedback.T)
    cost = ca.densify(ca.triu2symm(ca.triu(cost)))
    return cost, ca.densify(gradient + ca.mtimes(a.T, ahead + pb * feedforward)), ca.densify(feedback), feedforward


@stored
def recursion(variant: str, discretisation: str) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Riccati recursion for the quadratic problem in steps (dx, du) from a trajectory (x, u), with active sets.

    `variant`, `discretisation`, A and B as of `problem.dynamics`, tuning: `problem.TUNING`. Halved cost-to-go
    dx' P dx / 2 + p' dx; next state x_next by the model, x_plus of the trajectory; desired state x_d; side: active
    lateral bound (1, -1, 0 none); fixed not 0: the torque step du is to_bound (N m), else feedback' dx + feed-forward.

    Returns
    -------
    terminal : casadi.Function
        (x[6], x_d[6], side, tuning) -> P (6, 6), p[6] of the last stage.
    backward : casadi.Function
        (P, p, x_plus, x_next, A, B, u, fixed, to_bound, x, x_d, side, tuning) -> P, p one stage earlier, feedback[6],
        feed-forward.
    forward : casadi.Function
        (dx, feedback, feed-forward, x_next, x_plus, A, B, P, p, u, tuning) -> next dx[6], du, half the derivative of
        the cost by the torque.
    """
    n, sparsity = _N, dynamics(variant, discretisation).sparsity_out(1)
    names = ("p", "x_plus", "x_next", "b", "x", "x_d", "dx", "feedback")
    v = {name: ca.SX.sym(name, n) for name in names}
    s = {name: ca.SX.sym(name) for name in ("u", "fixed", "to_bound", "side", "ff")}
    matrix, a, tuning = ca.SX.sym("P", n, n), ca.SX.sym("A", sparsity), ca.SX.sym("tuning", len(TUNING))
    t = Tuning.of(tuning)
    state, slack = [v["x"], v["x_d"], s["side"], tuning], slack_on(s["side"], v["x"], t)
    last = _halved(terminal_cost(v["x"], v["x_d"], slack, t), v["x"])
    terminal = ca.Function("riccati_terminal", state, last, {"cse": True})

    gap, free = v["x_next"] - v["x_plus"], 1 - s["fixed"] ** 2
    of_state = _halved(stage_cost(v["x"], v["x_d"], slack, t), v["x"])
    effort, effort_slope = of_torque = _halved(effort_cost(s["u"], t), s["u"])
    found = _back(matrix, v["p"], a, v["b"], gap, of_state, of_torque, free, s["to_bound"])
    inputs = [matrix, v["p"], v["x_plus"], v["x_next"], a, v["b"], s["u"], s["fixed"], s["to_bound"], *state]
    backward = ca.Function("riccati_backward", inputs, found, {"cse": True})

    du = ca.dot(v["feedback"], v["dx"]) + s["ff"]
    dx_next = ca.densify(ca.mtimes(a, v["dx"]) + v["b"] * du + gap)
    slope = ca.substitute(effort_slope, s["u"], s["u"] + du) + ca.dot(v["b"], ca.mtimes(matrix, dx_next) + v["p"])
    inputs = [v["dx"], v["feedback"], s["ff"], v["x_next"], v["x_plus"], a, v["b"], matrix, v["p"], s["u"], tuning]
    forward = ca.Function("riccati_forward", inputs, [dx_next, du, slope], {"cse": True})
    return terminal, backward, forward


@stored
def barrier(variant: str, discretisation: str) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
    """Riccati recursion with barrier terms, for interior point methods; symbols as in `recursion`.

    `terms` (4,) stand for the bounds, added to the halved cost: Hessian and gradient by the torque, then by y.

    Returns
    -------
    stiffness : casadi.Function
        (tuning) -> halved Hessian of the slack cost.
    terminal : casadi.Function
        (x, x_d, terms, tuning) -> P, p of the last stage.
    backward : casadi.Function
        (P, p, x_plus, x_next, A, B, u, terms, x, x_d, tuning) -> P, p one stage earlier, feedback, feed-forward.
    again : casadi.Function
        Arguments of `backward` -> p, feed-forward only, for changed gradients.
    """
    n, sparsity = _N, dynamics(variant, discretisation).sparsity_out(1)
    v = {name: ca.SX.sym(name, n) for name in ("p", "x_plus", "x_next", "b", "x", "x_d")}
    u, matrix, a = ca.SX.sym("u"), ca.SX.sym("P", n, n), ca.SX.sym("A", sparsity)
    terms, tuning, slack = ca.SX.sym("barrier", 4), ca.SX.sym("tuning", len(TUNING)), ca.SX.sym("slack")
    t = Tuning.of(tuning)
    stiffness, _ = _halved(slack_cost(slack, t), slack)

    def of_state(cost):
        hessian, gradient = _halved(cost(v["x"], v["x_d"], 0, t), v["x"])
        hessian[Y, Y] += terms[2]
        gradient[Y] += terms[3]
        return hessian, gradient

    effort, effort_slope = _halved(effort_cost(u, t), u)
    of_torque = effort + terms[0], effort_slope + terms[1]
    found = _back(matrix, v["p"], a, v["b"], v["x_next"] - v["x_plus"], of_state(stage_cost), of_torque)
    inputs = [matrix, v["p"], v["x_plus"], v["x_next"], a, v["b"], u, terms, v["x"], v["x_d"], tuning]
    return (
        ca.Function("barrier_stiffness", [tuning], [stiffness]),
        ca.Function("barrier_terminal", [v["x"], v["x_d"], terms, tuning], of_state(terminal_cost), {"cse": True}),
        ca.Function("barrier_backward", inputs, found, {"cse": True}),
        ca.Function("barrier_again", inputs, [found[1], found[3]], {"cse": True}),
    )
