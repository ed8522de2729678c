"""What nonlinear and linear time-variant MPC share: settings, the optimal control problem, its condensed form.

Minimised over the differential torques du_0 … du_(L-1) of one running gear:
sum T |x_k - x_d,k|_Q^2 + T R du_k^2 + T |x_L - x_d,L|_QL^2 with QL = Q diag(0,0,0,0,q,q), torques within the limits of
both motors, lateral position within a bound that is soft (quadratic slack), so that no state makes it infeasible.

Serves eqs. (constraints) and (terminal_cost) of the paper.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.linalg import cho_factor, cho_solve

from railrepro import codegen
from railrepro.derivation import PARAMETERS
from railrepro.model import THETA, control_model, discretise
from railrepro.parameters import Vehicle
from railrepro.preview import Forecast, forecast
from railrepro.route import Route

UNIT = 1e3
"""Differential torques are optimised in kN m and costs in mm^2-like units, or solvers stop too early."""
_COST = 1e6
_Y = 4


@dataclass(frozen=True)
class MPCSettings:
    """Tuning of a predictive controller.

    Attributes
    ----------
    q_diag : tuple of 6 floats
        Diagonal of Q in the order of the states (1/m^2, 1/rad^2, …).
    r : float
        Weight R on du^2 (1/(N m)^2).
    q_terminal : float
        Factor q of the terminal cost (-).
    period : float
        Time step T = sampling time (s).
    steps : int
        Horizon length L.
    discretisation : str
        See `railrepro.model.discretise`.
    variant : str
        Prediction model "corrected" or "printed".
    lateral_bound : float
        Bound of |y_TrAx| (m).
    bound_weight : float
        Weight of its violation relative to the weight of y (-).
    """

    q_diag: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    r: float = 1e-11
    q_terminal: float = 1.0
    period: float = 0.010
    steps: int = 30
    discretisation: str = "rk4"
    variant: str = "corrected"
    lateral_bound: float = 8e-3
    bound_weight: float = 100.0


@dataclass(frozen=True)
class Solve:
    """Record of one optimisation: wall time (s), iterations, and whether a shifted old plan had to serve."""

    seconds: float
    iterations: int
    fallback: bool


@dataclass(frozen=True)
class Problem:
    """One optimal control problem, self-contained so that it can be recorded and solved again by another solver."""

    settings: MPCSettings
    x_hat: np.ndarray
    u_d: float
    ahead: Forecast
    parameters: np.ndarray
    tau_max: float

    @property
    def bound(self) -> float:
        """Largest |du| that both motors allow beside the base torque (N m)."""
        return max(self.tau_max - abs(self.u_d), 0.0)

    def weights(self) -> np.ndarray:
        """State weights T Q of the stages 1 … L, terminal cost included, shape (L, 6)."""
        s = self.settings
        stage = np.tile(s.q_diag, (s.steps, 1)) * s.period
        stage[-1] *= (0.0, 0.0, 0.0, 0.0, s.q_terminal, s.q_terminal)
        return stage

    def cost(self, states: np.ndarray, du: np.ndarray) -> float:
        """Cost of predicted states (6, L + 1) and torques (L,), without the constant stage 0."""
        s = self.settings
        error = (states - self.ahead.x_d)[:, 1:].T
        over = np.maximum(np.abs(states[_Y, 1:]) - s.lateral_bound, 0)
        soft = s.bound_weight * s.q_diag[_Y] * s.period * np.sum(over**2)
        return float(np.sum(self.weights() * error**2) + s.r * s.period * np.sum(du**2) + soft)


class Predictor:
    """The discretised model and its derivatives along a trajectory, in one compiled call."""

    def __init__(self, settings: MPCSettings):
        self._call = codegen.compiled(_prediction(settings.variant, settings.discretisation, settings.steps))
        steps = settings.steps
        self.x_next = self._call.results[0].reshape(steps, 6)
        self.a = self._call.results[1].reshape(steps, 6, 6).transpose(0, 2, 1)
        self.b = self._call.results[2].reshape(steps, 6)

    def __call__(self, states, du, problem: Problem) -> None:
        """Evaluate at states (6, L) and torques (L,); fills x_next (L, 6), a (L, 6, 6), b (L, 6)."""
        arguments = self._call.arguments
        arguments[0][:] = states.T.ravel()
        arguments[1][:] = du
        arguments[2][:] = problem.u_d
        arguments[3][:] = problem.ahead.theta[:, :-1].T.ravel()
        arguments[4][:] = problem.parameters
        arguments[5][:] = problem.settings.period
        self._call()

    def roll_out(self, problem: Problem, du: np.ndarray) -> np.ndarray:
        """Predicted states under torques (L,) from the measured state, shape (6, L + 1)."""
        step = _single_step(problem.settings.variant, problem.settings.discretisation)
        states = [problem.x_hat]
        for k, torque in enumerate(du):
            u = np.array([problem.u_d - torque, problem.u_d + torque])
            theta = problem.ahead.theta[:, k]
            states.append(np.array(step(states[-1], u, theta, problem.parameters, problem.settings.period)).ravel())
        return np.array(states).T


@lru_cache
def _single_step(variant: str, discretisation: str) -> ca.Function:
    return discretise(control_model(variant), discretisation)


@lru_cache
def _prediction(variant: str, discretisation: str, steps: int) -> ca.Function:
    """Map of one step with derivatives over the horizon."""
    step = _single_step(variant, discretisation)
    x, du, u_d = ca.SX.sym("x", 6), ca.SX.sym("du"), ca.SX.sym("u_d")
    theta, par, period = ca.SX.sym("theta", len(THETA)), ca.SX.sym("par", len(PARAMETERS)), ca.SX.sym("T")
    x_next = step(x, ca.vertcat(u_d - du, u_d + du), theta, par, period)
    outputs = [x_next, ca.densify(ca.jacobian(x_next, x)), ca.densify(ca.jacobian(x_next, du))]
    one = ca.Function("one", [x, du, u_d, theta, par, period], outputs, {"cse": True})
    names = ["x", "du", "u_d", "theta", "par", "T"]
    arguments = [ca.MX.sym(n, *one.size_in(i)) for i, n in enumerate(names)]
    wide = [
        ca.MX.sym(n, a.shape[0], steps) if n in ("x", "du", "theta") else a
        for n, a in zip(names, arguments, strict=True)
    ]
    mapped = one.map("mapped", "serial", steps, [2, 4, 5], [])
    return ca.Function(f"prediction_{variant}_{discretisation}_{steps}", wide, mapped(*wide))


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


def condense(
    problem: Problem, predictor: Predictor, states: np.ndarray, du: np.ndarray, gaps: np.ndarray
) -> CondensedQP:
    """Gauss-Newton model about states (6, L + 1) and torques (L,) with gaps x_next - x_(k+1), shape (L, 6)."""
    s, steps = problem.settings, problem.settings.steps
    sensitivity, drift = np.zeros((steps, 6, steps)), np.empty((steps, 6))
    block, move = np.zeros((6, steps)), problem.x_hat - states[:, 0]
    a, b = predictor.a, predictor.b * UNIT
    for k in range(steps):
        block = a[k] @ block
        block[:, k] = b[k]
        move = a[k] @ move + gaps[k]
        sensitivity[k], drift[k] = block, move
    weights = problem.weights()
    error = (states - problem.ahead.x_d)[:, 1:].T + drift
    used = np.flatnonzero(weights.any(axis=0))
    flat = sensitivity[:, used].reshape(-1, steps)
    hessian = _COST * (flat.T @ (flat * weights[:, used].reshape(-1, 1)))
    effort = _COST * s.r * s.period * UNIT**2
    hessian[np.diag_indices(steps)] += effort + 1e-9
    gradient = _COST * (flat.T @ (weights * error)[:, used].ravel()) + effort * du / UNIT
    low, high = (-problem.bound - du) / UNIT, (problem.bound - du) / UNIT
    soft = _COST * s.bound_weight * s.q_diag[_Y] * s.period
    y_free = states[_Y, 1:] + drift[:, _Y]
    return CondensedQP(hessian, gradient, low, high, sensitivity, drift, y_free, s.lateral_bound, soft)


def solve(qp: CondensedQP, start: np.ndarray) -> np.ndarray:
    """Minimiser of a condensed problem; `start` (kN m) tells where the soft bound is active at first.

    The soft bound is piecewise quadratic, so Newton on its active set ends after a few box-constrained solves.

    Raises
    ------
    ArithmeticError
        When the active set does not settle or a QP is not solved.
    """
    y_sensitivity, step, active = qp.sensitivity[:, _Y, :], start, None
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


@dataclass
class PredictiveController:
    """Receding horizon around `optimise`, with shifted warm starts, fallback and statistics; one running gear.

    Attributes
    ----------
    stats : list of Solve
        One record per sample.
    recorded : list of Problem or None
        Problems as they came, when recording is switched on.
    """

    vehicle: Vehicle
    route: Route
    gear: int
    settings: MPCSettings = field(default_factory=MPCSettings)
    recorded: list | None = None

    def __post_init__(self):
        self.stats: list[Solve] = []
        self.parameters = control_model(self.settings.variant).parameter_vector(self.vehicle)
        self.plan_du = np.zeros(self.settings.steps)

    @property
    def period(self) -> float:
        """Sampling time (s)."""
        return self.settings.period

    def problem(self, x_hat: np.ndarray, u_d: float) -> Problem:
        """The optimal control problem at a measured state (6,) and base torque (N m)."""
        s = self.settings
        ahead = forecast(
            self.route, self.vehicle, x_hat, u_d, s.period, s.steps, self.gear, printed=s.variant == "printed"
        )
        return Problem(s, x_hat, u_d, ahead, self.parameters, self.vehicle.drive.torque_limit)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """Differential torque (N m) for now; a failing solver falls back on the shifted previous plan, counted."""
        begin = time.perf_counter()
        problem = self.problem(x_hat, u_d)
        if self.recorded is not None:
            self.recorded.append(problem)
        start = np.append(self.plan_du[1:], self.plan_du[-1])
        try:
            du, iterations = self.optimise(problem, np.clip(start, -problem.bound, problem.bound))
            fallback = not np.isfinite(du).all()
        except (ArithmeticError, np.linalg.LinAlgError):
            du, iterations, fallback = start, 0, True
        self.plan_du = np.clip(start if fallback else du, -problem.bound, problem.bound)
        self.stats.append(Solve(time.perf_counter() - begin, iterations, fallback))
        return float(self.plan_du[0])

    def optimise(self, problem: Problem, du: np.ndarray) -> tuple[np.ndarray, int]:
        """Torques (L,) that solve the problem from a start, and the number of iterations."""
        raise NotImplementedError
