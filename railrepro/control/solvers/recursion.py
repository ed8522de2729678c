"""The Riccati recursion as CasADi functions, with active sets and barrier terms for bounds. The costs are those of
`railrepro.control.problem`; their derivatives are halved. Serves the paper's section Nonlinear Model Predictive
Control. Source: Rao, Wright and Rawlings 1998."""

import casadi as ca

from railrepro.compile.codegen import stored
from railrepro.control import problem
from railrepro.model.control_model import STATES, Y


def _halved(cost: ca.SX, by: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Hessian and gradient of a cost, dense and halved."""
    hessian, gradient = ca.hessian(cost, by)
    return ca.densify(hessian / 2), ca.densify(gradient / 2)


@stored
def recursion(variant: str, discretisation: str) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Make the CasADi functions of the Riccati recursion for the quadratic problem in steps (dx, du) from a trajectory
    (x, u). `variant` ("corrected", "printed", errata to keep) and `discretisation` ("euler", "midpoint", "rk4") are
    those of the prediction model. Arguments of the functions:

    - P, p: matrix and vector of the cost-to-go dx' P dx / 2 + p' dx;
    - x_next, x_plus, x_d: next state by the model, next state of the trajectory, desired state;
    - A, B, tuning: derivatives from `problem.dynamics`, tuning vector in the order of `problem.TUNING`;
    - side: active lateral bound, 1 (upper), -1 (lower) or 0 (none);
    - fixed, to_bound: du is to_bound (N m) if fixed is not 0, else feedback' dx + feed-forward;
    - terms[4]: what stands for the bounds in the interior point method, 0 in the active-set method. They are added to
      half the second and half the first derivative of the cost by the torque, half the second and half the first by y.

    Returns:
        terminal: (x[6], x_d[6], side, terms, tuning) -> P (6, 6), p[6] of the last stage.
        backward: (P, p, x_plus, x_next, A, B, u, fixed, to_bound, x, x_d, side, terms, tuning) -> P, p one stage
            earlier, feedback[6], feed-forward.
        forward: (dx, feedback, feed-forward, x_next, x_plus, A, B, P, p, u, tuning) -> next dx[6], du, half the
            derivative of the cost by the torque.
    """
    n = len(STATES)
    x, x_d, x_next, x_plus, dx = (ca.SX.sym(name, n) for name in ("x", "x_d", "x_next", "x_plus", "dx"))
    vector, b, feedback, terms = ca.SX.sym("p", n), ca.SX.sym("b", n), ca.SX.sym("feedback", n), ca.SX.sym("terms", 4)
    u, fixed, to_bound, side, feedforward = ca.vertsplit(ca.SX.sym("scalars", 5))
    matrix, a = ca.SX.sym("P", n, n), ca.SX.sym("A", problem.dynamics(variant, discretisation).sparsity_out(1))
    tuning = ca.SX.sym("tuning", len(problem.TUNING))
    t, of_state = problem.Tuning.of(tuning), [x, x_d, side, terms, tuning]

    def state_cost(cost):
        hessian, gradient = _halved(cost(x, x_d, problem.slack_on(side, x, t), t), x)
        hessian[Y, Y] += terms[2]
        gradient[Y] += terms[3]
        return hessian, gradient

    hessian, gradient = state_cost(problem.stage_cost)
    effort, effort_slope = _halved(problem.effort_cost(u, t), u)
    gap, free, ahead = x_next - x_plus, 1 - fixed**2, ca.mtimes(matrix, x_next - x_plus) + vector
    pb = ca.mtimes(matrix, b)
    curvature = effort + terms[0] + ca.dot(b, pb)
    coupling = ca.mtimes(a.T, pb)
    gain = -free * coupling / curvature
    offset = -free * (effort_slope + terms[1] + ca.dot(b, ahead)) / curvature + (1 - free) * to_bound
    cost = hessian + ca.mtimes(a.T, ca.mtimes(matrix, a)) + ca.mtimes(coupling, gain.T)
    cost_vector = gradient + ca.mtimes(a.T, ahead + pb * offset)
    stage = [ca.triu2symm(ca.triu(cost)), cost_vector, gain, offset]

    du = ca.dot(feedback, dx) + feedforward
    dx_next = ca.mtimes(a, dx) + b * du + gap
    slope = ca.substitute(effort_slope, u, u + du) + ca.dot(b, ca.mtimes(matrix, dx_next) + vector)
    back = [matrix, vector, x_plus, x_next, a, b, u, fixed, to_bound, *of_state]
    on = [dx, feedback, feedforward, x_next, x_plus, a, b, matrix, vector, u, tuning]
    return (
        ca.Function("riccati_terminal", of_state, state_cost(problem.terminal_cost), {"cse": True}),
        ca.Function("riccati_backward", back, list(map(ca.densify, stage)), {"cse": True}),
        ca.Function("riccati_forward", on, list(map(ca.densify, [dx_next, du, slope])), {"cse": True}),
    )
